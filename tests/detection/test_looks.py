"""Several looks at a frame: their mean, of what each of them shows."""

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections, iou_matrix
from droptrack.data.frames import Frame
from droptrack.data.region import Region
from droptrack.data.stage_times import StageTimes
from droptrack.detection.looks import SeveralLooks, fuse, look_factors


def found(boxes: Sequence[Sequence[float]], score: float, class_id: int = 0) -> Detections:
    n = len(boxes)
    return Detections(
        np.array(boxes, float).reshape(-1, 4), np.full(n, score), np.full(n, class_id)
    )


class Sees:
    """Stands for a detector that always finds the same."""

    max_iou = 0.3

    def __init__(self, detections: Detections) -> None:
        self._found = detections
        self.shown: list[Frame] = []

    def start(self, frames: Sequence[Frame], _: StageTimes) -> Callable[[], list[Detections]]:
        self.shown += frames
        return lambda: [self._found] * len(frames)


def test_looks_agree_on_what_most_of_them_show() -> None:
    """Two droplets; the second in one of three looks. Scores are means over all looks."""
    looks = [found([[50, 50, 20, 20], [120, 50, 20, 20]], 0.9)]
    looks += [found([[51, 50, 20, 20]], 0.6), found([[49, 50, 20, 22]], 0.6)]
    fused, shares = fuse(looks)
    assert len(fused) == 2
    assert fused.scores == pytest.approx([0.7, 0.3])
    assert shares == pytest.approx([1, 1 / 3])
    expected = (0.9 * 50 + 0.6 * 51 + 0.6 * 49) / 2.1
    assert fused.boxes[0, 0] == pytest.approx(expected)
    assert fused.boxes[0, 3] == pytest.approx((0.9 * 20 + 0.6 * 20 + 0.6 * 22) / 2.1)


def test_the_class_is_that_of_the_surest_look() -> None:
    looks = [found([[50, 50, 20, 20]], score, k) for k, score in ((0, 0.6), (2, 0.9), (0, 0.7))]
    assert fuse(looks)[0].class_ids.tolist() == [2]


def test_a_look_shows_a_droplet_once() -> None:
    """Of two boxes about as large, of one look, the nearer one is the droplet's."""
    looks = [found([[50, 50, 20, 20]], 0.9), found([[52, 50, 20, 20], [55, 50, 20, 20]], 0.6)]
    fused, shares = fuse(looks)
    assert sorted(shares.tolist()) == [0.5, 1]
    assert fused.scores.tolist() == pytest.approx([0.75, 0.3])


def test_nothing_seen_is_nothing() -> None:
    fused, shares = fuse([found([], 0.5)] * 3)
    assert (len(fused), len(shares)) == (0, 0)


