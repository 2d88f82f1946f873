"""Which places are near which others."""

import numpy as np

from droptrack.data.arrays import Floats, Rows


def pairs_within(points: Floats, reach: Floats, others: Floats) -> tuple[Rows, Rows]:
    """Pairs of points (N, 2) and others (M, 2) no further apart, in x and y, than `reach` (N,).

    Sorted by point.
    """
    if not len(points) or not len(others):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    from scipy.spatial import cKDTree  # of runs that need it

    near = cKDTree(others).query_ball_point(points, reach, p=np.inf)
    counts = [len(one) for one in near]
    return np.repeat(np.arange(len(points)), counts), np.concatenate(near).astype(np.int64)
