"""Droplets drawn for the tests of analyses."""

from collections.abc import Callable

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.trajectories import Trajectories, sorted_trajectories


def rows_of(places: Floats, diameter: float | Floats = 10.0) -> Trajectories:
    """Rows of places (T, N, 2) px; NaN is a droplet that was missed; diameters px, or (N,)."""
    n_frames, n = places.shape[:2]
    frame, track_id = np.divmod(np.arange(n_frames * n), n)
    x, y = places.reshape(-1, 2).T
    side = np.broadcast_to(diameter, n)[track_id]
    some = np.isfinite(x)
    m = int(some.sum())
    return sorted_trajectories(
        frame[some],
        track_id[some] + 1,
        x[some],
        y[some],
        np.column_stack([x[some], y[some], side[some], side[some]]),
        np.ones(m),
        np.ones(m, bool),
    )


def moving(starts: Floats, velocity: Callable[[int], Floats], n_frames: int) -> Floats:
    """Places (T, N, 2) of droplets that start somewhere (N, 2), with velocities (N, 2) in time."""
    steps = [np.broadcast_to(velocity(t), starts.shape) for t in range(n_frames - 1)]
    return np.cumsum([starts, *steps], axis=0)


def hexagonal(rows: int, columns: int, spacing: float) -> Floats:
    """A hexagonal lattice (N, 2) of rows (an even number) times columns, from 0, 0."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * spacing
