"""Which detection continues which track: assignment and DeepSORT's matching cascade."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

FORBIDDEN = 1e5  # the cost of pairs that must not be matched


def assign(cost: Floats, max_cost: float) -> tuple[Rows, Rows]:
    """Pairs of rows and columns of a cost matrix (N, M) with the least total cost.

    Pairs above `max_cost` count alike while the assignment is sought and are dropped after.
    """
    if not cost.size:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    capped = np.minimum(cost, max_cost + 1e-5)
    rows, columns = linear_sum_assignment(capped)
    good = capped[rows, columns] <= max_cost
    return rows[good].astype(np.int64), columns[good].astype(np.int64)


def matching_cascade(
    cost: Callable[[Rows, Rows], Floats],
    max_cost: float,
    ages: Rows,
    n_detections: int,
    max_age: int,
) -> tuple[Rows, Rows]:
    """Assign detections to tracks by the tracks' age, those seen last first (DeepSORT, listing 1).

    `ages` (N,): frames since each track was seen, 1 for the frame before this one.
    `cost(tracks, detections)` gives the costs of some tracks and detections. Returns the tracks and
    detections that were matched.
    """
    tracks: list[Rows] = []
    detections: list[Rows] = []
    free = np.arange(n_detections)
    for age in range(1, max_age + 1):
        level = np.flatnonzero(ages == age)
        if not len(level):
            continue
        if not len(free):
            break
        rows, columns = assign(cost(level, free), max_cost)
        tracks.append(level[rows])
        detections.append(free[columns])
        free = np.delete(free, columns)
    none = np.zeros(0, np.int64)
    return np.concatenate([none, *tracks]), np.concatenate([none, *detections])
