"""How droplets turn around a centre, such as cores in a sheared shell."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.paths import Paths
from droptrack.data.arrays import Floats


@dataclass(frozen=True, kw_only=True)
class Turns:
    """Steps (S,) rad of paths around a centre, NaN where not known; above 0: clockwise, seen."""

    steps: Floats
    sums: Floats
    counts: Floats


def turns(paths: Paths, centre: tuple[float, float] | None) -> Turns:
    """The steps around a centre, px; None: the mean of the droplets that both frames have.

    Of one droplet alone, around the mean of its path.
    """
    steps = paths.displacements(1)
    known = np.isfinite(steps[:, 0])
    if centre is not None:
        before = paths.places - np.array(centre)
        after = before + steps
    elif paths.n_droplets == 1:
        before = paths.places - np.nanmean(paths.places, axis=0)
        after = before + steps
    else:
        before, after = _around_the_mean(paths, steps)
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    angles = np.where(known, np.arctan2(cross, (before * after).sum(axis=1)), np.nan)
    return Turns(steps=angles, sums=paths.sums(angles), counts=paths.counts(np.isfinite(angles)))


def _around_the_mean(paths: Paths, steps: Floats) -> tuple[Floats, Floats]:
    """Places (S, 2) before and after a step, less the mean of those that make it together."""
    known = np.isfinite(steps[:, 0])
    first = int(paths.frames.min(initial=0))
    at = paths.frames - first
    size = int(at.max(initial=0)) + 1
    n = np.maximum(np.bincount(at[known], minlength=size), 1)
    moved = []
    for of in (paths.places, paths.places + steps):
        mean = np.column_stack([np.bincount(at[known], of[known, k], size) / n for k in range(2)])
        moved.append(of - mean[at])
    alone = n[at] < 2
    for one in moved:
        one[alone] = np.nan
    return moved[0], moved[1]
