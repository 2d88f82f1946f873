"""Paths whose lengths one can count by hand."""

import math

import numpy as np

from droptrack.data.trajectories import Trajectories, sorted_trajectories
from droptrack.pipeline.paths import MAX_POINTS, Paths, counted


def rows(points: list[tuple[int, int, float, float, bool]]) -> Trajectories:
    """Of frame, identity, x, y and whether observed; boxes are 4 x 9 px."""
    n = len(points)
    frame, track_id, x, y, observed = (np.array(column) for column in zip(*points, strict=True))
    boxes = np.column_stack([x, y, np.full(n, 4.0), np.full(n, 9.0)])
    return sorted_trajectories(frame, track_id, x, y, boxes, np.ones(n), observed)


def test_a_path_is_as_long_as_its_steps() -> None:
    paths = Paths()
    paths.add(rows([(3, 2, 0.0, 0.0, True), (4, 1, 7.0, 7.0, True), (4, 2, 3.0, 4.0, False)]))
    paths.add(rows([(5, 2, 3.0, 5.0, True)]))
    first, second = paths.table()
    assert (first["track_id"], first["path_px"], first["n_observed"]) == (1, 0.0, 1)
    assert math.isnan(float(first["speed_px_per_frame"]))  # type: ignore[arg-type]
    assert second == {
        "track_id": 2,
        "first_frame": 3,
        "last_frame": 5,
        "n_observed": 2,
        "n_bridged": 1,
        "diameter_px": 6.0,
        "path_px": 6.0,
        "speed_px_per_frame": 3.0,
    }


def test_lines_are_thinned_but_reach_the_end() -> None:
    paths = Paths()
    paths.add(rows([(t, 1, 0.5 * t, 0.0, True) for t in range(101)]))
    (line,) = paths.lines().values()
    assert line[:, 0].tolist() == [*np.arange(0, 50.1, 2.5).tolist(), 50.0]


def test_long_lines_are_thinned_more_and_keep_their_shape() -> None:
    """A hundred thousand steps of 5 px along a parabola."""
    paths = Paths()
    t = np.arange(100_000)
    x, y = 5.0 * t, 1e-4 * (5.0 * t) ** 2
    for part in np.array_split(t, 10):
        paths.add(rows([(k, 1, x[k], y[k], True) for k in part.tolist()]))
    (line,) = paths.lines().values()
    assert MAX_POINTS / 4 < len(line) <= MAX_POINTS + 1
    assert (line[0].tolist(), line[-1].tolist()) == ([0, 0], [x[-1], np.float32(y[-1])])
    np.testing.assert_allclose(line[:, 1], 1e-4 * line[:, 0].astype(float) ** 2, rtol=1e-5)


def test_droplets_enter_and_leave_at_the_side_that_they_go_through() -> None:
    """In 100 x 50 px: one passes from left to right along the bottom, one comes from the top and
    is lost in the middle, one is there all the time."""
    across = [(t, 1, 4.0 + 10 * (t - 1), 45.0, True) for t in range(1, 11)]
    down = [(t, 2, 30.0, 2.0 + 6 * t, True) for t in range(1, 5)]
    stays = [(t, 3, 70.0, 20.0, True) for t in range(12)]
    paths = Paths()
    paths.add(rows([*across, *down, *stays]))
    entered, left = paths.passages(100, 50)
    assert counted(entered) == ["left 1", "top 1"]
    assert counted(left) == ["right 1", "inside 1"]


def test_droplets_enter_and_leave_at_the_border_that_cuts_them() -> None:
    """In 200 x 200 px, from 60 to 140 px in x: one passes, cut at both ends; one is lost whole."""
    passing, lost = np.arange(60, 141, 10), np.arange(80, 121, 10)
    at = np.concatenate([passing, lost]).astype(float)
    frames = np.concatenate([np.arange(1, 10), np.arange(1, 6)])
    cut = np.isin(at, [60, 140]).astype(float)
    n = len(at)
    y = np.full(n, 100.0)
    boxes = np.column_stack([at, y, np.full((n, 2), 20.0)])
    paths = Paths()
    for some in (slice(9), slice(9, n)):
        ids = np.full(n, 1 if some.start is None else 2)
        paths.add(
            sorted_trajectories(
                frames[some],
                ids[some],
                at[some],
                y[some],
                boxes[some],
                np.ones(n)[some],
                np.ones(n, bool)[some],
                {"at_edge": cut[some]},
            )
        )
    paths.add(rows([(t, 3, 90.0, 30.0, True) for t in range(12)]))
    entered, left = paths.passages(200, 200)
    assert (counted(entered), counted(left)) == (["border 1", "inside 1"], ["border 1", "inside 1"])
