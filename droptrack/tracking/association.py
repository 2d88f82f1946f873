"""Which detection continues which track: assignment and DeepSORT's matching cascade."""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from droptrack.data.arrays import Floats, Rows


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
        matched = assign_sparse(rows[level], columns[level], cost[level], max_cost + 1e-5)
        free[matched[1]] = False
        found.append(matched)
    tracks, detections = zip(*found, strict=True)
    return np.concatenate(tracks), np.concatenate(detections)


def assign_sparse(
    rows: Rows, columns: Rows, cost: Floats, cost_of_none: float
) -> tuple[Rows, Rows]:
    """Pairs with the least total cost out of P possible ones: row, column and cost of each.

    Every row left without a column costs `cost_of_none`; pairs must cost less. Only possible pairs
    take time and memory (Jonker & Volgenant 1987, sparse).
    """
    if not len(rows):
        return rows, columns
    # a row and a column that have no other choice than each other need no search
    plain = (np.bincount(rows)[rows] == 1) & (np.bincount(columns)[columns] == 1)
    if plain.all():
        return rows, columns
    row_ids, row_at = _numbered(rows[~plain])
    column_ids, column_at = _numbered(columns[~plain])
    n, m = len(row_ids), len(column_ids)
    # each row may also take a column of its own, which stands for none; costs must be positive
    every = np.arange(n)
    shift = 1 - min(float(cost[~plain].min()), cost_of_none)
    values = np.append(cost[~plain], np.full(n, cost_of_none)) + shift
    graph = csr_matrix(
        (values, (np.append(row_at, every), np.append(column_at, m + every))), shape=(n, m + n)
    )
    chosen_rows, chosen_columns = min_weight_full_bipartite_matching(graph)
    real = chosen_columns < m
    return (
        np.append(rows[plain], row_ids[chosen_rows[real]]),
        np.append(columns[plain], column_ids[chosen_columns[real]]),
    )


def _numbered(values: Rows) -> tuple[Rows, Rows]:
    """Those values that there are, rising, and the place of each value among them.

    As `np.unique` with its inverse; of row numbers, counting is faster than sorting.
    """
    there = np.bincount(values) > 0
    return np.flatnonzero(there), (np.cumsum(there) - 1)[values]


def take_in_turn(rows: Rows, columns: Rows, cost: Floats, cost_of_none: float) -> tuple[Rows, Rows]:
    """Like `assign_sparse`, but greedy: the cheapest pair first, then the next that is free."""
    taken_rows: set[int] = set()
    taken_columns: set[int] = set()
    chosen = []
    for i in np.argsort(cost, kind="stable").tolist():
        row, column = int(rows[i]), int(columns[i])
        if cost[i] < cost_of_none and row not in taken_rows and column not in taken_columns:
            taken_rows.add(row)
            taken_columns.add(column)
            chosen.append(i)
    return rows[chosen], columns[chosen]
