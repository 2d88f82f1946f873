"""Which way each droplet goes in each frame, also relative to the flow."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from droptrack.analysis.paths import Paths
from droptrack.data.arrays import Bools, Floats, Rows

STILL_PX = 1e-5  # shorter steps are the rounding of files: they have no direction
SPREAD = 2  # cells of the grid of the local flow in its smoothing length
REACH = 4 * SPREAD  # cells beyond which the smoothing ends


@dataclass(frozen=True, kw_only=True)
class Headings:
    """K droplets in frames, in their order, that have a direction.

    rows (K,) of the table; frames, owners (K,): which of the N droplets; places (K, 2) px;
    velocities (K, 2) px a frame, to the next frame.
    """

    rows: Rows
    frames: Rows
    owners: Rows
    places: Floats
    velocities: Floats
    n_droplets: int

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def angles(self) -> Floats:
        """Angles (K,) of the velocities with the x axis, rad, y down, -pi to pi."""
        return np.arctan2(self.velocities[:, 1], self.velocities[:, 0])

    def __getitem__(self, some: Bools | Rows | slice) -> "Headings":
        return replace(
            self,
            rows=self.rows[some],
            frames=self.frames[some],
            owners=self.owners[some],
            places=self.places[some],
            velocities=self.velocities[some],
        )

    def relative_to(self, flow: Floats) -> "Headings":
        """Those that move relative to a flow (K, 2) px a frame, by their velocities in it."""
        moved = replace(self, velocities=self.velocities - flow)
        return moved[_moving(moved.velocities)]


def headings_of(paths: Paths) -> tuple[Headings, Mapping[str, int]]:
    """The headings from each frame to the next, and how many rows of the paths have none, and why.

    Positions are those of both frames: there is no heading across a gap.
    """
    steps = paths.displacements(1)
    there = paths.rows >= 0
    known = np.isfinite(steps[:, 0])
    moving = _moving(steps)
    order = np.flatnonzero(moving)[np.argsort(paths.rows[moving])]
    headings = Headings(
        rows=paths.rows[order],
        frames=paths.frames[order],
        owners=paths.owners[order],
        places=paths.places[order],
        velocities=steps[order],
        n_droplets=paths.n_droplets,
    )
    return headings, {
        "n_excluded_no_next_frame": int((there & ~known).sum()),
        "n_excluded_standing_still": int((known & ~moving).sum()),
    }


def mean_flow(headings: Headings) -> Floats:
    """The mean velocity of the droplets of each one's frame, itself included, (K, 2) px a frame."""
    _, at = np.unique(headings.frames, return_inverse=True)
    count = np.bincount(at)
    means = [np.bincount(at, headings.velocities[:, k]) / count for k in range(2)]
    return np.column_stack(means)[at]


def local_flow(headings: Headings, length: float) -> Floats:
    """The velocity of the other droplets around the same place, all frames, (K, 2) px a frame.

    A mean with Gaussian weights, whose standard deviation is `length` px, on a grid of half of it.
    Each droplet's own rows are left out: else it would be compared with itself. NaN where the
    others were never near.
    """
    if not len(headings):
        return headings.velocities
    cell = length / SPREAD
    low = headings.places.min(axis=0)
    cells = np.floor((headings.places - low) / cell).astype(int) + REACH
    shape = tuple((cells.max(axis=0) + REACH + 1).tolist())
    everything = _smooth(cells, headings.velocities, shape)
    flow = np.full(headings.velocities.shape, np.nan)
    order = np.argsort(headings.owners, kind="stable")
    starts = np.flatnonzero(np.diff(headings.owners[order])) + 1
    for some in np.split(order, starts):
        mine = cells[some]
        corner = mine.min(axis=0) - REACH
        around = tuple((mine.max(axis=0) - corner + REACH + 1).tolist())
        own = _smooth(mine - corner, headings.velocities[some], around)
        inner = mine - corner
        others = everything[mine[:, 0], mine[:, 1]] - own[inner[:, 0], inner[:, 1]]
        weight = others[:, 2]
        # a thousandth of one row at the very place: less is rounding and the kernel's tail
        enough = weight > 1e-3 / (2 * np.pi * SPREAD**2)
        flow[some[enough]] = others[enough, :2] / weight[enough, None]
    return flow


def _smooth(cells: Rows, velocities: Floats, shape: tuple[int, ...]) -> Floats:
    """Sums of velocities, and counts, on a grid, smoothed, (H, W, 3)."""
    flat = np.ravel_multi_index((cells[:, 0], cells[:, 1]), shape)
    size = int(np.prod(shape))
    sums = [np.bincount(flat, values, size) for values in (*velocities.T, np.ones(len(cells)))]
    grids = [
        gaussian_filter(one.reshape(shape), SPREAD, mode="constant", truncate=REACH / SPREAD)
        for one in sums
    ]
    return np.stack(grids, axis=-1)


def _moving(velocities: Floats) -> Bools:
    return np.asarray(np.hypot(*velocities.T) > STILL_PX)  # false for NaN
