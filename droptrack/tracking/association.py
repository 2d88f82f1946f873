"""Sparse assignment: which of the possible pairs of a row and a column are chosen."""

import numpy as np

from droptrack.data.arrays import Floats, Rows


def assign_in_order(
    rows: Rows, columns: Rows, cost: Floats, cost_of_none: float, *, jointly: bool = True
) -> Rows | slice:
    """Which of P possible pairs are chosen, in their order.

    By `assign_sparse`, or if not `jointly`, by `assign_greedy`.
    """
    assign = assign_sparse if jointly else assign_greedy
    chosen, taken = assign(rows, columns, cost, cost_of_none)
    if len(chosen) == len(rows):  # there was no choice
        return slice(None)
    width = int(columns.max()) + 1
    pairs, wanted = rows * width + columns, np.sort(chosen * width + taken)
    order = np.argsort(pairs)
    return order[np.searchsorted(pairs, wanted, sorter=order)]


def assign_sparse(
    rows: Rows, columns: Rows, cost: Floats, cost_of_none: float
) -> tuple[Rows, Rows]:
    """Pairs with the smallest total cost out of P possible ones: rows and columns.

    Every row left without a column costs `cost_of_none`; pairs must cost less. Only possible pairs
    take time and memory (Jonker & Volgenant 1987, sparse).
    """
    if not len(rows):
        return rows, columns
    # a row and a column that have no other choice than each other need no search
    plain = (np.bincount(rows)[rows] == 1) & (np.bincount(columns)[columns] == 1)
    if plain.all():
        return rows, columns
    from scipy.sparse import csr_matrix  # of runs that need it
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    row_ids, row_at = _distinct(rows[~plain])
    column_ids, column_at = _distinct(columns[~plain])
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


def _distinct(values: Rows) -> tuple[Rows, Rows]:
    """The distinct values, rising, and the place of each value among them.

    As `np.unique` with its inverse; of row numbers, counting is faster than sorting.
    """
    there = np.bincount(values) > 0
    return np.flatnonzero(there), (np.cumsum(there) - 1)[values]


def assign_greedy(
    rows: Rows, columns: Rows, cost: Floats, cost_of_none: float
) -> tuple[Rows, Rows]:
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
