"""Streaming and transport of the colour-gradient model, compiled for the CPU.

As in compiled_collision.py, whose docstring says how rows are worked off and why no function of
another file is called. Nothing arrives from the rim and from solid nodes, where all is 0: a list of
links adds what half-way bounce-back returns.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from data_gen.lattice_boltzmann.lattice import CX, CY, W

PIECE = 128  # nodes worked on at once
S = PIECE + 8  # stride of a slot of the buffer
SLOTS = 19
DIAGONAL = 1 / (36 * np.sqrt(2))  # w_i / |c_i|
C_X, C_Y = CX.astype(np.int64), CY.astype(np.int64)
SHARE = W / np.maximum(np.hypot(CX, CY), 1)  # w_i / |c_i|, c_0 aside
FAST: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "cache": True}


class Links(NamedTuple):
    """Links to solid nodes: those of row y are start[y] to start[y + 1] - 1.

    x: column of the fluid node; leaving, arriving: the directions to the wall and back.
    """

    start: NDArray[np.int64]
    x: NDArray[np.int64]
    leaving: NDArray[np.int64]
    arriving: NDArray[np.int64]


@njit(**FAST)
def _copy(source: Any, target: Any, n: int) -> None:
    for x in range(n):
        target[x] = source[x]


@njit(**FAST)
def _add(source: Any, target: Any, n: int) -> None:
    for x in range(n):
        target[x] += source[x]


@njit(**FAST)
def _scale(row: Any, factor: Any, n: int) -> None:
    for x in range(n):
        row[x] *= factor[x]


@njit(**FAST)
def _copy_times(source: Any, factor: Any, target: Any, n: int) -> None:
    for x in range(n):
        target[x] = source[x] * factor[x]


@njit(**FAST)
def _load(row: Any, start: int, n: int, b: Any, slot: int) -> None:
    _copy(row[start:], b[slot * S :], n)


@njit(**FAST)
def _span(spans: Any, r: int, w: int) -> tuple[int, int]:
    """Columns of row r that what is there in rows r - 1 to r + 1 can reach in a step."""
    first = min(spans[r, 0], spans[r + 1, 0], spans[r + 2, 0])
    last = max(spans[r, 1], spans[r + 1, 1], spans[r + 2, 1])
    return max(first - 1, 0), min(last + 1, w)


@njit(**FAST)
def _gather(b: Any, n: int) -> None:
    """Mass of a component that arrives, in slot 18.

    From its fraction (slots 0-2) and rho q (3-5, 6-8) in rows y - 1, y, y + 1, a node more on
    either side, and f_i where they come from (9-17).
    """
    for x in range(n):
        total = b[S + x + 1] * b[9 * S + x]
        total += b[S + x] * b[10 * S + x] + b[S + x + 2] * b[12 * S + x]
        total += b[x + 1] * b[11 * S + x] + b[2 * S + x + 1] * b[13 * S + x]
        total += b[x] * b[14 * S + x] + b[x + 2] * b[15 * S + x]
        total += b[2 * S + x + 2] * b[16 * S + x] + b[2 * S + x] * b[17 * S + x]
        total += (b[4 * S + x] - b[4 * S + x + 2] + b[6 * S + x + 1] - b[8 * S + x + 1]) / 9
        sw, se = b[3 * S + x] + b[6 * S + x], b[6 * S + x + 2] - b[3 * S + x + 2]
        ne, nw = b[5 * S + x + 2] + b[8 * S + x + 2], b[5 * S + x] - b[8 * S + x]
        b[18 * S + x] = total + DIAGONAL * ((sw + se) + (nw - ne))


@njit(**FAST)
def _transport_row(
    c: Any, new: Any, qx: Any, qy: Any, r: int, y: int, x_0: int, post: Any, inverse: Any,
    links: Links, low: int, high: int, b: Any,
) -> None:  # fmt: skip
    """One component's row a step later, columns low to high - 1.

    c, new, qx, qy and post have a rim; inverse is 1 / rho.
    """
    for j in range(low, high, PIECE):
        n = min(PIECE, high - j)
        for i in range(3):
            _load(c[r + i], j, n + 2, b, i)
            _load(qx[r + i], j, n + 2, b, 3 + i)
            _load(qy[r + i], j, n + 2, b, 6 + i)
        for i in range(9):
            _load(post[i, y + 1 - C_Y[i]], x_0 + j + 1 - C_X[i], n, b, 9 + i)
        _gather(b, n)
        _copy(b[18 * S :], new[r + 1, j + 1 :], n)
    row = new[r + 1, 1:]
    for k in range(links.start[y], links.start[y + 1]):
        x = links.x[k] - x_0
        if low <= x < high:
            i = links.leaving[k]
            flux = C_X[i] * qx[r + 1, x + 1] + C_Y[i] * qy[r + 1, x + 1]
            row[x] += c[r + 1, x + 1] * post[i, y + 1, x_0 + x + 1] + SHARE[i] * flux
    _scale(row[low:], inverse[x_0 + low :], high - low)


@njit(**FAST)
def _trim(row: Any, low: int, high: int, span: Any, nothing: float) -> None:
    """Set to 0 what is as good as nothing, and note what is left."""
    for x in range(low, high):
        row[x] = 0.0 if abs(row[x]) < nothing else row[x]
    while low < high and row[low] == 0:
        low += 1
    while low < high and row[high - 1] == 0:
        high -= 1
    span[0] = low if low < high else len(row) - 1
    span[1] = high if low < high else 0


@njit(**FAST)
def _open_ends(f: Any, y: int, inlet: float, rho_0: float) -> None:
    """Inlet of velocity, outlet of density, on a fluid row."""
    width = f.shape[2]
    f[1, y, 0] += inlet / 9
    f[5, y, 0] += inlet / 36
    f[8, y, 0] += inlet / 36
    rho, mx, my = 0.0, 0.0, 0.0
    for i in range(9):
        rho += f[i, y, width - 2]
        mx += C_X[i] * f[i, y, width - 2]
        my += C_Y[i] * f[i, y, width - 2]
    ux, uy = mx / rho, my / rho
    for i in range(9):
        cu = C_X[i] * ux + C_Y[i] * uy
        per_density = W[i] * (1 + 3 * cu + 4.5 * cu * cu - 1.5 * (ux * ux + uy * uy))
        f[i, y, width - 1] = f[i, y, width - 2] + (rho_0 - rho) * per_density


@njit(**FAST)
def _density(f: Any, y: int, fluid: Any, inverse: Any) -> None:
    """1 / rho of a row, 0 in solid nodes."""
    for i in range(1, 9):
        _add(f[i, y], inverse, f.shape[2]) if i > 1 else _copy(f[1, y], inverse, f.shape[2])
    _add(f[0, y], inverse, f.shape[2])
    for x in range(f.shape[2]):
        inverse[x] = fluid[x] / (inverse[x] + (1 - fluid[x]))


@njit(**FAST)
def _transport_rows(
    first: int, last: int, f: Any, post: Any, e: Any, e_new: Any, q_e: Any, total: Any,
    labels: Any, labels_new: Any, q: Any, spans: Any, spans_new: Any, e_spans: Any,
    e_spans_new: Any, origins: Any, fluid: Any, links: Links, inlet: float, rho_0: float,
    nothing: float,
) -> None:  # fmt: skip
    """Streaming of the fluid and of all fractions into the rows first to last - 1."""
    h, w = labels.shape[1] - 2, labels.shape[2] - 2
    width = f.shape[2]
    b = np.empty(SLOTS * S)
    inverse = np.empty(width)
    for y in range(first, last):
        for i in range(9):
            _copy_times(post[i, y + 1 - C_Y[i], 1 - C_X[i] :], fluid[y], f[i, y], width)
        for k in range(links.start[y], links.start[y + 1]):
            x = links.x[k]
            f[links.arriving[k], y, x] += post[links.leaving[k], y + 1, x + 1]
        if fluid[y, 0] > 0:
            _open_ends(f, y, inlet, rho_0)
        _density(f, y, fluid[y], inverse)
        low, high = _span(e_spans, y, width)
        e_new[y + 1, :] = 0.0
        _transport_row(e, e_new, q_e[0], q_e[1], y, y, 0, post, inverse, links, low, high, b)
        _trim(e_new[y + 1, 1:], low, high, e_spans_new[y + 1], nothing)
        total[y] = 0.0
        for k in range(len(origins)):
            y_0, x_0 = origins[k]
            r = y - y_0
            if 0 <= r < h:
                low, high = _span(spans[k], r, w)
                row = labels_new[k, r + 1]
                row[:] = 0.0
                _transport_row(
                    labels[k], labels_new[k], q[0, k], q[1, k], r, y, x_0, post, inverse, links,
                    low, high, b,
                )  # fmt: skip
                _trim(row[1:], low, high, spans_new[k, r + 1], nothing)
                _add(row[1 + low :], total[y, x_0 + low :], high - low)
                if spans_new[k, r + 1, 0] < spans_new[k, r + 1, 1]:
                    span = e_spans_new[y + 1]
                    span[0] = min(span[0], x_0 + spans_new[k, r + 1, 0])
                    span[1] = max(span[1], x_0 + spans_new[k, r + 1, 1])


@njit(parallel=True, **FAST)
def transport(
    f: Any, post: Any, e: Any, e_new: Any, q_e: Any, total: Any, labels: Any, labels_new: Any,
    q: Any, spans: Any, spans_new: Any, e_spans: Any, e_spans_new: Any, origins: Any, fluid: Any,
    links: Links, inlet: float, rho_0: float, nothing: float, blocks: int,
) -> None:  # fmt: skip
    """Streaming of the fluid and of all fractions: fills f, e_new, labels_new and their spans.

    inlet: 6 rho_0 U; fractions below `nothing` become 0.
    """
    height = f.shape[1]
    size = (height + blocks - 1) // blocks
    for block in prange(blocks):
        _transport_rows(
            block * size, min(height, (block + 1) * size), f, post, e, e_new, q_e, total, labels,
            labels_new, q, spans, spans_new, e_spans, e_spans_new, origins, fluid, links, inlet,
            rho_0, nothing,
        )  # fmt: skip
