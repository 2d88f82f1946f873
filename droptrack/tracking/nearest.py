"""Which points are nearest to which others."""

from typing import TYPE_CHECKING

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_PAIRS = 6000  # for which all distances take less time than a tree of the points
ROUNDING = 1e-9  # relative, by which a search reaches further than it must


def tree_of(points: Floats) -> "cKDTree":
    """A tree of points (N, 2)."""
    from scipy.spatial import cKDTree  # of runs that need it

    return cKDTree(points)


def nearest(tree: "cKDTree", points: Floats, k: int, reach: float = np.inf) -> tuple[Floats, Rows]:
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
    if len(points) * len(others) <= MAX_PAIRS:
        x, y = points[:, :1] - others[:, 0], points[:, 1:] - others[:, 1]
        x *= x
        y *= y
        x += y
        rows, columns, squares = _where(x <= (reach * np.abs(reach))[:, None], x)
        if np.bincount(rows).max(initial=0) <= k:
            return rows, columns, np.sqrt(squares)
    k = min(k, len(others))
    distance, found = nearest(tree_of(others), points, k, float(reach.max()) * (1 + ROUNDING))
    rows, place, distances = _where(distance <= reach[:, None], distance)
    return rows, found[rows, place], distances


def _where(condition: Bools, table: Floats) -> tuple[Rows, Rows, Floats]:
    """Rows and columns where a condition on a table is true, and the values there.

    As `np.nonzero`, which takes twice as long for two dimensions.
    """
    flat = condition.ravel().nonzero()[0]
    rows, columns = np.divmod(flat, table.shape[1])
    return rows, columns, table.take(flat)
