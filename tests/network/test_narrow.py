"""A narrower network is one that others read, and sees what the wide one sees."""

import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.__main__ import app
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import convolutions, read_cfg

pytestmark = pytest.mark.skipif(find_spec("openvino") is None, reason="needs openvino")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("narrow") / "data"
    for _ in make_dataset(folder, Recipe(scene="b", images=12, valid=4, seed=1), workers=1):
        pass
    return folder / "obj.data"


def narrow(data: Path, out: Path, *options: str) -> tuple[int, str]:
    arguments = ["narrow", "--weights", "simulations", "--data", str(data), "--out", str(out)]
    result = CliRunner().invoke(app, [*arguments, *options])
    return result.exit_code, result.output


def cells(cfg: Path, weights: Path, images: Path) -> np.ndarray:
    """What OpenCV computes of some images with Darknet's files (N, 5 + classes)."""
    net = cv2.dnn.readNetFromDarknet(str(cfg), str(weights))
    rows = []
    for path in sorted(images.glob("*.jpg")):
        pixels = cv2.imread(str(path))
        assert pixels is not None
        net.setInput(cv2.dnn.blobFromImage(pixels, 1 / 255, (960, 480)))
        rows += [np.asarray(one) for one in net.forward(net.getUnconnectedOutLayersNames())]
    return np.concatenate(rows)


def test_opencv_reads_it_and_computes_nearly_the_same(data: Path, tmp_path: Path) -> None:
    """A quarter of the parameters; boxes where there are droplets to a pixel."""
    filters = {8: 192, 10: 224, 12: 256, 13: 96, 14: 224, 18: 32, 21: 192}
    wanted = ",".join(f"{layer}={n}" for layer, n in filters.items())
    code, said = narrow(data, tmp_path / "out", "--filters", wanted)
    assert code == 0, said
    weights = tmp_path / "out" / "yolov3-tiny-droplets.weights"
    assert "layer 12: 256 of 1024 filters" in said
    assert weights.stat().st_size < BUNDLED_WEIGHTS.stat().st_size / 4
    cfg = weights.with_suffix(".cfg")
    written = {one.layer: one.outputs for one in convolutions(read_cfg(cfg))}
    whole = {one.layer: one.outputs for one in convolutions(read_cfg(find_cfg(BUNDLED_WEIGHTS)))}
    assert written == whole | filters
    images = data.parent / "valid"
    one = cells(find_cfg(BUNDLED_WEIGHTS), BUNDLED_WEIGHTS, images)
    other = cells(cfg, weights, images)
    sure = one[:, 4] > 0.9
    assert sure.sum() > 5
    assert (other[sure, 4] > 0.5).mean() > 0.9
    off = np.abs(other[sure, :4] - one[sure, :4]) * [960, 480, 960, 480]
    assert np.median(off) < 1


def test_as_few_filters_as_an_error_allows(data: Path, tmp_path: Path) -> None:
    sizes = []
    for error in ("0.00001", "0.001"):
        code, said = narrow(data, tmp_path / error, "--error", error, "--images", "3")
        assert code == 0, said
        sizes.append((tmp_path / error / "yolov3-tiny-droplets.weights").stat().st_size)
    assert BUNDLED_WEIGHTS.stat().st_size > sizes[0] > sizes[1]


@pytest.mark.parametrize(
    ("filters", "said"),
    [
        ("15=4", "layers that can be pruned are 0, 2, 4"),
        ("8=300", "layer 8 has 256 filters"),
        ("8", "should be layers and numbers such as 8=192,12=384"),
    ],
)
def test_filters_that_cannot_be_are_refused(
    data: Path, tmp_path: Path, filters: str, said: str
) -> None:
    code, output = narrow(data, tmp_path / "out", "--filters", filters)
    assert code == 1
    assert said in output
    assert not (tmp_path / "out").exists()


def test_nothing_is_overwritten(data: Path, tmp_path: Path) -> None:
    (tmp_path / "yolov3-tiny-droplets.cfg").write_text("mine")
    code, output = narrow(data, tmp_path)
    assert code == 1
    assert "is there already" in output
    assert (tmp_path / "yolov3-tiny-droplets.cfg").read_text() == "mine"


def test_without_openvino_it_says_what_to_install(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "droptrack.detection.engines.openvino", None)
    code, output = narrow(data, tmp_path / "out")
    assert code == 1
    assert "narrowing needs: pip install 'droptrack[openvino]'" in " ".join(output.split())
