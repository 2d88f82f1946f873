"""Scores of drawings whose answer one can count by eye."""

import math
from pathlib import Path

import numpy as np
import pytest

from droptrack.data.trajectories import Trajectories, sorted_trajectories, write_trajectories
from droptrack.errors import DroptrackError
from droptrack.evaluation.trajectories import evaluate, height_of

Point = tuple[int, int, float, float]  # frame, identity, x, y


def table(points: list[Point], score: float = 1.0, size: float = 10.0) -> Trajectories:
    rows = np.array(points, float).reshape(-1, 4)
    n = len(rows)
    boxes = np.column_stack([rows[:, 2:], np.full((n, 2), size)])
    return sorted_trajectories(
        rows[:, 0].astype(int),
        rows[:, 1].astype(int),
        rows[:, 2],
        rows[:, 3],
        boxes,
        np.full(n, score),
        np.ones(n, bool),
    )


def lane(identity: int, y: float, frames: range, dx: float = 0, dy: float = 0) -> list[Point]:
    return [(t, identity, 20.0 + 3 * t + dx, y + dy) for t in frames]


TEN = range(10)


def test_a_copy_of_the_ground_truth_is_perfect() -> None:
    truth = table(lane(1, 50, TEN) + lane(2, 90, TEN))
    summary = evaluate(truth, truth, 100).summary
    assert summary["n_droplets_found_in_every_frame"] == 2
    assert [summary[k] for k in ("n_missed", "n_switches", "n_fragments", "n_false")] == [0] * 4
    assert summary["mota"] == 1
    assert summary["mse_position_px2"] == 0


def test_errors_are_given_in_every_unit() -> None:
    """0.3 px to the right and 0.4 px down, droplets of 10 px, image 200 px high."""
    truth, found = table(lane(1, 50, TEN)), table(lane(7, 50, TEN, dx=0.3, dy=0.4))
    report = evaluate(truth, found, 200)
    expected = {
        "mse_y_px2": 0.16,
        "mse_y_heights2": 0.16 / 200**2,
        "mse_y_diameters2": 0.16 / 100,
        "mse_position_px2": 0.25,
        "mse_position_heights2": 0.25 / 200**2,
        "mse_position_diameters2": 0.25 / 100,
    }
    for key, value in expected.items():
        assert report.summary[key] == pytest.approx(value)
        assert report.droplets[0][key] == pytest.approx(value)
    assert report.droplets[0]["found_as"] == [7]


def test_mean_over_all_weighs_every_frame_alike() -> None:
    """Nine frames off by 1 px and one droplet with one frame off by 2 px: (9 x 1 + 4) / 10."""
    truth = table(lane(1, 50, range(9)) + lane(2, 90, range(1)))
    found = table(lane(1, 50, range(9), dy=1) + lane(2, 90, range(1), dy=2))
    assert evaluate(truth, found, math.nan).summary["mse_y_px2"] == pytest.approx(1.3)


def test_exchanged_identities_are_two_switches() -> None:
    truth = table(lane(1, 50, TEN) + lane(2, 90, TEN))
    found = table(
        lane(1, 50, range(5))
        + lane(2, 90, range(5))
        + lane(2, 50, range(5, 10))
        + lane(1, 90, range(5, 10))
    )
    report = evaluate(truth, found, 100)
    assert report.summary["n_switches"] == 2
    assert report.summary["mota"] == pytest.approx(1 - 2 / 20)
    assert [row["found_as"] for row in report.droplets] == [[1, 2], [2, 1]]


def test_a_gap_is_missed_frames_and_one_fragment() -> None:
    truth = table(lane(1, 50, TEN))
    found = table(lane(1, 50, range(4)) + lane(1, 50, range(7, 10)))
    summary = evaluate(truth, found, 100).summary
    assert [summary[k] for k in ("n_missed", "n_fragments", "n_switches")] == [3, 1, 0]