def test_any_many_boxes_are_fused_as_a_plain_search_would() -> None:
    """1,500 boxes of three looks, overlapping: the same as by a matrix of all IoUs."""
    rng = np.random.default_rng(4)
    looks = []
    for _ in range(3):
        boxes = np.column_stack([rng.uniform(0, 300, (500, 2)), rng.uniform(8, 40, (500, 2))])
        looks.append(Detections(boxes, rng.uniform(0.05, 1, 500), np.zeros(500, int)))
    fused, shares = fuse(looks)
    boxes = np.concatenate([look.boxes for look in looks])
    scores = np.concatenate([look.scores for look in looks])
    iou, free, expected = iou_matrix(boxes, boxes), np.ones(1500, bool), []
    for i in np.argsort(-scores):
        if free[i]:
            members = []
            for look in range(3):
                mine = iou[i] * free * (np.arange(1500) // 500 == look)
                if mine.max() >= 0.5:
                    members.append(mine.argmax())
            free[members] = False
            expected.append((scores[members].sum() / 3, len(members) / 3))
    np.testing.assert_allclose(np.column_stack([fused.scores, shares]), expected)


@pytest.mark.parametrize(
    ("n", "factors"), [(1, [1]), (2, [1, 0.8]), (5, [1, 0.8, 1.25, 0.64, 1.5625])]
)
def test_looks_are_around_the_scale_chosen(n: int, factors: list[float]) -> None:
    assert look_factors(n) == pytest.approx(factors)


def test_the_mean_has_to_reach_the_score_wanted() -> None:
    """0.9 in one of two looks is 0.45; 0.6 in both is 0.6. The second is mirrored: 150 - 90."""
    one, both = found([[50, 50, 20, 20]], 0.9), found([[90, 50, 20, 20]], 0.6)
    together = Detections(
        np.concatenate([one.boxes, both.boxes]), np.array([0.9, 0.6]), np.zeros(2, int)
    )
    looks: Any = [Sees(together), Sees(found([[60, 50, 20, 20]], 0.6))]
    frame = np.random.default_rng(1).integers(0, 256, (100, 150, 3)).astype(np.uint8)
    (seen,) = SeveralLooks(looks, 0.5).detect([frame])
    assert seen.boxes[:, 0].tolist() == [90]
    (seen,) = SeveralLooks(looks, 0.4).detect([frame])
    assert sorted(seen.scores.tolist()) == pytest.approx([0.45, 0.6])
    np.testing.assert_array_equal(looks[0].shown[0], frame)
    np.testing.assert_array_equal(looks[1].shown[0], cv2.flip(frame, 1))


def test_the_region_is_that_of_the_frame_and_not_of_the_mirrored_one() -> None:
    looks: Any = [Sees(found([[30, 50, 20, 20], [120, 50, 20, 20]], 0.9))]
    looks.append(Sees(found([[30, 50, 20, 20], [120, 50, 20, 20]], 0.9)))
    left = Region.read("0,0 75,0 75,100 0,100", 150, 100)
    (seen,) = SeveralLooks(looks, 0.4, left).detect([np.zeros((100, 150, 3), np.uint8)])
    assert seen.boxes[:, 0].tolist() == [30]


def rings(path: Path, *, mirrored: bool = False) -> None:
    image = np.full((360, 480), 150, np.uint8)
    for k, (x, y) in enumerate([(70, 80), (200, 90), (350, 110), (110, 250), (300, 270)]):
        cv2.circle(image, (x, y), 18 + 2 * k, 60, 3, cv2.LINE_AA)
    cv2.imwrite(str(path), cv2.flip(image, 1) if mirrored else image)


def detect(source: Path, out: Path, *options: str) -> tuple[Floats, dict[str, Any]]:
    """Boxes and scores (N, 5), and the report's settings."""
    arguments = [str(source), "--out", str(out), "--no-shape", "--no-images", *options]
    result = CliRunner().invoke(app, ["detect", *arguments])
    assert result.exit_code == 0, result.output
    with (out / "detections.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["w"]]
    values = [[float(row[k]) for k in ("box_x", "box_y", "w", "h", "score")] for row in rows]
    return np.array(values).reshape(-1, 5), json.loads((out / "report.json").read_text())[
        "settings"
    ]


def test_an_image_is_seen_at_three_scales_and_their_mean_counts(tmp_path: Path) -> None:
    """Against three runs of one look each, that at 0.8 of the mirrored image; by distance."""
    rings(tmp_path / "rings.png")
    rings(tmp_path / "mirrored.png", mirrored=True)
    footage = ("--weights", "footage", "--precision", "fp32")
    together, settings = detect(
        tmp_path / "rings.png", tmp_path / "all", *footage, "--scale", "1", "--score", "0.2"
    )
    assert settings["looks"] == 3
    assert len(together) == 5
    expected = np.zeros((5, 2))
    for scale, image in (("1", "rings.png"), ("0.8", "mirrored.png"), ("1.25", "rings.png")):
        options = (*footage, "--scale", scale, "--looks", "1", "--score", "0.05")
        one = detect(tmp_path / image, tmp_path / scale, *options)[0]
        if image == "mirrored.png":
            one[:, 0] = 480 - one[:, 0]
        distances = np.hypot(*(together[:, None, :2] - one[None, :, :2]).T).T
        rows, columns = linear_sum_assignment(distances)
        near = distances[rows, columns] < 10
        scores = one[columns[near], 4]
        expected[rows[near]] += np.column_stack([scores / 3, scores * one[columns[near], 2]])
    np.testing.assert_allclose(together[:, 4], expected[:, 0], atol=1e-4)
    np.testing.assert_allclose(together[:, 2], expected[:, 1] / expected[:, 0] / 3, atol=0.01)


def test_networks_at_their_own_size_and_frames_of_videos_have_one_look(
    sine: Path, tmp_path: Path
) -> None:
    rings(tmp_path / "rings.png")
    simulations = ("--weights", "simulations")
    assert detect(tmp_path / "rings.png", tmp_path / "own", *simulations)[1]["looks"] == 1
    scaled = detect(tmp_path / "rings.png", tmp_path / "scaled", *simulations, "--scale", "1")[1]
    assert scaled["looks"] == 3
    assert detect(sine / "video.avi", tmp_path / "video", "--weights", "footage")[1]["looks"] == 1


def test_frames_of_a_video_have_as_many_looks_as_wanted(sine: Path, tmp_path: Path) -> None:
    arguments = [str(sine / "video.avi"), "--out", str(tmp_path / "out"), "--no-video"]
    options = ["--weights", "footage", "--looks", "2", "--max-frames", "3"]
    result = CliRunner().invoke(app, ["track", *arguments, *options])
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["settings"]["looks"] == 2
    assert report["summary"]["n_droplets"] == 12  # by hand


def test_looks_at_a_size_that_is_given_are_refused(tmp_path: Path) -> None:
    rings(tmp_path / "rings.png")
    arguments = [str(tmp_path / "rings.png"), "--out", str(tmp_path / "out")]
    options = ["--size", "480x384", "--looks", "3"]
    result = CliRunner().invoke(app, ["detect", *arguments, *options])
    assert result.exit_code == 1
    assert "--size and --looks" in result.output
