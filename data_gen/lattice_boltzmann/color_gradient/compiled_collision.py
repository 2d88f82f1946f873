"""Forces, fluxes and collision of the colour-gradient model, compiled for the CPU.

The terms are those of reference.py, fused by rows. As in free_energy each row is one thread's work,
in pieces of PIECE nodes held in the slots of one small flat buffer, which LLVM vectorises. Of a
droplet's window only the part is worked on where its fraction is not 0: `spans` holds the first and
last + 1 such column of each row. Fields have a rim of one node of zeros, as have solid nodes.

Kernels get their arrays one by one, as Numba needs them, however many they are. Numba keeps what it
compiled until this very file changes, whatever changes in a file that it calls or takes constants
from. So compiled functions call none of another file (compiled_transport.py has its own `_copy` and
the like), and parameters come as arguments.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

PIECE = 128  # nodes worked on at once
S = PIECE + 8  # stride of a slot of the buffer
SLOTS = 19
FAST: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "cache": True}


class Constants(NamedTuple):
    """What the kernels need of Params and of reference.py."""

    beta: float
    omega: float
    perturbation: float  # 2 A
    contact: float  # A_h
    distance: float  # h_0
    wall_force: float
    no_gradient: float
    contact_gradient: float


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
def _load(row: Any, start: int, n: int, b: Any, slot: int) -> None:
    _copy(row[start:], b[slot * S :], n)


@njit(**FAST)
def _span(spans: Any, r: int, w: int) -> tuple[int, int]:
    """Columns of row r that what is there in rows r - 1 to r + 1 can reach in a step."""
    first = min(spans[r, 0], spans[r + 1, 0], spans[r + 2, 0])
    last = max(spans[r, 1], spans[r + 1, 1], spans[r + 2, 1])
    return max(first - 1, 0), min(last + 1, w)


@njit(**FAST)
def _add_push(e: Any, push: Any, force: Any, strength: float, n: int) -> None:
    """Add a component of the walls' force on the emulsion."""
    for x in range(n):
        force[x] += strength * e[x] * push[x]


@njit(**FAST)
def _interface(b: Any, n: int, beta: float, no_gradient: float) -> None:
    """Gradient (slots 3, 4), recolouring (5, 6) and tension xx, xy, yy (7-9) of a fraction.

    From its rows y - 1, y, y + 1 (slots 0-2, a node more on either side).
    """
    for x in range(n):
        gx = (4 * (b[S + x + 2] - b[S + x]) + (b[2 * S + x + 2] - b[2 * S + x])) / 12
        gx += (b[x + 2] - b[x]) / 12
        gy = (4 * (b[2 * S + x + 1] - b[x + 1]) + (b[2 * S + x + 2] - b[x + 2])) / 12
        gy += (b[2 * S + x] - b[x]) / 12
        inverse = 1 / max(np.sqrt(gx * gx + gy * gy), no_gradient)
        c = b[S + x + 1]
        strength = beta * c * (1 - c) * inverse
        b[3 * S + x] = gx
        b[4 * S + x] = gy
        b[5 * S + x] = strength * gx
        b[6 * S + x] = strength * gy
        b[7 * S + x] = gx * gx * inverse
        b[8 * S + x] = gx * gy * inverse
        b[9 * S + x] = gy * gy * inverse


@njit(**FAST)
def _sample(field: Any, y: float, x: float) -> float:
    """Bilinear value between nodes, 0 outside."""
    height, width = field.shape
    y_0, x_0 = int(np.floor(y)), int(np.floor(x))
    t, s = y - y_0, x - x_0
    total = 0.0
    for dy in range(2):
        for dx in range(2):
            if 0 <= y_0 + dy < height and 0 <= x_0 + dx < width:
                weight = (t if dy else 1 - t) * (s if dx else 1 - s)
                total += weight * field[y_0 + dy, x_0 + dx]
    return total


@njit(**FAST)
def _near_contact(
    b: Any, n: int, r: int, j: int, y_0: int, x_0: int, label: Any, e: Any, total: Any,
    fx: Any, fy: Any, c: Constants,
) -> None:  # fmt: skip
    """Add F_rep to the force on row r of a window; label and e have a rim."""
    contact = c.contact_gradient**2
    for x in range(n):
        gx, gy = b[3 * S + x], b[4 * S + x]
        square = gx * gx + gy * gy
        if square > contact:
            reach = c.distance / np.sqrt(square)
            y_out, x_out = r - reach * gy, j + x - reach * gx
            others = _sample(total, y_out + y_0, x_out + x_0) + 1
            others -= _sample(label, y_out + 1, x_out + 1)
            others -= _sample(e, y_out + y_0 + 1, x_out + x_0 + 1)
            fx[x_0 + j + x] += c.contact * others * gx
            fy[x_0 + j + x] += c.contact * others * gy


