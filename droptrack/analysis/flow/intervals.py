"""Intervals between passages: how long, how irregular, their tail, and clogs."""

import math
from collections.abc import Sequence

import numpy as np

from droptrack.analysis.bootstrap import ratio, resampled, standard_error
from droptrack.analysis.flow.tails import MIN_VALUES, Tail, fit_tail
from droptrack.analysis.records import TIME, Quantity
from droptrack.data.arrays import Floats
from droptrack.tracking.events.passages import Passage

CLOG = 10.0  # median intervals: by chance one of a thousand is longer
POISSON = "passages that know nothing of each other, as many (Poisson)"


def intervals_of(found: Sequence[Passage]) -> Floats:
    """Frames between passages one after the other, in the direction of most of them."""
    if not found:
        return np.zeros(0)
    way = 1 if sum(one.forward for one in found) >= 0 else -1
    return np.diff(np.array([one.frame for one in found if one.forward == way]))


def interval_quantities(
    intervals: Floats, clog_frames: float | None, no_line: str, rng: np.random.Generator
) -> list[Quantity]:
    """All that is said of intervals (N,), frames; no_line: why there are none to be had."""
    n = len(intervals)
    powers = np.column_stack([intervals, intervals**2])
    means = ratio(powers, np.ones_like(powers))
    samples = resampled(powers, np.ones_like(powers), rng)
    few = no_line or ("" if n else "fewer than two droplets pass the line")
    two = few or ("" if n > 1 else "there is one interval")

    def irregularity(of: Floats) -> Floats:
        variance = np.maximum(of[..., 1] - of[..., 0] ** 2, 0.0) * n / max(n - 1, 1)
        return np.asarray(np.sqrt(variance) / of[..., 0])

    return [
        Quantity(
            stem="mean_interval", label="Interval between passages", value=float(means[0]),
            error=float(standard_error(samples[:, 0])), dimension=TIME, reason=few,
            definition="mean; errors of intervals are by bootstrap over intervals",
        ),
        Quantity(
            stem="interval_irregularity", label="Irregularity of the intervals",
            value=float(irregularity(means)) if n > 1 else float("nan"),
            error=float(standard_error(irregularity(samples))) if n > 1 else float("nan"),
            null=1.0, null_model=POISSON, reason=two,
            definition="standard deviation over mean: 0 for a regular train",
        ),
        Quantity(
            stem="longest_interval", label="Longest interval", dimension=TIME,
            value=float(intervals.max()) if n else float("nan"), reason=few,
            null=float(means[0] * (math.log(n) + np.euler_gamma)) if n else float("nan"),
            null_model=POISSON, definition="between two passages; what was going on when the "
            "recording began or ended is not in it",
        ),
        *_tail(fit_tail(intervals), n, no_line),
        *_clogs(intervals, clog_frames, two, rng),
    ]  # fmt: skip


def _tail(tail: Tail | None, n: int, no_line: str) -> list[Quantity]:
    why = no_line
    if not why and tail is None:
        why = f"needs {MIN_VALUES} intervals that differ, there are {n}"
    nan = float("nan")
    where = f" from {tail.least:.4g} frames on ({tail.n} intervals)" if tail else ""
    return [
        Quantity(
            stem="interval_tail_exponent", label="Tail exponent of the intervals",
            value=tail.exponent if tail else nan, error=tail.error if tail else nan, null=2.0,
            null_model="at 2 or below the mean diverges: a flow that clogs (I. Zuriguel et al. "
            "2014)", reason=why, definition=f"a of p(t) ~ t^-a{where}, maximum likelihood, from "
            "where on it fits best (Clauset et al. 2009); the error is that of the likelihood",
        ),
        Quantity(
            stem="interval_tail_log_likelihood_ratio", label="Power law against exponential tail",
            value=tail.likelihood if tail else nan, null=0.0,
            null_model=f"both as good; p = {tail.p:.2g}" if tail else "both as good",
            definition="above 0 the power law is more likely, below 0 the exponential: there is "
            "a power law only where this is well above 0", reason=why,
        ),
    ]  # fmt: skip


def _clogs(
    intervals: Floats, clog_frames: float | None, two: str, rng: np.random.Generator
) -> list[Quantity]:
    n = len(intervals)
    limit = clog_frames
    if limit is None:
        limit = CLOG * float(np.median(intervals)) if n else float("nan")
    clogs = np.where(intervals > limit, intervals, 0.0)[:, None]
    whole = intervals[:, None]
    value = float(ratio(clogs, whole)[0]) if n > 1 else float("nan")
    error = float(standard_error(resampled(clogs, whole, rng))[0]) if n > 1 else float("nan")
    mean = float(intervals.mean()) if n else float("nan")
    null = (1 + limit / mean) * math.exp(-limit / mean) if n and mean > 0 else float("nan")
    return [
        Quantity(
            stem="n_clogs", label="Clogs",
            value=float((clogs > 0).sum()) if n > 1 else float("nan"),
            null=n * math.exp(-limit / mean) if n and mean > 0 else float("nan"),
            null_model=POISSON, reason=two,
            definition=f"intervals longer than {limit:.4g} frames (--clog, or ten medians)",
        ),
        Quantity(
            stem="clogged_share", label="Share of time in clogs", value=value, error=error,
            null=null, null_model=POISSON, reason=two,
            definition="sum of these intervals over that of all",
        ),
    ]  # fmt: skip
