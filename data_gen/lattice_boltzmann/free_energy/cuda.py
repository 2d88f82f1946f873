"""The free-energy model compiled for a GPU: the terms of reference.py, one thread per node.

A step is two launches: `collide`, `transport`. Each thread gathers what its own node of the grid
needs, from its neighbours and from every core whose window covers it, always in the same order:
nothing is added by several threads, so results are the same in every run. Fields have no rims:
beyond a wall, or the edge of a window, lies the mirrored field. Double precision.

Kernels get their arrays one by one, as Numba needs them, however many they are.
"""

from typing import Any

import numpy as np
from numba import cuda

from data_gen.lattice_boltzmann.free_energy.compiled import Constants
from data_gen.lattice_boltzmann.lattice import CX, CY, OPPOSITE, W

OPPOSITES = OPPOSITE.astype(np.int64)
C_X, C_Y = CX.astype(np.int64), CY.astype(np.int64)


@cuda.jit(device=True)
def _wrapped(x: int, width: int) -> int:
    """A column of a periodic grid, at most one period off."""
    if x < 0:
        return x + width
    return x - width if x >= width else x


@cuda.jit(device=True)
def _mirrored(r: int, h: int) -> int:
    """A row, mirrored beyond the first and the last."""
    if r < 0:
        return -1 - r
    return 2 * h - 1 - r if r >= h else r


@cuda.jit(device=True)
def _value(field: Any, r: int, s: int, periodic: bool) -> float:
    """Value of a field, also up to two nodes beyond its edges."""
    h, w = field.shape
    column = _wrapped(s, w) if periodic else _mirrored(s, w)
    return float(field[_mirrored(r, h), column])


@cuda.jit(device=True)
def _laplacian(field: Any, r: int, s: int, periodic: bool) -> float:
    """Laplacian of a field, second order."""
    ring = 0.0
    for i in range(1, 9):
        ring += 6 * W[i] * _value(field, r + C_Y[i], s + C_X[i], periodic)
    return float(ring - 20 / 6 * field[r, s])


@cuda.jit(device=True)
def _gradient(field: Any, r: int, s: int, periodic: bool) -> tuple[float, float]:
    """Gradient of a field, second order."""
    gx, gy = 0.0, 0.0
    for i in range(1, 9):
        term = 3 * W[i] * _value(field, r + C_Y[i], s + C_X[i], periodic)
        gx += C_X[i] * term
        gy += C_Y[i] * term
    return gx, gy


@cuda.jit(device=True)
def _potential(
    psi: Any, r: int, s: int, periodic: bool, total: float, squares: float, c: Constants
) -> float:
    """Chemical potential mu_i (Eq. B2), from sum_j psi_j and sum_j psi_j^2."""
    here = psi[r, s]
    bulk = c.a / 2 * here * (here - c.psi_0) * (2 * here - c.psi_0)
    repulsion = 2 * c.epsilon_quadratic * here * (squares - here * here)
    repulsion += c.epsilon * (total - here)
    return float(bulk - c.k * _laplacian(psi, r, s, periodic) + repulsion)


@cuda.jit(device=True)
def _collide(f: Any, post: Any, u: Any, y: int, x: int, fx: float, fy: float, c: Constants) -> None:
    """Two-time collision of a node with Guo's force F; fills u too."""
    rho, mx, my = 0.0, 0.0, 0.0
    for i in range(9):
        rho += f[i, y, x]
        mx += C_X[i] * f[i, y, x]
        my += C_Y[i] * f[i, y, x]
    ux, uy = (mx + fx / 2) / rho, (my + fy / 2) / rho
    u[0, y, x], u[1, y, x] = ux, uy
    uu, uf = ux * ux + uy * uy, ux * fx + uy * fy
    for i in range(9):
        value, back = f[i, y, x], f[OPPOSITES[i], y, x]
        cu, cf = C_X[i] * ux + C_Y[i] * uy, C_X[i] * fx + C_Y[i] * fy
        even = (value + back) / 2 - W[i] * rho * (1 + 4.5 * cu * cu - 1.5 * uu)
        odd = (value - back) / 2 - W[i] * rho * 3 * cu
        force = (1 - c.omega_plus / 2) * (9 * cu * cf - 3 * uf) + (1 - c.omega_minus / 2) * 3 * cf
        post[i, y, x] = value - c.omega_plus * even - c.omega_minus * odd + W[i] * force


