"""Ranges of layers for 8 bits, and the calibrations that keep them, are measured and checked."""

import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.random_network import random_weights
from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.__main__ import app
from droptrack.detection.engine_choice import Network, Precision, choose_detector
from droptrack.errors import DroptrackError
from droptrack.network import quantisation
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import parse_cfg, read_cfg, resized
from droptrack.network.pruning import NO_PRUNING
from droptrack.network.quantisation import (
    Calibration,
    Quantisation,
    find_calibration,
    merge_ranges,
    quantised_layers,
    sha256_of,
    write_calibration,
)

CFG = read_cfg(find_cfg(BUNDLED_WEIGHTS))
needs_openvino = pytest.mark.skipif(
    not all(importlib.util.find_spec(package) for package in ("openvino", "onnx")),
    reason="needs the extra [openvino]",
)

BRANCHES = """
[net]
width=64
height=64
channels=3
[convolutional]
filters=4
size=3
stride=2
pad=1
activation=leaky
[maxpool]
size=2
stride=2
[convolutional]
filters=4
size=3
pad=1
activation=leaky
[upsample]
stride=2
[route]
layers=-1,0
[convolutional]
filters=18
size=1
activation=linear
[yolo]
mask=0,1,2
anchors=6,6, 10,10, 16,16
classes=1
num=3
"""


def test_layers_that_a_route_concatenates_share_one_range() -> None:
    cfg = parse_cfg(BRANCHES, Path("branches.cfg"))
    assert quantised_layers(cfg) == [0, 2]
    assert merge_ranges(cfg, {0: (-1.0, 2.0), 2: (-0.5, 7.0)}) == {0: (-1.0, 7.0), 2: (-1.0, 7.0)}


@needs_openvino
def test_ranges_are_those_of_the_layers_outputs_and_eight_bits_stay_close() -> None:
    """Against ONNX Runtime: the extremes of a layer, and the quantised network's maps."""
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra [dev]")
    from droptrack.detection.engines.openvino import OpenVinoEngine, kernel_max, output_ranges
    from droptrack.network.onnx_export import onnx_model

    cfg = parse_cfg(BRANCHES, Path("branches.cfg"))
    rng = np.random.default_rng(5)
    weights = random_weights(cfg, rng)
    frame = rng.integers(0, 256, (64, 64, 3)).astype(np.uint8)
    ranges = output_ranges(cfg, weights, [0, 2], [frame])
    model = onnx_model(cfg, weights, taps=[0, 2])
    session = runtime.InferenceSession(model.SerializeToString())
    image = frame[None, ..., ::-1].transpose(0, 3, 1, 2).astype(np.float32) / np.float32(255)
    exact_map, first, second = session.run(None, {"images": image})
    assert ranges[0] == pytest.approx((first.min(), first.max()), abs=1e-5)
    assert ranges[2] == pytest.approx((second.min(), second.max()), abs=1e-5)
    quantisation = Quantisation(merge_ranges(cfg, ranges), kernel_max())
    quantised = onnx_model(cfg, weights, quantisation=quantisation)
    session = runtime.InferenceSession(quantised.SerializeToString())
    (theirs,) = session.run(None, {"images": image})
    engine = OpenVinoEngine(cfg, weights, "int8", 0.25, merge_ranges(cfg, ranges))
    (ours,) = engine.start(engine.prepare([frame])).result().outputs
    spread = float(np.ptp(exact_map))
    assert 0 < np.abs(ours - exact_map).max() < 0.03 * spread
    assert np.abs(ours - theirs).max() < 0.02 * spread


def calibration(
    weights: Path,
    fallen: tuple[float, float] = (0.989, 0.892),
    size: tuple[int, int] = (960, 480),
) -> Calibration:
    ranges = dict.fromkeys(quantised_layers(CFG), (-1.0, 10.0))
    return Calibration(
        weights_sha256=sha256_of(weights),
        width=size[0],
        height=size[1],
        ranges=ranges,
        n_calibrated=8,
        n_checked=9,
        map_fp32=(0.99, 0.9),
        map_int8=fallen,
        pruning=NO_PRUNING,
    )


