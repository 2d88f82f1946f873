"""Rows selected and replaced, against NumPy's indices in brackets."""

import numpy as np
import pytest

from droptrack.tracking.row_selection import RowSelection, select


@pytest.mark.parametrize("k", [0, 3, 7])
@pytest.mark.parametrize("shape", [(7,), (7, 2)])
def test_rows_are_those_of_an_index(shape: tuple[int, ...], k: int) -> None:
    rng = np.random.default_rng(k)
    array, rows = rng.normal(0, 1, shape), np.sort(rng.permutation(7)[:k])
    values = rng.normal(0, 1, (k, *shape[1:]))
    some = RowSelection(rows, 7)
    np.testing.assert_array_equal(some.of(array), array[rows])
    np.testing.assert_array_equal(select(array, rows), array[rows])
    np.testing.assert_array_equal(array[some.rows], array[rows])
    replaced = some.replaced(array, values)
    array[rows] = values
    np.testing.assert_array_equal(replaced, array)
