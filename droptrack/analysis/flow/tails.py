"""How a distribution ends: as a power law, or sooner.

A. Clauset, C. R. Shalizi and M. E. J. Newman, SIAM Review 51, 661 (2009): the exponent by maximum
likelihood above the least value x_min, which is where the Kolmogorov-Smirnov distance is least; and
Vuong's test against an exponential tail.
"""

import math
from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Floats

MIN_VALUES = 50  # below, Clauset et al. find nothing that holds
MIN_TAIL = 10
MAX_TRIED = 500  # values that are tried as x_min


@dataclass(frozen=True, kw_only=True)
class Tail:
    """p(x) ~ x^-exponent from `least` on, n values; error: of the exponent.

    likelihood: that of the power law over that of an exponential tail, as a logarithm; p: the
    probability of a logarithm as far from 0 were both as good.
    """

    exponent: float
    error: float
    least: float
    n: int
    distance: float
    likelihood: float
    p: float


def fit_tail(values: Floats) -> Tail | None:
    """The tail of values (N,) above 0; None for fewer than 50, or ones that are all equal.

    >>> rng = np.random.default_rng(0)
    >>> tail = fit_tail(rng.pareto(1.5, 5000) + 1)  # p(x) ~ x^-2.5
    >>> bool(abs(tail.exponent - 2.5) < 3 * tail.error)
    True
    """
    x = np.sort(values[values > 0])
    if len(x) < MIN_VALUES or x[0] == x[-1]:
        return None
    candidates = np.unique(x)
    candidates = candidates[candidates <= x[-MIN_TAIL]]
    if len(candidates) > MAX_TRIED:
        candidates = candidates[np.linspace(0, len(candidates) - 1, MAX_TRIED).astype(int)]
    fits = [_fit(x[np.searchsorted(x, one) :], one) for one in candidates.tolist()]
    distance, exponent, least = min(fits)
    if not math.isfinite(distance):
        return None
    tail = x[x >= least]
    likelihood, p = _against_exponential(tail, exponent, least)
    return Tail(
        exponent=exponent,
        error=(exponent - 1) / math.sqrt(len(tail)),
        least=least,
        n=len(tail),
        distance=distance,
        likelihood=likelihood,
        p=p,
    )


def _fit(tail: Floats, least: float) -> tuple[float, float, float]:
    """Distance, exponent and least value of a sorted tail."""
    logs = float(np.log(tail / least).sum())
    if logs <= 0:
        return math.inf, math.nan, least
    n = len(tail)
    exponent = 1 + n / logs
    expected = 1 - (tail / least) ** (1 - exponent)
    below = np.searchsorted(tail, tail, side="left") / n
    above = np.searchsorted(tail, tail, side="right") / n
    gap = max(np.abs(expected - below).max(), np.abs(above - expected).max())
    return float(gap), exponent, least


def _against_exponential(tail: Floats, exponent: float, least: float) -> tuple[float, float]:
    mean = float(tail.mean()) - least
    if mean <= 0:
        return math.nan, math.nan
    power = math.log((exponent - 1) / least) - exponent * np.log(tail / least)
    decay = -math.log(mean) - (tail - least) / mean
    difference = power - decay
    spread = float(difference.std())
    total = float(difference.sum())
    if spread <= 0:
        return total, math.nan
    return total, math.erfc(abs(total) / (spread * math.sqrt(2 * len(tail))))
