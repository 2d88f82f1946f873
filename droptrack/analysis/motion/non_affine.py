"""What no affine deformation of its surroundings explains of a droplet's neighbourhood.

M. L. Falk and J. S. Langer, Phys. Rev. E 57, 7192 (1998), eqs. 2.11 to 2.15: D²min is the least sum
of squares of r_ij(t + lag) - F r_ij(t) over the neighbours j, for any matrix F; here their mean.
"""

import numpy as np

from droptrack.analysis.neighbourhoods import blocks_with_pairs, shuffled, some_frames
from droptrack.analysis.paths import Paths
from droptrack.data.arrays import Floats, Rows

MIN_NEIGHBOURS = 3  # two are always affine
MAX_FRAMES = 400  # from which displacements begin, evenly over all


def non_affine(before: Floats, after: Floats, first: Rows, second: Rows) -> Floats:
    """D²min (K,) px² a neighbour, of places (K, 2) before and after, whose neighbours are pairs.

    NaN for fewer than three neighbours whose places are known, and where these lie on a line.

    >>> square = np.array([[0.0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    >>> first, second = np.zeros(4, int), np.arange(1, 5)
    >>> sheared = square @ np.array([[1.0, 0], [0.3, 1]]) + 7
    >>> bool(abs(non_affine(square, sheared, first, second)[0]) < 1e-12)
    True
    """
    n = len(before)
    r, moved = before[second] - before[first], after[second] - after[first]
    known = np.isfinite(moved).all(axis=1)
    r, moved, first, second = r[known], moved[known], first[known], second[known]

    def total(values: Floats) -> Floats:  # a pair says the same of both
        both = np.bincount(first, values, n) + np.bincount(second, values, n)
        return both.astype(float)

    count = np.bincount(first, minlength=n) + np.bincount(second, minlength=n)
    x = np.stack([[total(moved[:, a] * r[:, b]) for b in range(2)] for a in range(2)])
    y00, y01, y11 = (total(r[:, a] * r[:, b]) for a, b in ((0, 0), (0, 1), (1, 1)))
    determinant = y00 * y11 - y01**2
    enough = (count >= MIN_NEIGHBOURS) & (determinant > 1e-9 * (y00 + y11) ** 2)
    whole = total((moved**2).sum(axis=1))
    explained = np.zeros(n)
    for a in range(2):
        row = x[a, 0] ** 2 * y11 - 2 * x[a, 0] * x[a, 1] * y01 + x[a, 1] ** 2 * y00
        explained += np.divide(row, determinant, out=np.zeros(n), where=enough)
    rest = np.maximum(whole - explained, 0.0)
    return np.asarray(np.divide(rest, count, out=np.full(n, np.nan), where=enough))


def non_affine_sums(
    paths: Paths, radius: float, lags: Rows, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats, Floats]:
    """Sums and counts (N, L) of D²min for lags (L,), neighbours within `radius` px.

    And the same with the displacements of each frame shuffled among its droplets.
    """
    rows = np.flatnonzero(np.isfinite(paths.places[:, 0]))
    rows = rows[np.argsort(paths.frames[rows], kind="stable")]
    rows = rows[some_frames(paths.frames[rows], MAX_FRAMES)]
    frames, places, owners = paths.frames[rows], paths.places[rows], paths.owners[rows]
    later = [paths.displacements(lag)[rows] for lag in lags.tolist()]
    n, shape = paths.n_droplets, (paths.n_droplets, len(lags))
    real, null = (np.zeros(shape), np.zeros(shape)), (np.zeros(shape), np.zeros(shape))
    for block, first, second in blocks_with_pairs(frames, places, radius, "non-affine motion"):
        before = places[block]
        order = shuffled(frames[block], rng)
        for k, all_steps in enumerate(later):
            steps = all_steps[block]
            for (sums, counts), moved in ((real, steps), (null, steps[order])):
                d2 = non_affine(before, before + moved, first, second)
                known = np.isfinite(d2)
                sums[:, k] += np.bincount(owners[block][known], d2[known], n)
                counts[:, k] += np.bincount(owners[block][known], minlength=n)
    return (*real, *null)


def non_affine_in(paths: Paths, frame: int, radius: float, lag: int) -> tuple[Rows, Floats]:
    """Rows (K,) of the table, and D²min (K,) px², of the droplets of one frame."""
    at = np.flatnonzero((paths.frames == frame) & np.isfinite(paths.places[:, 0]))
    before, steps = paths.places[at], paths.displacements(lag)[at]
    for _, first, second in blocks_with_pairs(paths.frames[at], before, radius, "one frame"):
        return paths.rows[at], non_affine(before, before + steps, first, second)
    return paths.rows[at], np.full(len(at), np.nan)
