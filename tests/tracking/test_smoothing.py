"""The vectorised filter and smoother against filterpy's general ones, droplet by droplet."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from droptrack.data.trajectories import sorted_trajectories
from droptrack.tracking import smoothing
from droptrack.tracking.recorder import Recorded
from droptrack.tracking.smoothing import Smoother

Floats = NDArray[np.float64]


def table(rng: np.random.Generator, n_frames: int) -> Recorded:
    """Five droplets that come and go, some positions bridged, some only a box's centre."""
    parts = []
    for droplet, (start, end) in enumerate([(0, n_frames), (3, 40), (0, 7), (20, 21), (9, 55)]):
        frames = np.arange(start, min(end, n_frames))
        n = len(frames)
        path = np.cumsum(rng.normal([2, -1], 0.4, (n, 2)), axis=0) + rng.uniform(50, 200, 2)
        size = np.full(n, rng.uniform(15, 40))
        observed = rng.random(n) > 0.2
        observed[[0, -1]] = True
        measured = observed & (rng.random(n) > 0.3)
        parts.append(
            np.column_stack([frames, np.full(n, droplet + 1), path, size, observed, measured])
        )
    rows = np.concatenate(parts)
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    boxes = np.column_stack([rows[:, 2:4], rows[:, 4], rows[:, 4]])
    return Recorded(
        sorted_trajectories(
            rows[:, 0].astype(np.int64),
            rows[:, 1].astype(np.int64),
            rows[:, 2],
            rows[:, 3],
            boxes,
            np.ones(len(rows)),
            rows[:, 5] > 0,
        ),
        rows[:, 6] > 0,
    )


def smoothed(recorded: Recorded, at_once: int = 10) -> Floats:
    """All rows through the smoother, some frames at a time: columns (M, 4)."""
    smoother, done = Smoother(), []
    rows = recorded.rows
    for start in range(0, int(rows.frame[-1]) + 1, at_once):
        part = (rows.frame >= start) & (rows.frame < start + at_once)
        done += list(smoother.add(Recorded(rows[part], recorded.measured[part])))
    done += list(smoother.rest())
    np.testing.assert_array_equal(np.concatenate([r.rows.x for r, _ in done]), rows.x)
    return np.concatenate([columns for _, columns in done])


def reference(recorded: Recorded, droplet: int, axis: str) -> tuple[Floats, Floats]:
    """filterpy's smoothed positions and velocities of one coordinate of one droplet."""
    mine = recorded.rows.track_id == droplet
    rows, measured = recorded.rows[mine], recorded.measured[mine]
    d = rows.boxes[0, 2]
    values = getattr(rows, axis)
    noise = np.where(measured, smoothing.CENTRE_OF_MASS_NOISE, smoothing.BOX_CENTRE_NOISE) * d
    f = KalmanFilter(dim_x=2, dim_z=1)
    f.F, f.H = np.array([[1.0, 1], [0, 1]]), np.array([[1.0, 0]])
    kick = np.array([[0.5], [1.0]]) * smoothing.ACCELERATION * d
    f.Q = kick @ kick.T
    f.x = np.array([[values[0]], [0.0]])
    f.P = np.diag([noise[0] ** 2, (smoothing.FIRST_VELOCITY * d) ** 2])
    means, covariances = [f.x.copy()], [f.P.copy()]
    for t in range(1, len(rows)):
        f.predict()
        if rows.observed[t]:
            f.update(values[t], R=noise[t] ** 2)
        means.append(f.x.copy())
        covariances.append(f.P.copy())
    x, _, _, _ = f.rts_smoother(np.array(means), np.array(covariances))
    return x[:, 0, 0], x[:, 1, 0]


@pytest.mark.parametrize(("n_frames", "tolerance"), [(59, 1e-9), (200, 1e-6)])
def test_smoothed_positions_and_velocities_are_filterpys(n_frames: int, tolerance: float) -> None:
    """Up to 2 LAG frames to rounding; beyond, what comes after LAG frames does not matter."""
    recorded = table(np.random.default_rng(0), n_frames)
    columns = smoothed(recorded)
    for droplet in np.unique(recorded.rows.track_id):
        mine = recorded.rows.track_id == droplet
        for k, axis in enumerate("xy"):
            position, velocity = reference(recorded, int(droplet), axis)
            np.testing.assert_allclose(columns[mine, k], position, atol=tolerance)
            np.testing.assert_allclose(columns[mine, 2 + k], velocity, atol=tolerance)


@pytest.mark.parametrize("at_once", [1, 7, 60, 1000])
def test_it_does_not_matter_how_many_frames_are_given_at_once(at_once: int) -> None:
    recorded = table(np.random.default_rng(4), 400)
    np.testing.assert_array_equal(smoothed(recorded, at_once), smoothed(recorded))


def test_a_million_frames_would_take_no_more_memory_than_sixty() -> None:
    recorded = table(np.random.default_rng(1), 400)
    smoother, held = Smoother(), []
    for frame in range(400):
        part = recorded.rows.frame == frame
        list(smoother.add(Recorded(recorded.rows[part], recorded.measured[part])))
        held.append(len(smoother._frames))
    assert max(held) < 2 * smoothing.LAG


def test_a_droplet_that_is_seen_once_stays_where_it_is() -> None:
    recorded = table(np.random.default_rng(2), 59)
    once = recorded.rows.track_id == 4
    assert once.sum() == 1
    columns = smoothed(recorded)[once]
    expected = [[recorded.rows.x[once][0], recorded.rows.y[once][0], 0, 0]]
    np.testing.assert_allclose(columns, expected)


def test_no_rows_give_no_rows() -> None:
    smoother = Smoother()
    recorded = table(np.random.default_rng(3), 25)
    none = np.zeros(len(recorded.rows), bool)
    assert list(smoother.add(Recorded(recorded.rows[none], recorded.measured[none]))) == []
    assert list(smoother.rest()) == []
