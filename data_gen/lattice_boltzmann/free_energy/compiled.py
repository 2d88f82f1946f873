"""The free-energy model compiled for the CPU: the terms of reference.py, fused by rows.

Each row of the grid is one thread's work from its own inputs, so results do not depend on the
number of threads. Rows are worked off in pieces of PIECE nodes that are copied into slots of one
small flat buffer: LLVM then sees constant distances between all operands and vectorises.

Kernels get their arrays one by one, as Numba needs them, however many they are. Numba keeps what it
compiled until this very file changes, so no function of another file is called.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

PIECE = 128  # nodes worked on at once
S = PIECE + 8  # stride of a slot of the buffer: a piece and its two neighbours
SLOTS = 13
RIM = 2  # of psi; that of mu is 1
FAST: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "cache": True}


class Constants(NamedTuple):
    """What the kernels need of Params."""

    a: float
    k: float
    mobility: float
    epsilon: float
    epsilon_quadratic: float
    psi_0: float
    force_x: float
    omega_plus: float
    omega_minus: float
    outer: float  # weight of a face's outer two nodes: 1 in fourth order


@njit(**FAST)
def _copy(source: Any, target: Any, n: int) -> None:
    """Copy n values; callers pass views, as indices counted from 0 are what vectorises."""
    for x in range(n):
        target[x] = source[x]


@njit(**FAST)
def _add(source: Any, target: Any, n: int) -> None:
    """Add n values."""
    for x in range(n):
        target[x] += source[x]


@njit(**FAST)
def _load(row: Any, start: int, n: int, b: Any, slot: int) -> None:
    """Copy row[start : start + n] into a slot."""
    _copy(row[start:], b[slot * S :], n)


@njit(**FAST)
def _load_wrapped(row: Any, start: int, n: int, b: Any, slot: int) -> None:
    """Copy n values from a periodic row, start from -1."""
    width = len(row)
    start %= width
    done = 0
    while done < n:  # up to three times: a row that ends on a piece is wrapped on both sides
        part = min(n - done, width - start)
        _copy(row[start:], b[slot * S + done :], part)
        done += part
        start = 0


@njit(**FAST)
def _add_wrapped(b: Any, slot: int, n: int, row: Any, start: int) -> None:
    """Add n values of a slot to a periodic row."""
    width = len(row)
    start %= width
    first = min(n, width - start)
    _add(b[slot * S :], row[start:], first)
    if first < n:
        _add(b[slot * S + first :], row, n - first)


@njit(**FAST)
def _store(b: Any, slot: int, n: int, field: Any, rim: int, r: int, j: int, periodic: bool) -> None:
    """Store a piece in row r, columns from j, of a field with a rim; keep the rim in step."""
    h, w = field.shape[0] - 2 * rim, field.shape[1] - 2 * rim
    row = field[r + rim]
    _copy(b[slot * S :], row[rim + j :], n)
    if j + n == w:  # the row is complete
        for k in range(rim):
            row[rim - 1 - k] = row[rim + w - 1 - k] if periodic else row[rim + k]
            row[rim + w + k] = row[rim + k] if periodic else row[rim + w - 1 - k]
        if r < rim:
            field[rim - 1 - r, :] = row
        if r >= h - rim:
            field[rim + 2 * h - 1 - r, :] = row


@njit(**FAST)
def _potential_and_force(b: Any, n: int, c: Constants) -> None:
    """mu_i in slot 5, mu_i grad psi_i in slots 6 and 7.

    From psi in rows y - 1, y, y + 1 (slots 0, 1, 2, a node more on either side) and
    sum_j psi_j^2, sum_j psi_j (slots 3, 4).
    """
    for x in range(n):
        se, e, ne = b[x + 2], b[S + x + 2], b[2 * S + x + 2]
        south, psi, north = b[x + 1], b[S + x + 1], b[2 * S + x + 1]
        sw, west, nw = b[x], b[S + x], b[2 * S + x]
        lap = (4 * (e + west + north + south) + ne + nw + se + sw - 20 * psi) / 6
        grad_x = (4 * (e - west) + (ne - nw) + (se - sw)) / 12
        grad_y = (4 * (north - south) + (ne - se) + (nw - sw)) / 12
        mu = c.a / 2 * psi * (psi - c.psi_0) * (2 * psi - c.psi_0) - c.k * lap
        mu += 2 * c.epsilon_quadratic * psi * (b[3 * S + x] - psi * psi)
        mu += c.epsilon * (b[4 * S + x] - psi)
        b[5 * S + x] = mu
        b[6 * S + x] = mu * grad_x
        b[7 * S + x] = mu * grad_y


@njit(**FAST)
def _field_row(
    psi: Any, mu: Any, r: int, x_0: int, periodic: bool, grid: Any, b: Any, c: Constants
) -> None:
    """Potential of a field's row r, and its force added to `grid` (squares, total, fx, fy)."""
    w = psi.shape[1] - 2 * RIM
    for j in range(0, w, PIECE):
        n = min(PIECE, w - j)
        for k in range(3):
            _load(psi[r + k + 1], j + 1, n + 2, b, k)
        _load_wrapped(grid[0], x_0 + j, n, b, 3)
        _load_wrapped(grid[1], x_0 + j, n, b, 4)
        _potential_and_force(b, n, c)
        _store(b, 5, n, mu, 1, r, j, periodic)
        _add_wrapped(b, 6, n, grid[2], x_0 + j)
        _add_wrapped(b, 7, n, grid[3], x_0 + j)