@njit(**FAST)
def _film(b: Any, n: int, beta: float, no_gradient: float) -> None:
    """Flux Q of the constraint in slots 14, 15, and that of E, less rho, in 16, 17.

    From E (slots 0-2), its own terms (3-9), sum c (10), sum grad c (11, 12), sum a (13, 18).
    """
    for x in range(n):
        e = b[S + x + 1]
        gx, gy = b[3 * S + x] - b[11 * S + x], b[4 * S + x] - b[12 * S + x]
        film = e - b[10 * S + x]
        strength = beta * film * (1 - film) / max(np.sqrt(gx * gx + gy * gy), no_gradient)
        qx = b[13 * S + x] + strength * gx - b[5 * S + x]
        qy = b[18 * S + x] + strength * gy - b[6 * S + x]
        b[14 * S + x], b[15 * S + x] = qx, qy
        b[16 * S + x] = b[5 * S + x] + (1 - e) * qx
        b[17 * S + x] = b[6 * S + x] + (1 - e) * qy


@njit(**FAST)
def _collide(b: Any, n: int, c: Constants) -> None:
    """Regularised collision: f_i in slots 0-8, F in 9, 10, G in 11-13, fluid in 14; rho to 15."""
    for x in range(n):
        f0, f1, f2, f3, f4 = b[x], b[S + x], b[2 * S + x], b[3 * S + x], b[4 * S + x]
        f5, f6, f7, f8 = b[5 * S + x], b[6 * S + x], b[7 * S + x], b[8 * S + x]
        fx, fy, fluid = b[9 * S + x], b[10 * S + x], b[14 * S + x]
        diagonal, anti = f5 + f7, f6 + f8
        pxx, pyy, pxy = f1 + f3 + diagonal + anti, f2 + f4 + diagonal + anti, diagonal - anti
        rho = f0 + f1 + f3 + pyy
        mx, my = f1 - f3 + (f5 - f7) - (f6 - f8), f2 - f4 + (f5 - f7) + (f6 - f8)
        inverse = 1 / (rho + (1 - fluid))
        ux, uy = (mx + 0.5 * fx) * inverse, (my + 0.5 * fy) * inverse
        keep, work = 1 - c.omega, 1 - 0.5 * c.omega
        ixx, iyy, ixy = rho * ux * ux, rho * uy * uy, rho * ux * uy
        sxx = 4.5 * (ixx + keep * (pxx - rho / 3 - ixx) + 2 * work * ux * fx)
        syy = 4.5 * (iyy + keep * (pyy - rho / 3 - iyy) + 2 * work * uy * fy)
        sxy = 4.5 * (ixy + keep * (pxy - ixy) + work * (ux * fy + uy * fx))
        gxx, gxy = c.perturbation * b[11 * S + x], c.perturbation * b[12 * S + x]
        gyy = c.perturbation * b[13 * S + x]
        trace = gxx + gyy
        level = rho - (sxx + syy) / 3
        jx, jy = 3 * (rho * ux + 0.5 * fx), 3 * (rho * uy + 0.5 * fy)
        b[15 * S + x] = rho
        b[x] = fluid * (4 / 9 * level + 4 / 27 * trace)
        straight_x = (level + sxx + gxx) / 9 - 2 / 27 * trace
        straight_y = (level + syy + gyy) / 9 - 2 / 27 * trace
        both = (level + sxx + syy + trace) / 36 - 5 / 108 * trace
        cross, along, across = (sxy + gxy) / 18, (jx + jy) / 36, (jy - jx) / 36
        b[S + x], b[3 * S + x] = fluid * (straight_x + jx / 9), fluid * (straight_x - jx / 9)
        b[2 * S + x], b[4 * S + x] = fluid * (straight_y + jy / 9), fluid * (straight_y - jy / 9)
        b[5 * S + x], b[7 * S + x] = fluid * (both + cross + along), fluid * (both + cross - along)
        b[6 * S + x] = fluid * (both - cross + across)
        b[8 * S + x] = fluid * (both - cross - across)


@njit(**FAST)
def _label_flux(q: Any, label: Any, film: Any, rho: Any, n: int) -> None:
    """Turn a_k into rho q_k = rho (a_k - c_k Q)."""
    for x in range(n):
        q[x] = rho[x] * (q[x] - label[x] * film[x])


@njit(**FAST)
def _droplet_row(
    label: Any, qx: Any, qy: Any, spans: Any, r: int, y_0: int, x_0: int, e: Any, total: Any,
    sums: Any, b: Any, c: Constants,
) -> None:  # fmt: skip
    """Add the terms of a droplet's row r to the sums; leave its recolouring in qx, qy."""
    qx[r + 1, :] = 0.0
    qy[r + 1, :] = 0.0
    low, high = _span(spans, r, label.shape[1] - 2)
    for j in range(low, high, PIECE):
        n = min(PIECE, high - j)
        for i in range(3):
            _load(label[r + i], j, n + 2, b, i)
        _interface(b, n, c.beta, c.no_gradient)
        for i in range(7):
            _add(b[(3 + i) * S :], sums[i, x_0 + j :], n)
        _copy(b[5 * S :], qx[r + 1, j + 1 :], n)
        _copy(b[6 * S :], qy[r + 1, j + 1 :], n)
        _near_contact(b, n, r, j, y_0, x_0, label, e, total, sums[7], sums[8], c)


