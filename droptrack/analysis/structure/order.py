"""Hexatic order: how nearly the neighbours stand as in a hexagonal lattice.

D. R. Nelson and B. I. Halperin, Phys. Rev. B 19, 2457 (1979); weighted by the lengths of the cells'
edges: W. Mickel et al., J. Chem. Phys. 138, 044501 (2013).
"""

import numpy as np
from numpy.typing import NDArray

from droptrack.analysis.structure.cells import Cells

Complexes = NDArray[np.complex128]


def hexatic_order(cells: Cells, *, weighted: bool = False) -> Complexes:
    """psi_6 (K,): the mean over the neighbours of exp(6 i theta), NaN without neighbours.

    theta is the direction to the neighbour; 1 in length in a hexagonal lattice.
    """
    k = len(cells.areas)
    weights = cells.lengths if weighted else np.ones(len(cells.first))
    turned = weights * np.exp(6j * np.arctan2(cells.vectors[:, 1], cells.vectors[:, 0]))

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:  # opposite: the same, 6 pi on
        both = np.bincount(cells.first, values, k) + np.bincount(cells.second, values, k)
        return both.astype(float)

    whole = total(weights)
    found = np.full(k, np.nan + 0j)
    np.divide(total(turned.real) + 1j * total(turned.imag), whole, out=found, where=whole > 0)
    return found


def n_neighbours(cells: Cells) -> NDArray[np.int64]:
    """How many neighbours each of K droplets has, (K,)."""
    k = len(cells.areas)
    return np.bincount(cells.first, minlength=k) + np.bincount(cells.second, minlength=k)