@njit(**FAST)
def _square(b: Any, n: int) -> None:
    """Square of slot 0 in slot 1."""
    for x in range(n):
        b[S + x] = b[x] * b[x]


@njit(**FAST)
def _sum_row(psi: Any, r: int, x_0: int, grid: Any, b: Any) -> None:
    """Add a field's row to the sums of squares and of fields."""
    w = psi.shape[1] - 2 * RIM
    for j in range(0, w, PIECE):
        n = min(PIECE, w - j)
        _load(psi[r + RIM], j + RIM, n, b, 0)
        _square(b, n)
        _add_wrapped(b, 1, n, grid[0], x_0 + j)
        _add_wrapped(b, 0, n, grid[1], x_0 + j)


@njit(**FAST)
def _collide(b: Any, n: int, c: Constants) -> None:
    """Two-time collision with Guo's force; f_i in slots 0-8, F in 9, 10; leaves u in 11, 12."""
    op, om = c.omega_plus, c.omega_minus
    kp, km = 1 - 0.5 * op, 1 - 0.5 * om
    for x in range(n):
        f0, f1, f2, f3, f4 = b[x], b[S + x], b[2 * S + x], b[3 * S + x], b[4 * S + x]
        f5, f6, f7, f8 = b[5 * S + x], b[6 * S + x], b[7 * S + x], b[8 * S + x]
        fx, fy = b[9 * S + x], b[10 * S + x]
        rho = f0 + ((f1 + f3) + (f2 + f4)) + ((f5 + f7) + (f6 + f8))
        ux = ((f1 - f3) + (f5 - f7) - (f6 - f8) + 0.5 * fx) / rho
        uy = ((f2 - f4) + (f5 - f7) + (f6 - f8) + 0.5 * fy) / rho
        b[11 * S + x] = ux
        b[12 * S + x] = uy
        uu = 1 - 1.5 * (ux * ux + uy * uy)
        uf = 3 * (ux * fx + uy * fy)
        b[x] = (1 - op) * f0 + 4 / 9 * (op * rho * uu - kp * uf)
        e1, o1 = _even_odd(f1, f3, ux, fx, rho, uu, uf, 1 / 9, op, om, kp, km)
        e2, o2 = _even_odd(f2, f4, uy, fy, rho, uu, uf, 1 / 9, op, om, kp, km)
        e5, o5 = _even_odd(f5, f7, ux + uy, fx + fy, rho, uu, uf, 1 / 36, op, om, kp, km)
        e6, o6 = _even_odd(f6, f8, uy - ux, fy - fx, rho, uu, uf, 1 / 36, op, om, kp, km)
        b[S + x], b[3 * S + x] = e1 + o1, e1 - o1
        b[2 * S + x], b[4 * S + x] = e2 + o2, e2 - o2
        b[5 * S + x], b[7 * S + x] = e5 + o5, e5 - o5
        b[6 * S + x], b[8 * S + x] = e6 + o6, e6 - o6


@njit(**FAST)
def _even_odd(
    f: float, g: float, cu: float, cf: float, rho: float, uu: float, uf: float, w: float,
    op: float, om: float, kp: float, km: float,
) -> tuple[float, float]:  # fmt: skip
    """Even and odd part after collision of a pair of opposite populations f and g."""
    even = (1 - op) * 0.5 * (f + g) + w * (
        op * rho * (uu + 4.5 * cu * cu) + kp * (9 * cu * cf - uf)
    )
    odd = (1 - om) * 0.5 * (f - g) + 3 * w * (om * rho * cu + km * cf)
    return even, odd


