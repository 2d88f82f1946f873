"""Which bundled model `track` takes by itself: for discs, and for rims between walls."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.data.detections import Detections
from droptrack.detection.model_choice import agreement
from droptrack.track import app

PLACES = [(120.0 + 200 * column, 110.0 + 190 * row) for column in range(4) for row in range(2)]


def video_of(path: Path, *, rims: bool) -> None:
    """Eight droplets that move by 2 px a frame: white on black, or dark rims between walls."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (960, 480))
    rng = np.random.default_rng(0)
    for frame in range(12):
        canvas = np.full((480, 960), 150 if rims else 0, np.uint8)
        for x, y in PLACES:
            centre = (round(x + 2 * frame), round(y))
            cv2.circle(canvas, centre, 40, 60 if rims else 255, 3 if rims else -1, cv2.LINE_AA)
            for wall in (centre[1] - 50, centre[1] + 50):
                cv2.line(canvas, (0, wall), (960, wall), 80 if rims else 0, 3)
        noisy = np.clip(canvas + rng.normal(0, 2, canvas.shape), 0, 255).astype(np.uint8)
        writer.write(cv2.cvtColor(noisy, cv2.COLOR_GRAY2BGR))
    writer.release()


@pytest.mark.parametrize(("rims", "model"), [(False, "simulations"), (True, "footage")])
def test_the_model_that_suits_the_frames_is_taken(tmp_path: Path, rims: bool, model: str) -> None:
    video_of(tmp_path / "video.avi", rims=rims)
    out = tmp_path / "out"
    told = [str(tmp_path / "video.avi"), "--out", str(out), "--no-video"]
    result = CliRunner().invoke(app, told)
    assert result.exit_code == 0, result.output
    report = json.loads((out / "report.json").read_text())
    assert report["settings"]["model"] == model
    assert report["summary"]["n_droplets"] == len(PLACES)
    assert ("as laboratories film them" in result.output) is rims


def test_a_model_that_is_named_is_taken(tmp_path: Path) -> None:
    video_of(tmp_path / "video.avi", rims=False)
    out = tmp_path / "out"
    told = [str(tmp_path / "video.avi"), "--out", str(out), "--no-video", "--weights", "footage"]
    assert CliRunner().invoke(app, told).exit_code == 0
    report = json.loads((out / "report.json").read_text())
    assert report["settings"]["network"].endswith("yolov3-tiny-footage.weights")
    assert report["summary"]["n_droplets"] == len(PLACES)


def droplets(*boxes: tuple[float, float, float, float]) -> Detections:
    n = len(boxes)
    return Detections(np.array(boxes).reshape(-1, 4), np.ones(n), np.zeros(n, np.int64))


def test_agreement_is_the_f1_over_all_frames() -> None:
    """By hand: 2 + 0 of 3 + 1 and 2 + 2 droplets are the same, so 2 * 2 / 8."""
    these = [droplets((10, 10, 8, 8), (50, 10, 8, 8), (90, 10, 8, 8)), droplets((10, 10, 8, 8))]
    those = [droplets((11, 10, 8, 8), (50, 11, 8, 8)), droplets((30, 10, 8, 8), (16, 10, 8, 8))]
    assert agreement(these, those) == pytest.approx(0.5)
    assert agreement([droplets()], [droplets()]) == 0
