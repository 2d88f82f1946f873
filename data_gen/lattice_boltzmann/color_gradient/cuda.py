"""The colour-gradient model compiled for a GPU: the terms of reference.py, one thread per node.

A step is three launches: `add_up`, `collide`, `transport`. Each thread gathers what its own node
of the grid needs, from its neighbours and from every droplet whose window covers it, always in the
same order: nothing is added by several threads, so results are the same in every run. Droplets and
fluxes lie in their windows, (N, h, w) and (N, 2, h, w); fluxes hold rho q. Double precision.

Kernels get their arrays one by one, as Numba needs them, however many they are.
"""

import math
from typing import Any

import numpy as np
from numba import cuda

from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.compiled_collision import Constants
from data_gen.lattice_boltzmann.lattice import CX, CY, OPPOSITE, W

TINY = cg.NO_GRADIENT
CONTACT = cg.CONTACT_GRADIENT**2
NOTHING = cg.NOTHING
B = cg.B
SHARE = W / cg.LENGTH
OPPOSITES = OPPOSITE.astype(np.int64)
C_X, C_Y = CX.astype(np.int64), CY.astype(np.int64)


@cuda.jit(device=True)
def _value(field: Any, y: int, x: int) -> float:
    """Value at a node, 0 outside the array."""
    if 0 <= y < field.shape[0] and 0 <= x < field.shape[1]:
        return float(field[y, x])
    return 0.0


@cuda.jit(device=True)
def _gradient(c: Any, y: int, x: int) -> tuple[float, float]:
    """Gradient of a fraction that is 0 outside its array."""
    gx, gy = 0.0, 0.0
    for i in range(1, 9):
        term = 3 * W[i] * _value(c, y + C_Y[i], x + C_X[i])
        gx += C_X[i] * term
        gy += C_Y[i] * term
    return gx, gy


@cuda.jit(device=True)
def _length(gx: float, gy: float) -> float:
    """Length of a gradient, or what to divide by where it has no direction."""
    return max(math.sqrt(gx * gx + gy * gy), TINY)


@cuda.jit(device=True)
def _recolouring(c: float, gx: float, gy: float, beta: float) -> tuple[float, float]:
    """Flux beta c (1 - c) n that keeps an interface sharp (Omega^(3) of Eq. A2)."""
    strength = beta * c * (1 - c) / _length(gx, gy)
    return strength * gx, strength * gy


@cuda.jit(device=True)
def _sampled(field: Any, y: float, x: float) -> float:
    """Bilinear value between nodes, 0 outside."""
    y_0, x_0 = int(math.floor(y)), int(math.floor(x))  # noqa: RUF046  a float on GPUs
    t, s = y - y_0, x - x_0
    low = (1 - s) * _value(field, y_0, x_0) + s * _value(field, y_0, x_0 + 1)
    high = (1 - s) * _value(field, y_0 + 1, x_0) + s * _value(field, y_0 + 1, x_0 + 1)
    return float((1 - t) * low + t * high)


@cuda.jit(device=True)
def _others_nearby(
    label: Any, r: int, s: int, gx: float, gy: float, e: Any, total: Any, y: int, x: int, h_0: float
) -> float:
    """O of the near-contact force: the fraction of others a distance h_0 outward."""
    reach = h_0 / math.sqrt(gx * gx + gy * gy)
    dy, dx = -reach * gy, -reach * gx
    others = _sampled(total, y + dy, x + dx) - _sampled(label, r + dy, s + dx)
    return float(others + (1 - _sampled(e, y + dy, x + dx)))


@cuda.jit(device=True)
def _collide(
    f: Any, post: Any, y: int, x: int, fx: float, fy: float, gxx: float, gxy: float, gyy: float,
    c: Constants,
) -> float:  # fmt: skip
    """Regularised collision of a node with force F and perturbation of G; returns rho."""
    rho, mx, my, pxx, pxy, pyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(9):
        value = f[i, y, x]
        rho += value
        mx += C_X[i] * value
        my += C_Y[i] * value
        pxx += C_X[i] * C_X[i] * value
        pxy += C_X[i] * C_Y[i] * value
        pyy += C_Y[i] * C_Y[i] * value
    jx, jy = mx + fx, my + fy  # rho u + F / 2
    ux, uy = (mx + fx / 2) / rho, (my + fy / 2) / rho
    keep, work = 1 - c.omega, 1 - c.omega / 2
    ixx, ixy, iyy = rho * ux * ux, rho * ux * uy, rho * uy * uy
    sxx = ixx + keep * (pxx - rho / 3 - ixx) + 2 * work * ux * fx
    sxy = ixy + keep * (pxy - ixy) + work * (ux * fy + uy * fx)
    syy = iyy + keep * (pyy - rho / 3 - iyy) + 2 * work * uy * fy
    for i in range(9):
        xx, xy, yy = C_X[i] * C_X[i], C_X[i] * C_Y[i], C_Y[i] * C_Y[i]
        along = C_X[i] * jx + C_Y[i] * jy
        hermite = xx * sxx + 2 * xy * sxy + yy * syy - (sxx + syy) / 3
        tension = xx * gxx + 2 * xy * gxy + yy * gyy
        fluid = W[i] * (rho + 3 * along + 4.5 * hermite)
        post[i, y, x] = fluid + c.perturbation * (W[i] * tension - B[i] * (gxx + gyy))
    return rho


