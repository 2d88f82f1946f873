"""Mean square displacement, its exponent, the van Hove function, the non-Gaussian parameter."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.paths import Paths
from droptrack.data.arrays import Floats, Rows
from droptrack.progress import with_progress

N_LAGS = 30
FIT_SHARE = 0.5  # of the lags, the shorter ones, over which the exponent is fitted
BINS = 41  # of displacements


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Of each of N droplets at L lags (L,) frames: sums of r² and r⁴, and how many, (N, L)."""

    lags: Rows
    second: Floats
    fourth: Floats
    counts: Floats


def lags_for(longest: int, n: int = N_LAGS) -> Rows:
    """Up to n lags, frames, evenly in their logarithm, up to half of the longest path.

    >>> lags_for(9).tolist(), lags_for(1).tolist()
    ([1, 2, 3, 4], [])
    """
    if longest < 2:
        return np.zeros(0, np.int64)
    return np.unique(np.round(np.geomspace(1, max(longest // 2, 1), n)).astype(np.int64))


def moments(paths: Paths, places: Floats, lags: Rows) -> Moments:
    """Moments of displacements from every frame on, of places (S, 2) px.

    Over gaps too: both ends must have been seen, not what is between.
    """
    shape = (paths.n_droplets, len(lags))
    second, fourth, counts = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for k, lag in enumerate(with_progress(lags.tolist(), len(lags), "displacements", "lags")):
        square = (paths.displacements(lag, places) ** 2).sum(axis=1)
        second[:, k], fourth[:, k] = paths.sums(square), paths.sums(square**2)
        counts[:, k] = paths.counts(np.isfinite(square))
    return Moments(lags=lags, second=second, fourth=fourth, counts=counts)


def fit_lags(lags: Rows) -> slice:
    """The lags over which the exponent is fitted: at least three, where there are three."""
    longest = lags.max(initial=1) ** FIT_SHARE
    return slice(0, max(int(np.searchsorted(lags, longest, side="right")), min(len(lags), 3)))


def exponent(lags: Rows, values: Floats) -> Floats:
    """The slope (...) of log values (..., L) over log lags (L,): 1 for diffusion, 2 for flow.

    NaN for fewer than three lags, and where a value is not above 0.

    >>> lags = np.array([1, 2, 4, 8])
    >>> exponent(lags, 3.0 * lags[None] ** 1.5).round(6).tolist()
    [1.5]
    """
    if len(lags) < 3:
        return np.full(values.shape[:-1], np.nan)
    x = np.log(lags) - np.log(lags).mean()
    known = (values > 0).all(axis=-1)
    y = np.log(np.where(values > 0, values, 1.0))
    return np.where(known, y @ x / (x @ x), np.nan)


def van_hove(paths: Paths, places: Floats, lag: int, axis: int) -> tuple[Floats, Floats, float]:
    """Displacements along an axis after a lag: edges (B + 1,) px, counts (N, B), and their rms."""
    steps = paths.displacements(lag, places)[:, axis]
    known = np.isfinite(steps)
    values, owners = steps[known], paths.owners[known]
    rms = float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
    reach = max(float(np.abs(values).max(initial=0.0)), 1e-9)
    edges = np.linspace(-reach, reach, BINS + 1)
    at = np.clip(((values + reach) / (2 * reach) * BINS).astype(np.int64), 0, BINS - 1)
    counts = np.bincount(owners * BINS + at, minlength=paths.n_droplets * BINS)
    return edges, counts.reshape(-1, BINS).astype(float), rms
