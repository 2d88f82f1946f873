"""Errors by block bootstrap: whole droplets are drawn again and again, never single rows.

Rows of one droplet depend on each other, so a droplet is a block. Every quantity here is a ratio of
two sums over droplets, so each droplet's two sums are all that is needed.
"""

import numpy as np

from droptrack.data.arrays import Floats

DRAWS = 400
MAX_WEIGHTS = 4_000_000  # of draws times droplets at once, 32 MB


def ratio(numerators: Floats, denominators: Floats) -> Floats:
    """The sums over N droplets (N, K) of one over those of the other, (K,); NaN for 0 / 0."""
    return _divided(np.asarray(numerators.sum(axis=0)), np.asarray(denominators.sum(axis=0)))


def resampled(
    numerators: Floats, denominators: Floats, rng: np.random.Generator, draws: int = DRAWS
) -> Floats:
    """The same ratio for `draws` draws of N of the N droplets with replacement, (draws, K).

    All NaN where fewer than two droplets have anything to say: then there is no error.

    >>> rng = np.random.default_rng(0)
    >>> values = rng.normal(5.0, 2.0, (100, 1))
    >>> some = resampled(values, np.ones((100, 1)), rng)
    >>> bool(abs(some.std() - 2.0 / 10) < 0.03)
    True
    """
    known = np.flatnonzero((denominators != 0).any(axis=1))
    n, width = len(known), numerators.shape[1]
    if n < 2:
        return np.full((draws, width), np.nan)
    above, below = numerators[known], denominators[known]
    found, step = [], max(1, MAX_WEIGHTS // n)
    for start in range(0, draws, step):
        weights = rng.multinomial(n, np.full(n, 1 / n), min(step, draws - start)).astype(float)
        found.append(_divided(weights @ above, weights @ below))
    return np.concatenate(found)


def standard_error(samples: Floats) -> Floats:
    """The standard deviation of samples (B, ...) over the first axis; NaN where there is none.

    Draws without the few droplets that say something are left out, as long as half remain.
    """
    known = np.isfinite(samples)
    n = known.sum(axis=0)
    some = np.where(known, samples, 0.0)
    mean = some.sum(axis=0) / np.maximum(n, 1)
    square = np.where(known, (samples - mean) ** 2, 0.0).sum(axis=0)
    enough = n > max(1, len(samples) // 2)
    return np.asarray(np.where(enough, np.sqrt(square / np.maximum(n - 1, 1)), np.nan))


def ratio_and_error(
    numerators: Floats, denominators: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """A ratio (K,) of sums over droplets (N, K), and its error (K,)."""
    return ratio(numerators, denominators), standard_error(resampled(numerators, denominators, rng))


def _divided(above: Floats, below: Floats) -> Floats:
    return np.asarray(np.divide(above, below, out=np.full(above.shape, np.nan), where=below != 0))
