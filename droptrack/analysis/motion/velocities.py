"""Velocities: their autocorrelation, their profiles, and what they fluctuate by."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.paths import Paths
from droptrack.data.arrays import Floats, Rows

MAX_LAG = 1000  # frames
CELLS = 16  # along x and along y, for the mean velocity of a place
MIN_IN_CELL = 10  # rows, to be a mean
PROFILE_BINS = 20


def correlation_lags(longest: int) -> Rows:
    """Lags from 0: all up to 20, then more and more apart, up to half of the longest path."""
    last = min(max(longest // 2, 0), MAX_LAG)
    few = np.arange(min(last, 20) + 1)
    return np.unique(np.concatenate([few, np.geomspace(1, max(last, 1), 25).astype(np.int64)]))


def autocorrelation(paths: Paths, velocities: Floats, lags: Rows) -> tuple[Floats, Floats]:
    """Sums and counts (N, L) of v(t) . v(t + lag) of velocities (S, 2), over all frames t."""
    shape = (paths.n_droplets, len(lags))
    sums, counts = np.zeros(shape), np.zeros(shape)
    for k, lag in enumerate(lags.tolist()):
        later = np.full(velocities.shape, np.nan)
        if lag < len(later):
            same = paths.owners[lag:] == paths.owners[: len(later) - lag]
            later[: len(later) - lag] = np.where(same[:, None], velocities[lag:], np.nan)
        product = (velocities * later).sum(axis=1)
        sums[:, k], counts[:, k] = paths.sums(product), paths.counts(np.isfinite(product))
    return sums, counts


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Of each of N droplets in B bins with middles (B,) px: sums of values, and counts, (N, B)."""

    middles: Floats
    sums: Floats
    counts: Floats


def profile(paths: Paths, along: Floats, values: Floats, bins: int = PROFILE_BINS) -> Profile:
    """Values (S,) in bins of places (S,) px, of equal width over all places; NaN is left out."""
    known = np.flatnonzero(np.isfinite(along) & np.isfinite(values))
    if not len(known):
        none = np.zeros((paths.n_droplets, 0))
        return Profile(middles=np.zeros(0), sums=none, counts=none)
    low, high = along[known].min(), along[known].max()
    width = max((high - low) / bins, 1e-9)
    at = np.clip(((along[known] - low) / width).astype(np.int64), 0, bins - 1)
    flat, n = paths.owners[known] * bins + at, paths.n_droplets * bins
    return Profile(
        middles=low + (np.arange(bins) + 0.5) * width,
        sums=np.bincount(flat, values[known], n).reshape(-1, bins).astype(float),
        counts=np.bincount(flat, minlength=n).reshape(-1, bins).astype(float),
    )


def fluctuations(paths: Paths, velocities: Floats) -> Floats:
    """Velocities (S, 2) less the mean of all droplets and frames in the same cell of a grid.

    The grid has 16 x 16 cells over all places. Scaled by sqrt(n / (n - 1)), since the mean is of
    the n rows themselves; NaN in cells with fewer than ten rows.
    """
    found = np.full(velocities.shape, np.nan)
    known = np.flatnonzero(np.isfinite(velocities).all(axis=1))
    if not len(known):
        return found
    places = paths.places[known]
    low = places.min(axis=0)
    widths = np.maximum((places.max(axis=0) - low) / CELLS, 1e-9)
    cells = np.clip(((places - low) / widths).astype(np.int64), 0, CELLS - 1)
    flat = cells[:, 0] * CELLS + cells[:, 1]
    n = np.bincount(flat, minlength=CELLS**2)
    count = np.maximum(n, 1)
    means = np.column_stack(
        [np.bincount(flat, velocities[known, k], CELLS**2) / count for k in range(2)]
    )
    scale = np.where(n >= MIN_IN_CELL, np.sqrt(count / np.maximum(count - 1, 1)), np.nan)
    found[known] = (velocities[known] - means[flat]) * scale[flat, None]
    return found
