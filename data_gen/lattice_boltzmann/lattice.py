"""The D2Q9 lattice: moments, equilibrium, collision, streaming, walls, derivatives.

Lattice units: dx = dt = 1, c_s^2 = 1/3. Populations f are (9, H, W), vector fields (2, H, W) with x
first; all are indexed [y, x] with y up. Plain NumPy, one function per term: the reference for the
compiled kernels. Sources: Krueger et al., The Lattice Boltzmann Method (2017); Guo et al., PRE 65,
046308 (2002) for the force; Ginzburg et al., Commun. Comput. Phys. 3 (2008) for two times.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Bools, Floats
from droptrack.errors import DroptrackError

CX = np.array([0, 1, 0, -1, 0, 1, -1, -1, 1])
CY = np.array([0, 0, 1, 0, -1, 1, 1, -1, -1])
C = np.stack([CX, CY], axis=1)  # (9, 2)
W = np.array([4 / 9] + 4 * [1 / 9] + 4 * [1 / 36])
OPPOSITE = np.array([0, 3, 4, 1, 2, 7, 8, 5, 6])
CS2 = 1 / 3


def density(f: Floats) -> Floats:
    """Density: sum_i f_i, (H, W)."""
    return np.asarray(f.sum(axis=0))


def momentum(f: Floats) -> Floats:
    """Momentum: sum_i c_i f_i, (2, H, W)."""
    return np.asarray(np.einsum("id,iyx->dyx", C, f))


def momentum_flux(f: Floats) -> Floats:
    """Momentum flux: sum_i c_i c_i f_i, (2, 2, H, W)."""
    return np.asarray(np.einsum("id,ie,iyx->deyx", C, C, f))


def along(vector: Floats) -> Floats:
    """c_i . v for every direction, (9, H, W)."""
    return np.asarray(np.einsum("id,dyx->iyx", C, vector))


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar product a . b, (H, W)."""
    return np.asarray((a * b).sum(axis=0))


def outer(a: Floats, b: Floats) -> Floats:
    """Dyadic product a b, (2, 2, H, W)."""
    return np.asarray(a[:, None] * b[None, :])


def equilibrium(rho: Floats, u: Floats) -> Floats:
    """w_i rho (1 + 3 c.u + 9/2 (c.u)^2 - 3/2 u.u), (9, H, W)."""
    cu = along(u)
    polynomial = 1 + 3 * cu + 4.5 * cu**2 - 1.5 * dot(u, u)
    return np.asarray(W[:, None, None] * rho * polynomial)


def viscous_time(viscosity: float) -> float:
    """Relaxation time of the stress for a kinematic viscosity nu = (tau - 1/2) / 3."""
    return viscosity / CS2 + 0.5


def odd_time(tau_plus: float, magic: float) -> float:
    """tau_minus such that (tau_plus - 1/2) (tau_minus - 1/2) = magic."""
    return 0.5 + magic / (tau_plus - 0.5)


def relax(f: Floats, f_eq: Floats, tau_plus: float, tau_minus: float) -> Floats:
    """Collision with two relaxation times: even parts relax with tau_plus, odd with tau_minus."""
    rest = f - f_eq
    even = (rest + rest[OPPOSITE]) / 2
    odd = (rest - rest[OPPOSITE]) / 2
    return np.asarray(f - even / tau_plus - odd / tau_minus)


def guo_force(u: Floats, force: Floats, tau_plus: float, tau_minus: float) -> Floats:
    """Force term of the collision, (9, H, W): the even part is the work, the odd the momentum."""
    cu, cf = along(u), along(force)
    even = 9 * cu * cf - 3 * dot(u, force)
    odd = 3 * cf
    term = (1 - 0.5 / tau_plus) * even + (1 - 0.5 / tau_minus) * odd
    return np.asarray(W[:, None, None] * term)


def stream(f: Floats) -> Floats:
    """Every population moves to the next node of its direction; periodic in x and y."""
    return np.stack([np.roll(f[i], (CY[i], CX[i]), axis=(0, 1)) for i in range(9)])


def stream_in_channel(f: Floats, rho_wall: float, v_bottom: float, v_top: float) -> Floats:
    """Streaming between walls below the first and above the last row, periodic in x.

    Half-way bounce-back: what would cross a wall returns reversed, and takes the momentum
    6 w_i rho c_i . v of a wall that moves along x.
    """
    moved = stream(f)
    for i in range(9):
        if CY[i] > 0:
            moved[i, 0] = f[OPPOSITE[i], 0] + 6 * W[i] * rho_wall * CX[i] * v_bottom
        elif CY[i] < 0:
            moved[i, -1] = f[OPPOSITE[i], -1] + 6 * W[i] * rho_wall * CX[i] * v_top
    return moved


def stream_among_solids(outgoing: Floats, solid: Bools) -> Floats:
    """Streaming in a closed box with solid nodes: half-way bounce-back at them and at the edges.

    outgoing (9, H, W); solid (H, W). Solid nodes get zeros.
    """
    blocked = np.pad(solid, 1, constant_values=True)
    padded = np.pad(outgoing, ((0, 0), (1, 1), (1, 1)))
    moved = np.empty_like(outgoing)
    for i in range(9):
        moved[i] = np.where(
            shifted(blocked, -CX[i], -CY[i]),
            outgoing[OPPOSITE[i]],
            shifted(padded[i], -CX[i], -CY[i]),
        )
    moved[:, solid] = 0.0
    return moved


def shifted(padded: NDArray[Any], dx: int, dy: int) -> NDArray[Any]:
    """The field at (x + dx, y + dy), (H, W), from one padded by a node on every side."""
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    return padded[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]


def pad(field: Floats, *, periodic_x: bool, rim: int = 1) -> Floats:
    """A field (..., H, W) with a rim of nodes: mirrored, or periodic in x."""
    rims = [(0, 0)] * (field.ndim - 2)
    mirrored = np.pad(field, [*rims, (rim, rim), (0, 0)], mode="symmetric")
    mode: Any = "wrap" if periodic_x else "symmetric"
    return np.asarray(np.pad(mirrored, [*rims, (0, 0), (rim, rim)], mode=mode))


def gradient(padded: Floats) -> Floats:
    """Isotropic central differences [4 (E - W) + (NE - NW) + (SE - SW)] / 12 and alike in y.

    From (H + 2, W + 2) to (2, H, W), second order.
    """
    return np.asarray(
        sum(3 * W[i] * C[i][:, None, None] * shifted(padded, CX[i], CY[i]) for i in range(1, 9))
    )


def laplacian(padded: Floats) -> Floats:
    """[4 (E + W + N + S) + (NE + NW + SE + SW) - 20 C] / 6, (H, W), second order."""
    ring = sum(6 * W[i] * shifted(padded, CX[i], CY[i]) for i in range(1, 9))
    return np.asarray(ring - 20 / 6 * shifted(padded, 0, 0))


def check_viscosity(tau: float) -> None:
    """Raise DroptrackError for a relaxation time outside the range where D2Q9 is of use."""
    if not tau > 0.5:
        raise DroptrackError(f"a relaxation time of {tau:g}: should be above 1/2 (viscosity > 0)")
    if tau > 10:
        raise DroptrackError(
            f"a relaxation time of {tau:g}: above 10 errors of the lattice exceed a few per cent; "
            "take a smaller viscosity"
        )