def test_a_calibration_is_kept_beside_the_weights_and_holds_for_them_only(tmp_path: Path) -> None:
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    kept = calibration(weights)
    path = write_calibration(weights, kept)
    assert path == tmp_path / "mine-int8-960x480.npz"
    assert find_calibration(weights, CFG) == kept
    assert find_calibration(weights, resized(CFG, 416, 224)) is None
    weights.write_bytes(b"two")
    assert find_calibration(weights, CFG) is None
    for damage in (b"{}", path.read_bytes()[:200]):
        path.write_bytes(damage)
        with pytest.raises(DroptrackError, match=r"npz: is no calibration"):
            find_calibration(weights, CFG)


def test_a_calibration_for_any_size_holds_where_none_is_for_that_size(tmp_path: Path) -> None:
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    for_any, for_one = calibration(weights, size=(0, 0)), calibration(weights)
    assert write_calibration(weights, for_any) == tmp_path / "mine-int8.npz"
    assert find_calibration(weights, CFG) == for_any
    write_calibration(weights, for_one)
    assert find_calibration(weights, CFG) == for_one
    assert find_calibration(weights, resized(CFG, 416, 224)) == for_any


def test_a_calibration_goes_to_the_cache_where_the_weights_cannot_have_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    (tmp_path / "mine-int8-960x480.partial.npz").mkdir()  # so that it cannot be written
    kept = calibration(weights)
    path = write_calibration(weights, kept)
    assert path.parent == tmp_path / "cache" / "droptrack"
    assert find_calibration(weights, CFG) == kept


@pytest.mark.parametrize("fallen", [(0.9879, 0.9), (float("nan"), 0.9)])
def test_eight_bits_that_cost_too_much_are_refused(
    tmp_path: Path, fallen: tuple[float, float]
) -> None:
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    with pytest.raises(DroptrackError, match=r"int8 is refused: mAP falls from 0\.9900"):
        write_calibration(weights, calibration(weights, fallen))
    assert find_calibration(weights, CFG) is None


@needs_openvino
def test_the_command_calibrates_for_any_size(tmp_path: Path) -> None:
    data = tmp_path / "data"
    for _ in make_dataset(data, Recipe(scene="b", images=12, valid=6, seed=1), workers=1):
        pass
    weights = tmp_path / "mine.weights"
    shutil.copy(BUNDLED_WEIGHTS, weights)
    arguments = ["calibrate", "--weights", str(weights), "--cfg", str(CFG.path)]
    result = CliRunner().invoke(app, [*arguments, "--data", str(data / "obj.data")])
    assert result.exit_code == 0, result.output
    for size in ((320, 320), (1216, 608)):
        kept = find_calibration(weights, resized(CFG, *size))
        assert kept is not None
        assert (kept.width, kept.height) == (0, 0)
        assert kept.losses[0] <= quantisation.MAX_LOSS


@needs_openvino
@pytest.mark.parametrize(("error", "pruned"), [("0.0002", True), ("1", False)])
def test_the_command_calibrates_on_a_data_set(tmp_path: Path, error: str, pruned: bool) -> None:
    """An error that costs too much is made smaller, down to none."""
    data = tmp_path / "data"
    for _ in make_dataset(data, Recipe(scene="b", images=12, valid=12, seed=1), workers=1):
        pass
    weights = tmp_path / "mine.weights"
    shutil.copy(BUNDLED_WEIGHTS, weights)
    arguments = ["calibrate", "--weights", str(weights), "--cfg", str(CFG.path)]
    arguments += ["--data", str(data / "obj.data"), "--size", "480x256", "--prune", error]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    cfg = resized(CFG, 480, 256)
    kept = find_calibration(weights, cfg)
    assert kept is not None
    assert (kept.n_calibrated, kept.n_checked) == (12, 12)
    assert kept.map_fp32[0] > 0.9
    assert kept.losses[0] <= quantisation.MAX_LOSS
    assert kept.pruning.kept.keys() >= ({8, 10, 12, 14, 21} if pruned else set())
    assert bool(kept.pruning.reconstructions) == pruned
    engine = choose_detector(
        Network(cfg, weights, threshold=0.25, max_iou=0.45), precision=Precision.int8
    ).engine
    assert engine.name == "openvino int8" + pruned * ", pruned"