@cuda.jit
def collide(
    f: Any, post: Any, u: Any, outer: Any, outer_mu: Any, cores: Any, cores_mu: Any, origins: Any,
    periodic: bool, c: Constants,
) -> None:  # fmt: skip
    """Potentials, force, velocity and collision: fills post, u (2, H, W), outer_mu and cores_mu.

    periodic: whether the cores' fields are, in x. origins: [y, x] with x in 0..W - 1.
    """
    x, y = cuda.grid(2)
    height, width = outer.shape
    if y >= height or x >= width:
        return
    h, w = cores.shape[1], cores.shape[2]
    total = outer[y, x]
    squares = total * total
    for k in range(len(origins)):
        r, s = y - origins[k, 0], _wrapped(x - origins[k, 1], width)
        if 0 <= r < h and s < w:
            total += cores[k, r, s]
            squares += cores[k, r, s] * cores[k, r, s]
    mu = _potential(outer, y, x, True, total, squares, c)
    gx, gy = _gradient(outer, y, x, True)
    fx, fy = mu * gx + c.force_x, mu * gy
    outer_mu[y, x] = mu
    for k in range(len(origins)):
        r, s = y - origins[k, 0], _wrapped(x - origins[k, 1], width)
        if 0 <= r < h and s < w:
            mu = _potential(cores[k], r, s, periodic, total, squares, c)
            gx, gy = _gradient(cores[k], r, s, periodic)
            fx += mu * gx
            fy += mu * gy
            cores_mu[k, r, s] = mu
    _collide(f, post, u, y, x, fx, fy, c)


@cuda.jit(device=True)
def _stream(f: Any, post: Any, y: int, x: int, bottom: float, top: float) -> None:
    """Populations a step later; bottom, top: 6 rho_0 v of walls that move."""
    height, width = f.shape[1], f.shape[2]
    for i in range(9):
        if y == 0 and C_Y[i] > 0:
            f[i, y, x] = post[OPPOSITES[i], y, x] + W[i] * C_X[i] * bottom
        elif y == height - 1 and C_Y[i] < 0:
            f[i, y, x] = post[OPPOSITES[i], y, x] + W[i] * C_X[i] * top
        else:
            f[i, y, x] = post[i, y - C_Y[i], _wrapped(x - C_X[i], width)]


@cuda.jit(device=True)
def _face_value(before: float, here: float, after: float, beyond: float, outer: float) -> float:
    """Value on the face between `here` and `after`: second order, or fourth with `outer` 1."""
    return ((6 + outer) * (here + after) - outer * (before + beyond)) / 12


@cuda.jit(device=True)
def _transported(
    psi: Any, mu: Any, u: Any, r: int, s: int, y: int, x: int, periodic: bool, c: Constants
) -> float:
    """Field psi at (r, s), which is (y, x) of the grid, one step later (Eq. B1).

    Nothing passes the first and the last face, but in x where the field is periodic.
    """
    h, w = psi.shape
    width = u.shape[2]
    here = psi[r, s]
    west, far_west = _value(psi, r, s - 1, periodic), _value(psi, r, s - 2, periodic)
    east, far_east = _value(psi, r, s + 1, periodic), _value(psi, r, s + 2, periodic)
    south, far_south = _value(psi, r - 1, s, periodic), _value(psi, r - 2, s, periodic)
    north, far_north = _value(psi, r + 1, s, periodic), _value(psi, r + 2, s, periodic)
    outflow = 0.0
    if periodic or s < w - 1:
        speed = (u[0, y, x] + u[0, y, _wrapped(x + 1, width)]) / 2
        outflow += speed * _face_value(west, here, east, far_east, c.outer)
    if periodic or s > 0:
        speed = (u[0, y, _wrapped(x - 1, width)] + u[0, y, x]) / 2
        outflow -= speed * _face_value(far_west, west, here, east, c.outer)
    if r < h - 1:
        speed = (u[1, y, x] + u[1, y + 1, x]) / 2
        outflow += speed * _face_value(south, here, north, far_north, c.outer)
    if r > 0:
        speed = (u[1, y - 1, x] + u[1, y, x]) / 2
        outflow -= speed * _face_value(far_south, south, here, north, c.outer)
    return float(here + c.mobility * _laplacian(mu, r, s, periodic) - outflow)


@cuda.jit
def transport(
    f: Any, post: Any, u: Any, outer: Any, outer_new: Any, outer_mu: Any, cores: Any,
    cores_new: Any, cores_mu: Any, origins: Any, periodic: bool, bottom: float, top: float,
    c: Constants,
) -> None:  # fmt: skip
    """Streaming and the fields' transport: fills f, outer_new and cores_new."""
    x, y = cuda.grid(2)
    height, width = outer.shape
    if y >= height or x >= width:
        return
    _stream(f, post, y, x, bottom, top)
    outer_new[y, x] = _transported(outer, outer_mu, u, y, x, y, x, True, c)
    h, w = cores.shape[1], cores.shape[2]
    for k in range(len(origins)):
        r, s = y - origins[k, 0], _wrapped(x - origins[k, 1], width)
        if 0 <= r < h and s < w:
            cores_new[k, r, s] = _transported(cores[k], cores_mu[k], u, r, s, y, x, periodic, c)
