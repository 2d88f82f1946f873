"""How fast a droplet probably moves that has not been seen to move: as its neighbours do.

From neighbours whose velocity is known, or, where none is, from the pattern: the displacement with
which a droplet and its neighbours all fall on droplets of the next frame (the relaxation method of
particle tracking velocimetry, Baek & Lee 1996).
"""

import numpy as np
from scipy.spatial import cKDTree

from droptrack.data.arrays import Floats, Rows

NEIGHBOURS = 6
FEWEST = 3  # neighbours that make a flow
REACH = 6.0  # diameters within which droplets are neighbours
CANDIDATES = 24  # places in the next frame that a droplet may have moved to
MATCH = 0.12  # diameters by which a neighbour may deviate from the pattern,
MATCH_OF_STEP = 0.06  # and of the displacement's length
FEW_PAIRS = 6000  # for which a tree of the points takes longer than all their distances
CHUNK = 2000  # droplets whose candidates are judged at once


def nearest(tree: cKDTree, points: Floats, k: int, reach: float = np.inf) -> tuple[Floats, Rows]:
    """Distances (N, k) and rows (N, k) of the k points of a tree that are nearest to points.

    What is not nearer than `reach` has an infinite distance and no row, but takes no time.
    """
    distance, rows = tree.query(points, range(1, k + 1), distance_upper_bound=reach)
    return np.asarray(distance), np.asarray(rows, np.int64)


def nearest_within(
    points: Floats, reach: Floats, others: Floats, k: int
) -> tuple[Rows, Rows, Floats]:
    """Pairs of points (N, 2) and the k nearest others (M, 2) within `reach` (N,); none below 0.

    Rows of points, rising, rows of others, and distances (P,) of each pair.
    """
    if len(points) * len(others) <= FEW_PAIRS:
        x, y = points[:, :1] - others[:, 0], points[:, 1:] - others[:, 1]
        square = x * x + y * y
        near = square <= (reach * np.abs(reach))[:, None]
        if near.sum(axis=1).max(initial=0) <= k:
            rows, columns = np.nonzero(near)
            return rows, columns, np.sqrt(square[rows, columns])
    k = min(k, len(others))
    distance, found = nearest(cKDTree(others), points, k, float(reach.max()) * (1 + 1e-9))
    rows, place = np.nonzero(distance <= reach[:, None])
    return rows, found[rows, place], distance[rows, place]


def velocity_of_neighbours(
    points: Floats, diameters: Floats, known: Floats, velocities: Floats
) -> tuple[Floats, Floats]:
    """Mean velocity (N, 2) of the known droplets around points (N, 2), and its variance (N,).

    `known` (K, 2): positions of droplets with velocities (K, 2). Infinite variance where fewer than
    three are near.
    """
    n = len(points)
    if len(known) < FEWEST:
        return np.zeros((n, 2)), np.full(n, np.inf)
    k = min(NEIGHBOURS, len(known))
    distance, rows = nearest(cKDTree(known), points, k)
    near = distance < REACH * diameters[:, None]
    weight = np.where(near, np.exp(-((distance / (3 * diameters[:, None])) ** 2) / 2), 0)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    around = velocities[np.where(near, rows, 0)]  # (N, k, 2)
    mean = (weight[..., None] * around).sum(axis=1) / total
    spread = (weight * ((around - mean[:, None]) ** 2).sum(axis=2)).sum(axis=1) / total[:, 0]
    return mean, np.where(near.sum(axis=1) >= FEWEST, spread / 2, np.inf)


def displacement_of_pattern(
    points: Floats, diameters: Floats, rows: Rows, following: Floats, reach: float
) -> tuple[Floats, Floats]:
    """Displacements (R, 2) of some of the points (N, 2), told by them and their neighbours.

    `rows` (R,): which points; `following` (M, 2): where droplets are in the next frame; `reach`:
    the longest displacement in diameters. Also returns (R,) the share of neighbours that follow.
    """
    n = len(rows)
    if not n or len(points) <= FEWEST or not len(following):
        return np.zeros((n, 2)), np.zeros(n)
    now, then = cKDTree(points), cKDTree(following)
    steps = np.zeros((n, CANDIDATES, 2))
    support = np.zeros((n, CANDIDATES))
    neighbours = np.zeros((n, min(NEIGHBOURS + 1, len(points))), np.int64)
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        steps[part], support[part], neighbours[part] = _support(
            points, diameters, rows[part], now, then, reach
        )
    best = support.argmax(axis=1)
    chosen = np.zeros_like(points)
    chosen[rows] = steps[np.arange(n), best]
    trusted = np.zeros(len(points))
    trusted[rows] = support[np.arange(n), best]
    # where candidates fit alike, as on a lattice, the neighbours' and everybody's choices tell
    for _ in range(3):
        around = chosen[neighbours[:, 1:]]  # (R, k, 2)
        width = (3 * MATCH * diameters[rows])[:, None, None] ** 2
        apart = ((steps[:, :, None] - around[:, None]) ** 2).sum(axis=3)
        votes = np.exp(-apart / (2 * width)) * trusted[neighbours[:, 1:]][:, None]
        common = np.median(chosen[rows], axis=0)
        all_of_it = np.exp(-((steps - common) ** 2).sum(axis=2) / (2 * width[:, 0]))
        best = (support * (1 + votes.mean(axis=2) + 0.3 * all_of_it)).argmax(axis=1)
        chosen[rows] = steps[np.arange(n), best]
    return chosen[rows], support[np.arange(n), best]


def _support(
    points: Floats, diameters: Floats, rows: Rows, now: cKDTree, then: cKDTree, reach: float
) -> tuple[Floats, Floats, Rows]:
    """Candidates' displacements (R, C, 2), the share of neighbours that follow, the neighbours."""
    n = len(rows)
    here, scale = points[rows], diameters[rows]
    steps = np.zeros((n, CANDIDATES, 2))
    support = np.zeros((n, CANDIDATES))
    c = min(CANDIDATES, then.n)
    distance, targets = nearest(then, here, c)
    possible = distance <= reach * scale[:, None]
    following = np.asarray(then.data)
    steps[:, :c] = following[targets] - here[:, None]
    _, neighbours = nearest(now, here, min(NEIGHBOURS + 1, now.n))
    i, j = np.nonzero(possible)
    expected = points[neighbours[i, 1:]] + steps[i, j][:, None]  # (P, k, 2)
    missed, _ = then.query(expected, 1, distance_upper_bound=float(diameters.max()))
    width = MATCH * scale[i] + MATCH_OF_STEP * distance[i, j]
    fits = np.exp(-((missed / width[:, None]) ** 2) / 2).mean(axis=1)
    # of equals, the shorter: nobody hurries without a reason
    support[i, j] = fits * (1 - 0.02 * distance[i, j] / scale[i])
    return steps, support, neighbours
