"""Headings beside the mean heading of the neighbours, and beside shuffled headings.

M. Durve et al. (2021), "Flocks of droplets?": theta_S is the circular mean of the headings of the
droplets within R; the share of all droplets and frames with abs(theta_i - theta_S) < 0.12 rad.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from droptrack.analysis.flock.headings import Headings
from droptrack.analysis.neighbourhoods import blocks_with_pairs, shuffled
from droptrack.data.arrays import Bools, Floats, Rows

MAX_SHUFFLES = 20
SHUFFLED_ROWS = 5_000_000  # of all shuffles together: more only takes longer


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """How K headings are aligned with those of their neighbours.

    neighbours (K,): the circular mean of their headings, NaN without any; n_neighbours (K,); of
    each of N droplets in how many frames it has neighbours, is aligned, and is aligned by chance,
    the mean of shuffles, all (N,).
    """

    neighbours: Floats
    n_neighbours: Rows
    compared: Floats
    aligned: Floats
    by_chance: Floats


def wrapped(angles: Floats) -> Floats:
    """Angles in -pi to pi.

    >>> wrapped(np.array([3 * np.pi / 2, -0.1])).round(3).tolist()
    [-1.571, -0.1]
    """
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)


def mean_of_neighbours(angles: Floats, first: Rows, second: Rows) -> tuple[Floats, Rows]:
    """The circular mean (K,) of the angles (K,) of each one's neighbours, and their number (K,).

    `first` and `second` are the pairs. NaN without neighbours, and where they cancel out.
    """
    n = len(angles)
    x, y = (
        np.bincount(first, one[second], n) + np.bincount(second, one[first], n)
        for one in (np.cos(angles), np.sin(angles))
    )
    count = np.bincount(first, minlength=n) + np.bincount(second, minlength=n)
    known = np.hypot(x, y) > 1e-9 * np.maximum(count, 1)
    return np.where(known, np.arctan2(y, x), np.nan), count


def align(
    headings: Headings, radius: float, threshold: float, rng: np.random.Generator, task: str
) -> Alignment:
    """How headings are aligned with the neighbours within `radius` px, by a threshold, rad."""
    angles, n = headings.angles, headings.n_droplets
    mean, count = np.full(len(headings), np.nan), np.zeros(len(headings), np.int64)
    compared, aligned, by_chance = np.zeros(n), np.zeros(n), np.zeros(n)
    shuffles = int(np.clip(SHUFFLED_ROWS // max(len(headings), 1), 1, MAX_SHUFFLES))
    for block, *pairs in blocks_with_pairs(headings.frames, headings.places, radius, task):
        mine, owners = angles[block], headings.owners[block]
        mean[block], count[block] = mean_of_neighbours(mine, pairs[0], pairs[1])
        compared += np.bincount(owners[np.isfinite(mean[block])], minlength=n)
        aligned += np.bincount(owners[_within(mine, mean[block], threshold)], minlength=n)
        for _ in range(shuffles):
            other = mine[shuffled(headings.frames[block], rng)]
            hits = _within(other, mean_of_neighbours(other, pairs[0], pairs[1])[0], threshold)
            by_chance += np.bincount(owners[hits], minlength=n)
    return Alignment(
        neighbours=mean,
        n_neighbours=count,
        compared=compared,
        aligned=aligned,
        by_chance=by_chance / shuffles,
    )


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Counts for R radii and T thresholds, of each of N droplets.

    compared (N, R); aligned, by_chance (N, R, T); n_neighbours (R,) on average.
    """

    compared: Floats
    aligned: Floats
    by_chance: Floats
    n_neighbours: Floats


def sweep(
    headings: Headings, radii: Sequence[float], thresholds: Floats, rng: np.random.Generator
) -> Sweep:
    """The same as `align` for several radii, px, and thresholds (T,), rad; one shuffle."""
    n, shape = headings.n_droplets, (headings.n_droplets, len(radii), len(thresholds))
    found = Sweep(
        compared=np.zeros(shape[:2]),
        aligned=np.zeros(shape),
        by_chance=np.zeros(shape),
        n_neighbours=np.zeros(len(radii)),
    )
    angles, widest = headings.angles, max(radii)
    for block, first, second in blocks_with_pairs(
        headings.frames, headings.places, widest, "radii and thresholds"
    ):
        mine, owners = angles[block], headings.owners[block]
        other = mine[shuffled(headings.frames[block], rng)]
        places = headings.places[block]
        apart = np.hypot(*(places[first] - places[second]).T)
        for k, radius in enumerate(radii):
            near = apart <= radius
            mean, count = mean_of_neighbours(mine, first[near], second[near])
            chance, _ = mean_of_neighbours(other, first[near], second[near])
            found.compared[:, k] += np.bincount(owners[np.isfinite(mean)], minlength=n)
            found.n_neighbours[k] += count.sum() / max(len(headings), 1)
            for m, threshold in enumerate(thresholds.tolist()):
                for counts, of, means in (
                    (found.aligned, mine, mean),
                    (found.by_chance, other, chance),
                ):
                    hits = _within(of, means, threshold)
                    counts[:, k, m] += np.bincount(owners[hits], minlength=n)
    return found


def _within(angles: Floats, means: Floats, threshold: float) -> Bools:
    return np.asarray(np.abs(wrapped(angles - means)) < threshold)  # false for NaN