@cuda.jit
def add_up(labels: Any, origins: Any, total: Any) -> None:
    """Sum of all droplets' fractions, (H, W)."""
    x, y = cuda.grid(2)
    if y >= total.shape[0] or x >= total.shape[1]:
        return
    here = 0.0
    for k in range(len(origins)):
        here += _value(labels[k], y - origins[k, 0], x - origins[k, 1])
    total[y, x] = here


@cuda.jit
def collide(
    f: Any, post: Any, e: Any, q_e: Any, total: Any, labels: Any, q: Any, origins: Any, solid: Any,
    push: Any, c: Constants,
) -> None:  # fmt: skip
    """Forces, fluxes and collision: fills post, q_e (2, H, W) and q of fluid nodes."""
    x, y = cuda.grid(2)
    if y >= e.shape[0] or x >= e.shape[1] or solid[y, x]:
        return
    h, w = labels.shape[1], labels.shape[2]
    here = e[y, x]
    gx, gy = _gradient(e, y, x)
    ex, ey = _recolouring(here, gx, gy, c.beta)
    length = _length(gx, gy)
    gxx, gxy, gyy = gx * gx / length, gx * gy / length, gy * gy / length
    fx, fy = c.wall_force * here * push[0, y, x], c.wall_force * here * push[1, y, x]
    film_x, film_y = gx, gy
    sum_x, sum_y = 0.0, 0.0
    for k in range(len(origins)):
        r, s = y - origins[k, 0], x - origins[k, 1]
        if not (0 <= r < h and 0 <= s < w):
            continue
        gx, gy = _gradient(labels[k], r, s)
        ax, ay = _recolouring(labels[k, r, s], gx, gy, c.beta)
        q[k, 0, r, s], q[k, 1, r, s] = ax, ay
        if gx == 0 and gy == 0:
            continue
        sum_x += ax
        sum_y += ay
        film_x -= gx
        film_y -= gy
        length = _length(gx, gy)
        gxx += gx * gx / length
        gxy += gx * gy / length
        gyy += gy * gy / length
        if gx * gx + gy * gy > CONTACT:
            others = _others_nearby(labels[k], r, s, gx, gy, e, total, y, x, c.distance)
            fx += c.contact * others * gx
            fy += c.contact * others * gy
    film = here - total[y, x]
    bx, by = _recolouring(film, film_x, film_y, c.beta)
    qx, qy = sum_x + bx - ex, sum_y + by - ey  # what the fluxes would add up to
    rho = _collide(f, post, y, x, fx, fy, gxx, gxy, gyy, c)
    q_e[0, y, x] = rho * (ex + (1 - here) * qx)
    q_e[1, y, x] = rho * (ey + (1 - here) * qy)
    for k in range(len(origins)):
        r, s = y - origins[k, 0], x - origins[k, 1]
        if 0 <= r < h and 0 <= s < w:
            q[k, 0, r, s] = rho * (q[k, 0, r, s] - labels[k, r, s] * qx)
            q[k, 1, r, s] = rho * (q[k, 1, r, s] - labels[k, r, s] * qy)


@cuda.jit(device=True)
def _blocked(solid: Any, y: int, x: int) -> bool:
    """Whether a node is solid or outside the box."""
    inside = 0 <= y < solid.shape[0] and 0 <= x < solid.shape[1]
    return not inside or bool(solid[y, x])


@cuda.jit(device=True)
def _arriving(post: Any, solid: Any, i: int, y: int, x: int) -> float:
    """Population i that arrives at a fluid node, from its neighbour or back from a wall."""
    if _blocked(solid, y - C_Y[i], x - C_X[i]):
        return float(post[OPPOSITES[i], y, x])
    return float(post[i, y - C_Y[i], x - C_X[i]])