@njit(**FAST)
def _emulsion_row(
    y: int, low: int, high: int, e: Any, q_e: Any, total: Any, push: Any, sums: Any, film: Any,
    b: Any, c: Constants,
) -> None:  # fmt: skip
    """Add the emulsion's terms to the sums; leave Q in `film` and the flux of E in q_e."""
    q_e[0, y + 1, :] = 0.0
    q_e[1, y + 1, :] = 0.0
    for j in range(low, high, PIECE):
        n = min(PIECE, high - j)
        for i in range(3):
            _load(e[y + i], j, n + 2, b, i)
        _interface(b, n, c.beta, c.no_gradient)
        _load(total[y], j, n, b, 10)
        _load(sums[0], j, n, b, 11)
        _load(sums[1], j, n, b, 12)
        _load(sums[2], j, n, b, 13)
        _load(sums[3], j, n, b, 18)
        _film(b, n, c.beta, c.no_gradient)
        for i in range(3):
            _add(b[(7 + i) * S :], sums[4 + i, j:], n)
        for i in range(2):
            _add_push(b[S + 1 :], push[i, y, j:], sums[7 + i, j:], c.wall_force, n)
            _copy(b[(14 + i) * S :], film[i, j:], n)
            _copy(b[(16 + i) * S :], q_e[i, y + 1, j + 1 :], n)


@njit(**FAST)
def _fluid_row(
    y: int, f: Any, post: Any, fluid: Any, sums: Any, film: Any, b: Any, c: Constants
) -> None:
    """Collision of a row; leave its density in `film`."""
    width = f.shape[2]
    for j in range(0, width, PIECE):
        n = min(PIECE, width - j)
        for i in range(9):
            _load(f[i, y], j, n, b, i)
        _load(sums[7], j, n, b, 9)
        _load(sums[8], j, n, b, 10)
        for i in range(3):
            _load(sums[4 + i], j, n, b, 11 + i)
        _load(fluid[y], j, n, b, 14)
        _collide(b, n, c)
        for i in range(9):
            _copy(b[i * S :], post[i, y + 1, j + 1 :], n)
        _copy(b[15 * S :], film[2, j:], n)


@njit(**FAST)
def _collide_rows(
    first: int, last: int, f: Any, post: Any, e: Any, q_e: Any, total: Any, labels: Any, q: Any,
    spans: Any, e_spans: Any, origins: Any, fluid: Any, push: Any, c: Constants,
) -> None:  # fmt: skip
    """Forces, fluxes and collision of the rows first to last - 1."""
    h, w = labels.shape[1] - 2, labels.shape[2] - 2
    width = f.shape[2]
    b = np.empty(SLOTS * S)
    # sums over droplets: grad c (0, 1), recolouring (2, 3), tension (4-6); force (7, 8)
    sums = np.empty((9, width))
    film = np.empty((3, width))  # Q and rho
    for y in range(first, last):
        sums[:] = 0.0
        for k in range(len(origins)):
            y_0, x_0 = origins[k]
            if 0 <= y - y_0 < h:
                _droplet_row(
                    labels[k], q[0, k], q[1, k], spans[k], y - y_0, y_0, x_0, e, total, sums, b, c
                )
        film[:] = 0.0
        low, high = _span(e_spans, y, width)
        _emulsion_row(y, low, high, e, q_e, total, push, sums, film, b, c)
        _fluid_row(y, f, post, fluid, sums, film, b, c)
        for i in range(2):
            _scale(q_e[i, y + 1, 1 + low :], film[2, low:], high - low)
        for k in range(len(origins)):
            y_0, x_0 = origins[k]
            r = y - y_0
            if 0 <= r < h:
                low, high = _span(spans[k], r, w)
                for i in range(2):
                    _label_flux(
                        q[i, k, r + 1, 1 + low :], labels[k, r + 1, 1 + low :],
                        film[i, x_0 + low :], film[2, x_0 + low :], high - low,
                    )  # fmt: skip


@njit(parallel=True, **FAST)
def collide(
    f: Any, post: Any, e: Any, q_e: Any, total: Any, labels: Any, q: Any, spans: Any, e_spans: Any,
    origins: Any, fluid: Any, push: Any, c: Constants, blocks: int,
) -> None:  # fmt: skip
    """Forces, fluxes and collision: fills post, q_e (2, H + 2, W + 2) and q of all droplets."""
    height = f.shape[1]
    size = (height + blocks - 1) // blocks
    for block in prange(blocks):
        _collide_rows(
            block * size, min(height, (block + 1) * size), f, post, e, q_e, total, labels, q,
            spans, e_spans, origins, fluid, push, c,
        )  # fmt: skip
