"""Velocities of droplets that were seen only once, estimated from their neighbours.

From neighbours whose velocity is known, or, where none is, from the pattern: the displacement with
which a droplet and its neighbours all fall on droplets of the next frame (the relaxation method of
particle tracking velocimetry, Baek & Lee 1996).
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.nearest import nearest, tree_of

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NEIGHBOURS = 6
MIN_NEIGHBOURS = 3  # that make a flow
REACH = 6.0  # diameters within which droplets are neighbours
WEIGHT_LENGTH = 3.0  # diameters, standard deviation of the weight of a neighbour's velocity
MIN_WEIGHT = 1e-300  # so that there is a quotient
CANDIDATES = 24  # places in the next frame that a droplet may have moved to
MATCH = 0.12  # diameters by which a neighbour may deviate from the pattern
MATCH_OF_STEP = 0.06  # the same, of the displacement's length
STEP_PENALTY = 0.02  # of the share, a diameter: of equal candidates, the shorter is right
CHUNK = 2000  # droplets whose candidates are weighed at once
ROUNDS = 3  # of votes
VOTE_LENGTH = 3 * MATCH  # diameters, standard deviation of displacements that vote for another
COMMON_WEIGHT = 0.3  # of the median displacement, in votes


def velocity_of_neighbours(
    points: Floats, diameters: Floats, known: Floats, velocities: Floats
) -> tuple[Floats, Floats]:
    """Mean velocity (N, 2) of the known droplets around points (N, 2), and its variance (N,).

    `known` (K, 2): positions of droplets with velocities (K, 2). Infinite variance where fewer than
    MIN_NEIGHBOURS are near.
    """
    n = len(points)
    if len(known) < MIN_NEIGHBOURS:
        return np.zeros((n, 2)), np.full(n, np.inf)
    k = min(NEIGHBOURS, len(known))
    distance, rows = nearest(tree_of(known), points, k)
    near = distance < REACH * diameters[:, None]
    length = WEIGHT_LENGTH * diameters[:, None]
    weight = np.where(near, np.exp(-((distance / length) ** 2) / 2), 0)
    total = np.maximum(weight.sum(axis=1, keepdims=True), MIN_WEIGHT)
    around = velocities[np.where(near, rows, 0)]  # (N, k, 2)
    mean = (weight[..., None] * around).sum(axis=1) / total
    spread = (weight * ((around - mean[:, None]) ** 2).sum(axis=2)).sum(axis=1) / total[:, 0]
    return mean, np.where(near.sum(axis=1) >= MIN_NEIGHBOURS, spread / 2, np.inf)


class _Candidates(NamedTuple):
    """Displacements that R droplets may have made, and their neighbours before."""

    steps: Floats  # (R, C, 2)
    share: Floats  # (R, C) of the neighbours that follow
    neighbours: Rows  # (R, k), the nearest first

    def chosen(self, best: Rows) -> tuple[Floats, Floats]:
        """The displacements (R, 2) and shares (R,) of one candidate (R,) of each droplet."""
        rows = np.arange(len(best))
        return self.steps[rows, best], self.share[rows, best]


def displacement_of_pattern(
    points: Floats, diameters: Floats, rows: Rows, following: Floats, reach: float
) -> tuple[Floats, Floats]:
    """Displacements (R, 2) of some of the points (N, 2), by them and their neighbours.

    `rows` (R,): which points; `following` (M, 2): where droplets are in the next frame; `reach`:
    the longest displacement in diameters. Also returns (R,) the share of neighbours that follow.
    """
    n = len(rows)
    if not n or len(points) <= MIN_NEIGHBOURS or not len(following):
        return np.zeros((n, 2)), np.zeros(n)
    now, then = tree_of(points), tree_of(following)
    parts = [
        _candidates(points, diameters, rows[start : start + CHUNK], now, then, reach)
        for start in range(0, n, CHUNK)
    ]
    found = _Candidates(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    return found.chosen(_vote(found, rows, len(points), diameters[rows]))


def _vote(found: _Candidates, rows: Rows, n: int, diameters: Floats) -> Rows:
    """The best candidate (R,) of each droplet.

    Where candidates fit equally, as on a lattice, those win that the neighbours and most others
    choose. `n`: all points, of which `rows` (R,) have candidates; `diameters` (R,).
    """
    best = found.share.argmax(axis=1)
    chosen, trusted = np.zeros((n, 2)), np.zeros(n)
    chosen[rows], trusted[rows] = found.chosen(best)
    others = found.neighbours[:, 1:]  # the first is the droplet itself
    for _ in range(ROUNDS):
        around = chosen[others]  # (R, k, 2)
        width = (VOTE_LENGTH * diameters)[:, None, None] ** 2
        apart = ((found.steps[:, :, None] - around[:, None]) ** 2).sum(axis=3)
        votes = np.exp(-apart / (2 * width)) * trusted[others][:, None]
        common = np.median(chosen[rows], axis=0)
        everybody = np.exp(-((found.steps - common) ** 2).sum(axis=2) / (2 * width[:, 0]))
        weight = 1 + votes.mean(axis=2) + COMMON_WEIGHT * everybody
        best = (found.share * weight).argmax(axis=1)
        chosen[rows], _ = found.chosen(best)
    return np.asarray(best)


def _candidates(
    points: Floats, diameters: Floats, rows: Rows, now: "cKDTree", then: "cKDTree", reach: float
) -> _Candidates:
    """Displacements to the nearest points of the next frame, those out of reach with share 0."""
    n = len(rows)
    here, scale = points[rows], diameters[rows]
    steps = np.zeros((n, CANDIDATES, 2))
    share = np.zeros((n, CANDIDATES))
    c = min(CANDIDATES, then.n)
    distance, targets = nearest(then, here, c)
    possible = distance <= reach * scale[:, None]
    steps[:, :c] = np.asarray(then.data)[targets] - here[:, None]
    _, neighbours = nearest(now, here, min(NEIGHBOURS + 1, now.n))
    i, j = np.nonzero(possible)
    expected = points[neighbours[i, 1:]] + steps[i, j][:, None]  # (P, k, 2)
    missed, _ = then.query(expected, 1, distance_upper_bound=float(diameters.max()))
    width = MATCH * scale[i] + MATCH_OF_STEP * distance[i, j]
    fits = np.exp(-((missed / width[:, None]) ** 2) / 2).mean(axis=1)
    share[i, j] = fits * (1 - STEP_PENALTY * distance[i, j] / scale[i])
    return _Candidates(steps, share, neighbours)