@njit(**FAST)
def _pulled(post: Any, i: int, cx: int, cy: int, y: int, wall: Any, row: Any) -> None:
    """Population i that arrives at row y from `post`.

    wall: 6 w_i rho v of the lower and the upper wall.
    """
    height, width = post.shape[1], post.shape[2]
    if (y == 0 and cy > 0) or (y == height - 1 and cy < 0):
        opposite = i + 2 if i in {1, 2, 5, 6} else i - 2
        term = cx * (wall[0] if y == 0 else wall[1])
        source = post[opposite, y]
        for x in range(width):
            row[x] = source[x] + term
    elif cx == 0:
        _copy(post[i, y - cy], row, width)
    elif cx > 0:
        _copy(post[i, y - cy], row[1:], width - 1)
        row[0] = post[i, y - cy, width - 1]
    else:
        _copy(post[i, y - cy, 1:], row, width - 1)
        row[width - 1] = post[i, y - cy, 0]


@njit(**FAST)
def _pull_row(post: Any, y: int, wall: Any, rows: Any) -> None:
    """Streaming with half-way bounce-back: all that arrives at row y."""
    _pulled(post, 0, 0, 0, y, wall, rows[0])
    _pulled(post, 1, 1, 0, y, wall, rows[1])
    _pulled(post, 2, 0, 1, y, wall, rows[2])
    _pulled(post, 3, -1, 0, y, wall, rows[3])
    _pulled(post, 4, 0, -1, y, wall, rows[4])
    _pulled(post, 5, 1, 1, y, wall, rows[5])
    _pulled(post, 6, -1, 1, y, wall, rows[6])
    _pulled(post, 7, -1, -1, y, wall, rows[7])
    _pulled(post, 8, 1, -1, y, wall, rows[8])


@njit(**FAST)
def _transport(b: Any, n: int, lower: float, upper: float, c: Constants) -> None:
    """Field psi a step later in slot 12.

    From psi in row y (slot 0, two nodes more on either side) and rows y - 2, y - 1, y + 1, y + 2
    (1-4), mu in rows y - 1, y, y + 1 (5-7, a node more), u_x in row y (8, a node more), u_y in
    the three rows (9-11), the outer two times `lower` and `upper`.
    """
    near, far = 6 + c.outer, c.outer
    for x in range(n):
        psi, e, w = b[x + 2], b[x + 3], b[x + 1]
        s, nn = b[2 * S + x], b[3 * S + x]
        ux, uy = b[8 * S + x + 1], b[10 * S + x]
        east = (ux + b[8 * S + x + 2]) * (near * (psi + e) - far * (w + b[x + 4]))
        west = (b[8 * S + x] + ux) * (near * (w + psi) - far * (b[x] + e))
        north = (uy + upper * b[11 * S + x]) * (near * (psi + nn) - far * (s + b[4 * S + x]))
        south = (lower * b[9 * S + x] + uy) * (near * (s + psi) - far * (b[S + x] + nn))
        cross = b[6 * S + x] + b[6 * S + x + 2] + b[5 * S + x + 1] + b[7 * S + x + 1]
        corners = b[5 * S + x] + b[5 * S + x + 2] + b[7 * S + x] + b[7 * S + x + 2]
        lap = (4 * cross + corners - 20 * b[6 * S + x + 1]) / 6
        b[12 * S + x] = psi + c.mobility * lap - ((east - west) + (north - south)) / 24


@njit(**FAST)
def _transport_row(
    psi: Any, new: Any, mu: Any, u: Any, r: int, y: int, x_0: int, periodic: bool,
    b: Any, c: Constants,
) -> None:  # fmt: skip
    """One field's row a step later (Eq. B1); u (2, H, W)."""
    h, w = psi.shape[0] - 2 * RIM, psi.shape[1] - 2 * RIM
    lower = -1.0 if r == 0 else 1.0  # no flux through the first and the last face
    upper = -1.0 if r == h - 1 else 1.0
    for j in range(0, w, PIECE):
        n = min(PIECE, w - j)
        _load(psi[r + 2], j, n + 4, b, 0)
        _load(psi[r], j + 2, n, b, 1)
        _load(psi[r + 1], j + 2, n, b, 2)
        _load(psi[r + 3], j + 2, n, b, 3)
        _load(psi[r + 4], j + 2, n, b, 4)
        for k in range(3):
            _load(mu[r + k], j, n + 2, b, 5 + k)
        _load_wrapped(u[0, y], x_0 + j - 1, n + 2, b, 8)
        if not periodic and j == 0:
            b[8 * S] = -b[8 * S + 1]
        if not periodic and j + n == w:
            b[8 * S + n + 1] = -b[8 * S + n]
        _load_wrapped(u[1, y if r == 0 else y - 1], x_0 + j, n, b, 9)
        _load_wrapped(u[1, y], x_0 + j, n, b, 10)
        _load_wrapped(u[1, y if r == h - 1 else y + 1], x_0 + j, n, b, 11)
        _transport(b, n, lower, upper, c)
        _store(b, 12, n, new, RIM, r, j, periodic)


