"""Networks evaluated on labelled images, through the command."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.scenes.dataset import Recipe, make_dataset
from data_gen.scenes.shapes import draw_ellipses
from droptrack.data.darknet_dataset import read_data_file, read_image, read_scenes
from droptrack.evaluate import app
from tests.pipeline.two_classes import write_two_classes


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("validation") / "data"
    for _ in make_dataset(folder, Recipe(scene="tiny", images=2, valid=40, seed=9), 1):
        pass
    return folder / "obj.data"


def test_the_bundled_model_finds_the_paper_s_droplets(data: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    result = CliRunner().invoke(app, ["--data", str(data), "--json", str(report)])
    assert result.exit_code == 0, result.output
    content = json.loads(report.read_text())
    summary, scenes = content["summary"], {row["scene"]: row for row in content["droplets"]}
    assert {scene: row["n_images"] for scene, row in scenes.items()} == {"a": 20, "b": 20}
    assert scenes["b"]["n_droplets"] == 40  # two cores each
    assert summary["n_droplets"] == scenes["a"]["n_droplets"] + 40
    for scores in (summary, *scenes.values()):
        assert scores["map_50"] > 0.99
        assert scores["coco_ap_50"] == pytest.approx(scores["map_50"], abs=0.02)
        assert 0.7 < scores["coco_ap_50_95"] < scores["coco_ap_50"]
        assert scores["f1"] > 0.95
        assert scores["average_iou"] > 0.85


@pytest.mark.parametrize(
    ("options", "engine"),
    [
        ((), "opencv fp32"),
        (("--precision", "auto"), "opencv fp32, pruned"),
        (("--backend", "torch", "--precision", "bf16"), "torch bf16"),
    ],
)
def test_all_of_the_network_is_evaluated_unless_another_is_named(
    options: tuple[str, ...], engine: str, data: Path, tmp_path: Path
) -> None:
    if "torch" in options:
        pytest.importorskip("torch", reason="needs the extra [train]")
    report = tmp_path / "report.json"
    arguments = ["--data", str(data), "--images", "10", "--json", str(report), *options]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    content = json.loads(report.read_text())
    assert content["settings"]["engine"] == engine
    assert content["summary"]["map_50"] > 0.99


def test_dark_droplets_are_found_as_bright_ones_of_the_negative(data: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(data.parent, tmp_path / "dark")
    dark = read_data_file(folder / "obj.data")
    for path in dark.valid:
        cv2.imwrite(str(path), 255 - read_image(path))
    found = {}
    for options in ((), ("--dark",)):
        report = tmp_path / f"report{len(options)}.json"
        arguments = ["--data", str(dark.path), "--json", str(report), *options]
        assert CliRunner().invoke(app, arguments).exit_code == 0
        found[options] = json.loads(report.read_text())["summary"]["map_50"]
    assert found["--dark",] > 0.99
    assert found[()] < 0.5


def test_scenes_are_read_back_as_they_take_turns(data: Path) -> None:
    listed = read_data_file(data)
    scenes = read_scenes(listed)
    assert [scenes[image] for image in listed.valid] == list(20 * "ab")
    (data.parent / "scenes.txt").rename(data.parent / "away.txt")
    assert read_scenes(listed) == {}
    (data.parent / "away.txt").rename(data.parent / "scenes.txt")


def test_half_a_question_is_refused(data: Path, tmp_path: Path) -> None:
    for arguments in ([], [str(tmp_path / "truth.csv")], ["--weights", "x.weights"]):
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 1
        assert "give GROUND_TRUTH.csv and TRAJECTORIES.csv, or --data obj.data" in result.output
    missing = CliRunner().invoke(app, ["--data", str(data.parent / "no.data")])
    assert "no.data: no such file" in missing.output


def test_each_class_has_its_precision_by_the_command(tmp_path: Path) -> None:
    """Five images of a disc of 32 px, small, and one of 120 px, large.

    In one image the large disc is labelled small: of small ones 5 of 6 are found and nothing else,
    5/6. Of four large ones all are found, with one false among them: at least 4/5.
    """
    weights = write_two_classes(tmp_path)
    lines = []
    for t in range(5):
        canvas = np.zeros((480, 960), np.uint8)
        draw_ellipses(canvas, np.array([[60.0 + 9 * t, 60, 16, 16, 0], [250, 250, 60, 60, 0]]), 255)
        path = tmp_path / f"{t}.png"
        cv2.imwrite(str(path), canvas)
        boxes = (0, (60.0 + 9 * t, 60, 32)), (int(t > 0), (250, 250, 120))
        labels = [f"{k} {x / 960} {y / 480} {w / 960} {w / 480}" for k, (x, y, w) in boxes]
        path.with_suffix(".txt").write_text("\n".join(labels) + "\n")
        lines.append(f"{path}\n")
    for name in ("train.txt", "valid.txt"):
        (tmp_path / name).write_text("".join(lines))
    data = tmp_path / "obj.data"
    data.write_text("classes = 2\ntrain = train.txt\nvalid = valid.txt\nnames = two.names\n")
    arguments = ["--data", str(data), "--weights", str(weights), "--json", str(tmp_path / "r.json")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "r.json").read_text())["summary"]
    small, large = (one.split() for one in summary["ap_50_of_class"])
    assert (small[0], large[0]) == ("small", "large")
    assert float(small[1]) == pytest.approx(5 / 6, abs=1e-4)
    assert 0.8 <= float(large[1]) <= 1
    assert summary["map_50"] == pytest.approx((5 / 6 + float(large[1])) / 2, abs=1e-4)
