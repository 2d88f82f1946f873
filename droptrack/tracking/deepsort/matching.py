"""DeepSORT's cost, the cosine distance to galleries, and its matching cascade."""

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.association import assign_sparse

COST_STEP = 1e-5  # by which no match costs more than the worst match, as in the original


def cosine_distances(
    galleries: list[list[Floats]], descriptors: Floats, rows: Rows, columns: Rows
) -> Floats:
    """Smallest cosine distance (P,) of descriptors (M, D) to galleries, N lists of vectors (D,).

    Of pairs: descriptor `columns` to gallery `rows`, which rise.
    """
    distances = np.zeros(len(rows))
    starts = np.searchsorted(rows, np.arange(len(galleries) + 1))
    for gallery, start, end in zip(galleries, starts, starts[1:], strict=False):
        if start < end:
            similarity = np.array(gallery) @ descriptors[columns[start:end]].T
            distances[start:end] = 1 - similarity.max(axis=0)
    return distances


def matching_cascade(
    rows: Rows, columns: Rows, cost: Floats, max_cost: float, ages: Rows, max_age: int
) -> tuple[Rows, Rows]:
    """Assign detections to tracks by the tracks' age, those seen last first (DeepSORT, listing 1).

    Of P possible pairs of a track and a detection, with their costs; those above `max_cost` are not
    matched. `ages` (N,): frames since each track was seen, 1 for the frame before this one. Returns
    the tracks and detections that were matched.
    """
    none = np.zeros(0, np.int64)
    found = [(none, none)]
    free = np.ones(columns.max(initial=-1) + 1, bool)
    for age in np.unique(ages[ages <= max_age]):
        level = (ages[rows] == age) & free[columns] & (cost <= max_cost)
        matched = assign_sparse(rows[level], columns[level], cost[level], max_cost + COST_STEP)
        free[matched[1]] = False
        found.append(matched)
    tracks, detections = zip(*found, strict=True)
    return np.concatenate(tracks), np.concatenate(detections)