@njit(**FAST)
def _collide_rows(
    first: int, last: int, arrived: Any, post: Any, outer: Any, outer_mu: Any, cores: Any,
    cores_mu: Any, origins: Any, periodic: bool, wall: Any, streamed: bool, u: Any, c: Constants,
) -> None:  # fmt: skip
    """Forces, potentials, velocity and collision of the rows first to last - 1."""
    h, width = cores.shape[1] - 2 * RIM, post.shape[2]
    b = np.empty(SLOTS * S)
    grid = np.empty((4, width))
    rows = np.empty((9, width))
    for y in range(first, last):
        grid[:] = 0.0
        _sum_row(outer, y, 0, grid, b)
        for k in range(len(origins)):
            r = y - origins[k, 0]
            if 0 <= r < h:
                _sum_row(cores[k], r, origins[k, 1], grid, b)
        grid[2] = c.force_x
        _field_row(outer, outer_mu, y, 0, True, grid, b, c)
        for k in range(len(origins)):
            r = y - origins[k, 0]
            if 0 <= r < h:
                _field_row(cores[k], cores_mu[k], r, origins[k, 1], periodic, grid, b, c)
        if streamed:
            for i in range(9):
                _copy(arrived[i, y], rows[i], width)
        else:
            _pull_row(arrived, y, wall, rows)
        for j in range(0, width, PIECE):
            n = min(PIECE, width - j)
            for i in range(9):
                _load(rows[i], j, n, b, i)
            _load(grid[2], j, n, b, 9)
            _load(grid[3], j, n, b, 10)
            _collide(b, n, c)
            for i in range(9):
                _copy(b[i * S :], post[i, y, j:], n)
            for i in range(2):
                _copy(b[(11 + i) * S :], u[i, y, j:], n)


@njit(**FAST)
def _transport_rows(
    first: int, last: int, outer: Any, outer_new: Any, outer_mu: Any, cores: Any, cores_new: Any,
    cores_mu: Any, origins: Any, periodic: bool, u: Any, c: Constants,
) -> None:  # fmt: skip
    """All fields a step later in the rows first to last - 1."""
    h = cores.shape[1] - 2 * RIM
    b = np.empty(SLOTS * S)
    for y in range(first, last):
        _transport_row(outer, outer_new, outer_mu, u, y, y, 0, True, b, c)
        for k in range(len(origins)):
            r = y - origins[k, 0]
            if 0 <= r < h:
                x_0 = origins[k, 1]
                _transport_row(
                    cores[k], cores_new[k], cores_mu[k], u, r, y, x_0, periodic, b, c
                )  # fmt: skip


@njit(**FAST)
def _stream_rows(first: int, last: int, post: Any, f: Any, wall: Any) -> None:
    """Streaming of the rows first to last - 1."""
    rows = np.empty((9, f.shape[2]))
    for y in range(first, last):
        _pull_row(post, y, wall, rows)
        for i in range(9):
            _copy(rows[i], f[i, y], f.shape[2])


@njit(parallel=True, **FAST)
def advance(
    steps: int, f: Any, post: Any, post_new: Any, outer: Any, outer_new: Any, outer_mu: Any,
    cores: Any, cores_new: Any, cores_mu: Any, origins: Any, periodic: bool, wall: Any, u: Any,
    c: Constants, blocks: int,
) -> Any:  # fmt: skip
    """Advance f in place; returns the outer field and the cores, both with rims.

    outer (H + 4, W + 4) and cores (M, h + 4, w + 4) with rims of two, *_mu with rims of one.
    """
    height = f.shape[1]
    size = (height + blocks - 1) // blocks
    for step in range(steps):
        arrived = f if step == 0 else post
        for block in prange(blocks):
            _collide_rows(
                block * size, min(height, (block + 1) * size), arrived, post_new, outer, outer_mu,
                cores, cores_mu, origins, periodic, wall, step == 0, u, c,
            )  # fmt: skip
        for block in prange(blocks):
            _transport_rows(
                block * size, min(height, (block + 1) * size), outer, outer_new, outer_mu,
                cores, cores_new, cores_mu, origins, periodic, u, c,
            )  # fmt: skip
        outer, outer_new = outer_new, outer
        cores, cores_new = cores_new, cores
        post, post_new = post_new, post
    for block in prange(blocks):
        _stream_rows(block * size, min(height, (block + 1) * size), post, f, wall)
    return outer, cores