def test_a_droplet_that_is_not_there_is_false_in_each_frame() -> None:
    truth = table(lane(1, 50, TEN))
    found = table(lane(1, 50, TEN) + lane(2, 90, range(6)))
    assert evaluate(truth, found, 100).summary["n_false"] == 6


def test_beyond_half_a_diameter_it_is_another_place() -> None:
    truth = table(lane(1, 50, TEN))
    near, far = (table(lane(1, 50, TEN, dy=dy)) for dy in (4.9, 5.1))
    assert evaluate(truth, near, 100).summary["n_missed"] == 0
    summary = evaluate(truth, far, 100).summary
    assert (summary["n_missed"], summary["n_false"]) == (10, 10)


def test_a_pair_stays_together_though_another_is_nearer() -> None:
    """CLEAR MOT: identity 2 comes nearer for one frame, but 1 is still within reach."""
    truth = table(lane(1, 50, TEN))
    found = table([*lane(1, 50, TEN, dy=2), (5, 2, 35.0, 50.0)])
    summary = evaluate(truth, found, 100).summary
    assert (summary["n_switches"], summary["n_false"]) == (0, 1)


def test_one_position_is_never_two_droplets() -> None:
    """Both droplets were identity 1 last; in frame 2 it is half way between them: the nearer's."""
    truth = table([(0, 1, 20, 50), (0, 2, 24, 50), (1, 2, 24, 50), (2, 1, 20, 50), (2, 2, 24, 50)])
    found = table([(0, 1, 20, 50), (1, 1, 24, 50), (2, 1, 22.5, 50)])
    report = evaluate(truth, found, 100)
    assert [report.summary[k] for k in ("n_false", "n_missed")] == [0, 2]
    assert [row["n_missed"] for row in report.droplets] == [1, 1]


def test_droplets_cut_off_by_the_edge_may_be_found_or_not() -> None:
    whole, cut = lane(1, 50, range(8)), lane(1, 50, range(8, 10))
    both = table(whole + cut)
    truth = sorted_trajectories(
        both.frame,
        both.track_id,
        both.x,
        both.y,
        both.boxes,
        np.where(both.frame < 8, 1.0, 0.0),
        both.observed,
    )
    for found in (table(whole), both):
        summary = evaluate(truth, found, 100).summary
        assert [summary[k] for k in ("n_positions", "n_missed", "n_false")] == [8, 0, 0]


def test_nothing_found_is_everything_missed_and_errors_are_undefined() -> None:
    summary = evaluate(table(lane(1, 50, TEN)), table([]), 100).summary
    assert summary["n_missed"] == 10
    assert math.isnan(float(summary["mse_y_px2"]))  # type: ignore[arg-type]


def test_files_are_scored_as_what_they_hold_and_say_the_images_height(tmp_path: Path) -> None:
    truth, found = table(lane(1, 50, TEN)), table(lane(7, 50, TEN, dx=0.3, dy=0.4))
    write_trajectories(tmp_path / "truth.csv", truth, {"video": "a.avi, 1200 x 200 px, 25 fps"})
    write_trajectories(tmp_path / "found.csv", found, {})
    report = evaluate(tmp_path / "truth.csv", str(tmp_path / "found.csv"))
    assert report.summary["mse_y_heights2"] == pytest.approx(0.16 / 200**2)
    assert report.summary.keys() == evaluate(truth, found).summary.keys()
    assert math.isnan(float(evaluate(truth, found).summary["mse_y_heights2"]))  # type: ignore[arg-type]
    with pytest.raises(DroptrackError, match=r"missing\.csv: no such file"):
        evaluate(truth, tmp_path / "missing.csv")


def test_height_is_read_from_the_file_that_has_it() -> None:
    assert height_of({}, {"video": "a.avi, 1200 x 600 px, 25 frames/s"}) == 600
    assert math.isnan(height_of({}, {}))