@cuda.jit(device=True)
def _arriving_mass(c: Any, q: Any, post: Any, solid: Any, r: int, s: int, y: int, x: int) -> float:
    """Mass of a component that arrives at a fluid node, which is (r, s) of the component's array.

    The sum over i of what of it leaves nodes towards this one, c f_i + rho w_i q . c_i / |c_i|.
    """
    mass = 0.0
    for i in range(9):
        dy, dx = C_Y[i], C_X[i]
        if _blocked(solid, y - dy, x - dx):
            flux = -(dx * q[0, r, s] + dy * q[1, r, s])
            mass += c[r, s] * post[OPPOSITES[i], y, x] + SHARE[i] * flux
        elif 0 <= r - dy < c.shape[0] and 0 <= s - dx < c.shape[1]:
            flux = dx * q[0, r - dy, s - dx] + dy * q[1, r - dy, s - dx]
            mass += c[r - dy, s - dx] * post[i, y - dy, x - dx] + SHARE[i] * flux
    return mass


@cuda.jit(device=True)
def _outlet(f: Any, post: Any, solid: Any, y: int, x: int, rho_0: float) -> float:
    """Last node of a row: density rho_0, the rest from the node before; returns the density."""
    rho, mx, my = 0.0, 0.0, 0.0
    for i in range(9):
        value = _arriving(post, solid, i, y, x - 1)
        rho += value
        mx += C_X[i] * value
        my += C_Y[i] * value
    ux, uy = mx / rho, my / rho
    total = 0.0
    for i in range(9):
        cu = C_X[i] * ux + C_Y[i] * uy
        per_density = W[i] * (1 + 3 * cu + 4.5 * cu * cu - 1.5 * (ux * ux + uy * uy))
        value = _arriving(post, solid, i, y, x - 1) + (rho_0 - rho) * per_density
        f[i, y, x] = value
        total += value
    return total


@cuda.jit(device=True)
def _stream(f: Any, post: Any, solid: Any, y: int, x: int, inlet: float, rho_0: float) -> float:
    """Populations a step later, between the open ends; returns the density.

    inlet: 6 rho U, what fluid that enters at U brings.
    """
    if x == f.shape[2] - 1:
        return float(_outlet(f, post, solid, y, x, rho_0))
    rho = 0.0
    for i in range(9):
        value = _arriving(post, solid, i, y, x)
        if x == 0 and C_X[i] == 1:
            value += W[i] * inlet
        f[i, y, x] = value
        rho += value
    return rho


@cuda.jit(device=True)
def _nothing_near(c: Any, r: int, s: int) -> bool:
    """Whether a fraction is 0 at a node and around it, so that nothing of it can arrive."""
    nothing = True
    for i in range(9):
        nothing = nothing and _value(c, r + C_Y[i], s + C_X[i]) == 0
    return nothing


@cuda.jit(device=True)
def _trimmed(c: float) -> float:
    """A fraction, 0 where it is as good as nothing."""
    return 0.0 if abs(c) < NOTHING else c


@cuda.jit
def transport(
    f: Any, post: Any, e: Any, e_new: Any, q_e: Any, labels: Any, labels_new: Any, q: Any,
    origins: Any, solid: Any, inlet: float, rho_0: float,
) -> None:  # fmt: skip
    """Streaming of the fluid and of all fractions: fills f, e_new and labels_new."""
    x, y = cuda.grid(2)
    if y >= e.shape[0] or x >= e.shape[1]:
        return
    wall = solid[y, x]
    rho = 1.0
    if wall:
        for i in range(9):
            f[i, y, x] = 0.0
        e_new[y, x] = 0.0
    else:
        rho = _stream(f, post, solid, y, x, inlet, rho_0)
        e_new[y, x] = _trimmed(_arriving_mass(e, q_e, post, solid, y, x, y, x) / rho)
    h, w = labels.shape[1], labels.shape[2]
    for k in range(len(origins)):
        r, s = y - origins[k, 0], x - origins[k, 1]
        if not (0 <= r < h and 0 <= s < w):
            continue
        if wall or _nothing_near(labels[k], r, s):
            labels_new[k, r, s] = 0.0
        else:
            mass = _arriving_mass(labels[k], q[k], post, solid, r, s, y, x)
            labels_new[k, r, s] = _trimmed(mass / rho)
