"""Rows of a table -> paths: each droplet's frames in a run, with NaN where it was not seen.

In that order a displacement over any lag is a difference of two slices, gaps and all.
"""

from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.trajectories import Trajectories
from droptrack.errors import DroptrackError

MAX_GAPS = 20  # times as many frames in gaps as rows: more are no tracks of one video


@dataclass(frozen=True, kw_only=True)
class Paths:
    """N droplets' frames, S in all, one droplet after the other, none left out in between.

    ids (N,), of rising identity; owners (S,), which of the N; frames (S,); places (S, 2) px, NaN
    in gaps; rows (S,) of the table, -1 in gaps.
    """

    ids: Rows
    owners: Rows
    frames: Rows
    places: Floats
    rows: Rows

    @property
    def n_droplets(self) -> int:
        """How many droplets there are."""
        return len(self.ids)

    def displacements(self, lag: int, places: Floats | None = None) -> Floats:
        """How far each is a `lag` of frames later (S, 2) px; NaN where either end is not known.

        `places` (S, 2) stand in for the own ones.
        """
        of = self.places if places is None else places
        found = np.full(of.shape, np.nan)
        if 0 < lag < len(of):
            same = self.owners[lag:] == self.owners[:-lag]
            found[:-lag] = np.where(same[:, None], of[lag:] - of[:-lag], np.nan)
        return found

    def sums(self, values: Floats) -> Floats:
        """Sums over each droplet (N,) of values (S,), NaN left out."""
        return np.bincount(self.owners, np.nan_to_num(values), self.n_droplets).astype(float)

    def counts(self, known: Bools) -> Floats:
        """How many of each droplet's frames (S,) are so, (N,)."""
        return np.bincount(self.owners[known], minlength=self.n_droplets).astype(float)

    @property
    def longest(self) -> int:
        """Frames from a droplet's first to its last, of the longest path."""
        return int(np.bincount(self.owners).max(initial=0))

    def on_rows(self, values: Floats, n_rows: int) -> Floats:
        """Values (S, ...) on the rows of the table (n_rows, ...), NaN for rows in no path."""
        found = np.full((n_rows, *values.shape[1:]), np.nan)
        there = self.rows >= 0
        found[self.rows[there]] = values[there]
        return found


def paths_of(rows: Trajectories, kept: Bools | None = None) -> Paths:
    """The paths of the rows (M,) that are `kept` (M,); the others are gaps.

    A droplet missed in frame 1:

    >>> from droptrack.data.trajectories import sorted_trajectories
    >>> rows = sorted_trajectories(
    ...     np.array([0, 2, 3]), np.ones(3, np.int64), np.array([1.0, 5, 8]), np.zeros(3),
    ...     np.ones((3, 4)), np.ones(3), np.ones(3, bool),
    ... )
    >>> paths_of(rows).displacements(1)[:, 0].tolist()
    [nan, nan, 3.0, nan]
    >>> paths_of(rows).displacements(2)[:, 0].tolist()
    [4.0, nan, nan, nan]
    """
    some = np.arange(len(rows)) if kept is None else np.flatnonzero(kept)
    order = some[np.lexsort((rows.frame[some], rows.track_id[some]))]
    ids, first, counts = np.unique(rows.track_id[order], return_index=True, return_counts=True)
    frames = rows.frame[order]
    starts = frames[first]
    lengths = frames[first + counts - 1] - starts + 1 if len(ids) else counts
    total = int(lengths.sum())
    if total > (MAX_GAPS + 1) * len(some) + 1000:
        raise DroptrackError(
            f"the tracks have {total - len(some)} frames in gaps, and {len(some)} rows: are they "
            "of one video?"
        )
    offsets = np.cumsum(lengths) - lengths
    owners = np.repeat(np.arange(len(ids)), lengths)
    at = np.repeat(offsets - starts, counts) + frames
    places, of_rows = np.full((total, 2), np.nan), np.full(total, -1)
    places[at, 0], places[at, 1] = rows.x[order], rows.y[order]
    of_rows[at] = order
    return Paths(
        ids=ids,
        owners=owners,
        frames=np.arange(total) - np.repeat(offsets - starts, lengths),
        places=places,
        rows=of_rows,
    )


def free_of_drift(paths: Paths) -> Floats:
    """Places (S, 2) px less the drift: the mean step of all droplets, summed from the start.

    Frames over which no droplet is tracked take the drift of those around them.
    """
    steps = paths.displacements(1)
    if not len(paths.frames):
        return paths.places
    first = int(paths.frames.min())
    at, n = paths.frames - first, int(paths.frames.max()) - first + 1
    known = np.isfinite(steps[:, 0])
    count = np.bincount(at[known], minlength=n)
    drift = np.zeros((n, 2))
    if not known.any():
        return paths.places
    there = np.flatnonzero(count)
    for k in range(2):
        mean = np.bincount(at[known], steps[known, k], n)[there] / count[there]
        drift[1:, k] = np.cumsum(np.interp(np.arange(n - 1), there, mean))
    return np.asarray(paths.places - drift[at])
