"""Multi-core emulsion in shear: the free-energy lattice Boltzmann model of the paper's appendix B.

Every core has a field psi_i (psi_0 inside, 0 outside), the fluid around the shell a further one;
the shell is where all of them are 0. Lattice units, fields indexed [y, x] with y up. This file is
the reference in plain NumPy, one function per term; compiled.py compiles the same terms.

Where the paper cannot be taken at its word:
- Its repulsion eps psi_i psi_j is bilinear: it has no minimum at psi_i = 0 where psi_j = psi_0, so
  it pushes psi out of its two wells and the cores grow. The quadratic form eps_2 psi_i^2 psi_j^2
  is the default (`epsilon_quadratic`); the literal one is `epsilon`.
- The outer fluid needs a field of its own, or nothing holds the shell.
- The force is + sum_i mu_i grad psi_i, which differs from - sum_i psi_i grad mu_i by a gradient
  that the pressure absorbs.
- The shear rate is (v_top - v_bottom) / height.
- The order of the "finite difference scheme" matters. The error u d^3 psi / dx^3 / 6 of
  second-order fluxes has to be undone by D lap mu, and this drags: a drop in a uniform flow falls
  behind it by a fifth, with fourth-order fluxes (`flux_order` 4) by a twenty-fifth, and the cores
  turn faster. The default is the scheme usual for this model, to compare with others' figures.

By default a core's field lives in a window that moves with it (`window`): a third of the cost, and
what a core dissolves stays in its window, so that small cores do not dissolve away, as they do on
the whole grid (`window` 0) at a rate that the real fluids' far smaller solubility would not allow.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_gen.lattice_boltzmann import lattice
from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

RECENTRE_STEPS = 50  # between moves of the windows


@dataclass(frozen=True, kw_only=True)
class Params:
    """The parameters of the paper, in lattice units. Raises DroptrackError for impossible ones."""

    width: int = 340
    height: int = 170  # L_y
    cores: int = 4  # M
    core_radius: float = 15.0
    shell_radius: float = 50.0
    core_distance: float = 24.0  # of the cores' centres from the middle
    a: float = 0.07  # double well
    k: float = 0.1  # gradient
    mobility: float = 0.1  # D
    viscosity: float = 1.67  # eta, dynamic
    epsilon: float = 0.0  # repulsion as printed
    epsilon_quadratic: float = 0.05
    psi_0: float = 2.0
    rho_0: float = 2.0
    v_top: float = 0.01
    v_bottom: float = -0.01
    force_x: float = 0.0  # a body force, for tests of the flow
    magic: float = 0.25  # (tau_plus - 1/2) (tau_minus - 1/2); 3/16 puts walls exactly half-way
    flux_order: int = 2  # of the fields' advection: 2, or 4, which drags drops far less
    window: int = 54  # side of a core's window; 0: the whole grid
    rest_steps: int = 3000  # before the walls move

    def __post_init__(self) -> None:
        for field in fields(self):
            if not math.isfinite(getattr(self, field.name)):
                raise DroptrackError(f"{field.name}: should be a finite number")
        for name in ("a", "k", "mobility", "viscosity", "psi_0", "rho_0", "magic", "core_radius"):
            if getattr(self, name) <= 0:
                raise DroptrackError(f"{name} {getattr(self, name):g}: should be above 0")
        if self.epsilon < 0 or self.epsilon_quadratic < 0 or self.rest_steps < 0 or self.cores < 0:
            raise DroptrackError("epsilon, rest-steps and cores should not be negative")
        if self.flux_order not in {2, 4}:
            raise DroptrackError(f"flux_order {self.flux_order}: should be 2 or 4")
        if self.width < 4 or self.height < 4 or self.window < 0:
            raise DroptrackError("width and height should be 4 or more, window 0 or more")
        lattice.check_viscosity(self.tau_plus)
        if max(abs(self.v_top), abs(self.v_bottom)) > 0.15:
            raise DroptrackError("walls faster than 0.15 c: the lattice needs low Mach numbers")
        self._check_diffusion()
        self._check_room()

    def _check_diffusion(self) -> None:
        stiffness = 16 / 3  # maximum eigenvalue of - the Laplacian
        well = self.a * self.psi_0**2 / 2
        growth = self.mobility * stiffness * (well + self.k * stiffness)
        if growth > 2:
            raise DroptrackError(
                f"mobility {self.mobility:g} with a {self.a:g}, k {self.k:g}: unstable, "
                f"{growth:.3g} where 2 is the limit; take less of each"
            )
        if self.width_of_interface < 1.2:
            raise DroptrackError(
                f"an interface of sqrt(2 k / a) = {self.width_of_interface:.3g}: should be 1.2 or "
                "wider to be resolved; take a larger k or a smaller a"
            )

    def _check_room(self) -> None:
        if not self.cores:
            return
        clear = 2 * self.width_of_interface
        if self.core_radius < clear or self.shell_radius <= 0:
            raise DroptrackError(
                f"core_radius {self.core_radius:g}: should exceed the interface, {clear:.3g}"
            )
        if self.core_distance + self.core_radius + clear > self.shell_radius:
            raise DroptrackError(
                f"cores of radius {self.core_radius:g} at {self.core_distance:g} from the middle "
                f"do not fit a shell of radius {self.shell_radius:g}"
            )
        if self.cores > 1:
            apart = 2 * self.core_distance * math.sin(math.pi / self.cores)
            if apart < 2 * self.core_radius:
                raise DroptrackError(
                    f"{self.cores} cores of radius {self.core_radius:g} at {self.core_distance:g} "
                    "from the middle overlap; take fewer, smaller, or further out"
                )
        if 2 * (self.shell_radius + clear) > min(self.width, self.height):
            raise DroptrackError(
                f"a shell of radius {self.shell_radius:g} does not fit a channel of "
                f"{self.width} x {self.height}"
            )
        if self.window:
            minimum = math.ceil(2 * self.core_radius + 8 * self.width_of_interface)
            if not minimum <= self.window <= min(self.width, self.height):
                raise DroptrackError(
                    f"window {self.window}: should be {minimum} or more for cores of radius "
                    f"{self.core_radius:g}, and no larger than the channel; or 0 for none"
                )

    @property
    def tau_plus(self) -> float:
        """Relaxation time of the stress."""
        return lattice.viscous_time(self.viscosity / self.rho_0)

    @property
    def tau_minus(self) -> float:
        """Relaxation time of the odd moments."""
        return lattice.odd_time(self.tau_plus, self.magic)

    @property
    def surface_tension(self) -> float:
        """Surface tension sqrt(8 a k / 9) of a core against the shell at psi_0 = 2."""
        return math.sqrt(8 * self.a * self.k / 9) * (self.psi_0 / 2) ** 3

    @property
    def width_of_interface(self) -> float:
        """The length delta of the profile tanh(x / delta); the paper's xi is twice this."""
        return math.sqrt(2 * self.k / self.a) * 2 / self.psi_0

    @property
    def core_shape(self) -> tuple[int, int]:
        """Height and width of the cores' fields."""
        return (self.window, self.window) if self.window else (self.height, self.width)


@dataclass(frozen=True, kw_only=True)
class State:
    """What a step changes. Arrays become read-only.

    f (9, H, W) populations; outer (H, W) the outer fluid's field; cores (M, h, w) the cores';
    origins (M, 2) int64, the [y, x] of their windows' lower left nodes, x not wrapped; step.
    """

    f: Floats
    outer: Floats
    cores: Floats
    origins: NDArray[np.int64]
    step: int

    def __post_init__(self) -> None:
        for array in (self.f, self.outer, self.cores, self.origins):
            array.flags.writeable = False


def core_centres(params: Params) -> Floats:
    """Where the cores start, (M, 2) [x, y]: on a circle, the first at 45 degrees."""
    if params.cores == 1:
        return np.array([[params.width / 2, params.height / 2]])
    angle = np.pi / 4 + 2 * np.pi * np.arange(params.cores) / max(params.cores, 1)
    circle = params.core_distance * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(circle + np.array([params.width, params.height]) / 2)


def disc(centre: Floats, radius: float, params: Params) -> Floats:
    """Equilibrium profile psi_0/2 (1 - tanh((r - R) / delta)) on the grid, (H, W).

    Node x is the pixel [x, x + 1): its centre is x + 1/2.
    """
    y, x = np.mgrid[: params.height, : params.width] + 0.5
    dx = (x - centre[0] + params.width / 2) % params.width - params.width / 2
    r = np.hypot(dx, y - centre[1])
    return np.asarray(params.psi_0 / 2 * (1 - np.tanh((r - radius) / params.width_of_interface)))


def initial_state(params: Params) -> State:
    """Round cores in a round shell, at rest, saturated: mu is that of their curvature."""
    middle = np.array([params.width, params.height]) / 2
    whole = [disc(centre, params.core_radius, params) for centre in core_centres(params)]
    if params.cores:
        outer = params.psi_0 - disc(middle, params.shell_radius, params)
    else:
        outer = np.full((params.height, params.width), params.psi_0)
    squares = outer**2 + sum(core**2 for core in whole)
    well = params.a * params.psi_0**2 / 2 + 2 * params.epsilon_quadratic * squares
    if params.cores:
        sigma = params.surface_tension
        whole = [core + sigma / (params.core_radius * params.psi_0) / well for core in whole]
        outer = outer - sigma / (params.shell_radius * params.psi_0) / well
    origins = np.zeros((params.cores, 2), np.int64)
    if params.window:
        corner = core_centres(params)[:, ::-1] - params.window / 2
        origins = np.round(corner).astype(np.int64)
        origins[:, 0] = origins[:, 0].clip(0, params.height - params.window)
    cores = np.empty((params.cores, *params.core_shape))
    for i, core in enumerate(whole):
        cores[i] = core[nodes(params, origins[i])]
    rho = np.full((params.height, params.width), params.rho_0)
    f = lattice.equilibrium(rho, np.zeros((2, params.height, params.width)))
    return State(f=f, outer=outer, cores=cores, origins=origins, step=0)


def nodes(params: Params, origin: NDArray[np.int64]) -> tuple[Any, ...]:
    """Index of the grid's nodes under a window (x wraps)."""
    h, w = params.core_shape
    return np.ix_(origin[0] + np.arange(h), (origin[1] + np.arange(w)) % params.width)


def bulk_potential(params: Params, psi: Floats) -> Floats:
    """First term of mu: a/2 psi (psi - psi_0) (2 psi - psi_0), of the double well of Eq. B2."""
    return np.asarray(params.a / 2 * psi * (psi - params.psi_0) * (2 * psi - params.psi_0))


def gradient_potential(params: Params, psi_padded: Floats) -> Floats:
    """Second term of mu: - k lap psi."""
    return -params.k * lattice.laplacian(psi_padded)


def repulsion_potential(params: Params, psi: Floats, total: Floats, squares: Floats) -> Floats:
    """Third term of mu, from `total` = sum_j psi_j and `squares` = sum_j psi_j^2.

    2 eps_2 psi_i sum_{j != i} psi_j^2 + eps sum_{j != i} psi_j.
    """
    quadratic = 2 * params.epsilon_quadratic * psi * (squares - psi**2)
    return np.asarray(quadratic + params.epsilon * (total - psi))


def potential(params: Params, psi_padded: Floats, total: Floats, squares: Floats) -> Floats:
    """Chemical potential mu_i = delta F / delta psi_i (Eq. B2)."""
    psi = lattice.shifted(psi_padded, 0, 0)
    return np.asarray(
        bulk_potential(params, psi)
        + gradient_potential(params, psi_padded)
        + repulsion_potential(params, psi, total, squares)
    )


def pad_velocity(u: Floats, *, periodic_x: bool) -> Floats:
    """Velocity (2, h, w) with a rim where its normal part is reversed: no flux through the face."""
    padded = lattice.pad(u, periodic_x=periodic_x)
    padded[1, [0, -1]] *= -1
    if not periodic_x:
        padded[0][:, [0, -1]] *= -1
    return padded


def advection(params: Params, psi: Floats, u_padded: Floats, *, periodic_x: bool) -> Floats:
    """Divergence of psi u, (h, w), from fluxes through the faces between nodes (Eq. B1)."""
    ux, uy = u_padded[0, 1:-1], u_padded[1, :, 1:-1]
    padded = lattice.pad(psi, periodic_x=periodic_x, rim=2)
    east = (ux[:, :-1] + ux[:, 1:]) / 2 * face_values(params, padded[2:-2].T).T  # (h, w + 1)
    north = (uy[:-1] + uy[1:]) / 2 * face_values(params, padded[:, 2:-2])  # (h + 1, w)
    return np.asarray(np.diff(east, axis=1) + np.diff(north, axis=0))


def face_values(params: Params, padded: Floats) -> Floats:
    """Values (n + 1, ...) on the faces between rows, from rows (n + 4, ...).

    Second order: the mean of two; fourth order: [7 (psi_0 + psi_1) - psi_-1 - psi_2] / 12.
    """
    outer = 1.0 if params.flux_order == 4 else 0.0
    near, far = padded[1:-2] + padded[2:-1], padded[:-3] + padded[3:]
    return np.asarray(((6 + outer) * near - outer * far) / 12)


def transport(params: Params, psi: Floats, mu: Floats, u: Floats, *, periodic_x: bool) -> Floats:
    """Field psi one step later: explicit Euler of Eq. B1."""
    change = params.mobility * lattice.laplacian(lattice.pad(mu, periodic_x=periodic_x))
    walls = pad_velocity(u, periodic_x=periodic_x)
    return np.asarray(psi + change - advection(params, psi, walls, periodic_x=periodic_x))


def forces(params: Params, state: State) -> tuple[Floats, Floats, list[Floats]]:
    """Force sum_i mu_i grad psi_i, (2, H, W), and the mu of the outer field and of the cores."""
    windows = [nodes(params, origin) for origin in state.origins]
    total, squares = state.outer.copy(), state.outer**2
    for window, core in zip(windows, state.cores, strict=True):
        total[window] += core
        squares[window] += core**2
    outer_padded = lattice.pad(state.outer, periodic_x=True)
    outer_mu = potential(params, outer_padded, total, squares)
    force = outer_mu * lattice.gradient(outer_padded)
    force[0] += params.force_x
    mus = []
    for window, core in zip(windows, state.cores, strict=True):
        padded = lattice.pad(core, periodic_x=params.window == 0)
        mu = potential(params, padded, total[window], squares[window])
        force[(slice(None), *window)] += mu * lattice.gradient(padded)
        mus.append(mu)
    return force, outer_mu, mus


def velocity(state: State, force: Floats) -> Floats:
    """Velocity of the fluid, (sum_i c_i f_i + F / 2) / rho, (2, H, W)."""
    return np.asarray((lattice.momentum(state.f) + force / 2) / lattice.density(state.f))


def step(params: Params, state: State) -> State:
    """One time step."""
    if state.step % RECENTRE_STEPS == 0:
        state = recentre(params, state)
    force, outer_mu, mus = forces(params, state)
    u = velocity(state, force)
    f_eq = lattice.equilibrium(lattice.density(state.f), u)
    post = lattice.relax(state.f, f_eq, params.tau_plus, params.tau_minus)
    post += lattice.guo_force(u, force, params.tau_plus, params.tau_minus)
    walls = wall_velocities(params, state.step)
    f = lattice.stream_in_channel(post, params.rho_0, *walls)
    outer = transport(params, state.outer, outer_mu, u, periodic_x=True)
    cores = np.empty_like(state.cores)
    for i, origin in enumerate(state.origins):
        local = u[(slice(None), *nodes(params, origin))]
        periodic = params.window == 0
        cores[i] = transport(params, state.cores[i], mus[i], local, periodic_x=periodic)
    return State(f=f, outer=outer, cores=cores, origins=state.origins, step=state.step + 1)


def wall_velocities(params: Params, step: int) -> tuple[float, float]:
    """Velocity of the lower and the upper wall at a step: at rest at first."""
    return (0.0, 0.0) if step < params.rest_steps else (params.v_bottom, params.v_top)


def recentre(params: Params, state: State) -> State:
    """Move every window by whole nodes so that its core is in its middle.

    The field is rolled: its mass stays what it was to the last bit.
    """
    if not params.window:
        return state
    cores, origins = state.cores.copy(), state.origins.copy()
    for i, (core, origin) in enumerate(zip(state.cores, state.origins, strict=True)):
        y, x = np.nonzero(core > params.psi_0 / 2)
        if not len(x):
            continue  # dissolved; `problems` reports it
        move = np.round([y.mean() + 0.5, x.mean() + 0.5] - np.array(core.shape) / 2).astype(int)
        move[0] = np.clip(origin[0] + move[0], 0, params.height - params.window) - origin[0]
        cores[i] = np.roll(core, (-move[0], -move[1]), axis=(0, 1))
        origins[i] += move
    return replace(state, cores=cores, origins=origins)


def patches(params: Params, state: State) -> list[tuple[Floats, Floats]]:
    """For every core: psi_i / psi_0, (h, w), and the [y, x] of that array's corner.

    x as in the image; a core on the whole grid is rolled so that x does not wrap within it.
    """
    found = []
    for core, origin in zip(state.cores, state.origins.astype(float), strict=True):
        fraction = core / params.psi_0
        inside = np.nonzero(fraction > 0.5)[1] + origin[1]
        if not len(inside):
            found.append((fraction, origin))
            continue
        around = np.exp(2j * np.pi * (inside + 0.5) / params.width).mean()
        middle = np.angle(around) * params.width / (2 * np.pi) % params.width
        if params.window:  # by whole turns to where it is seen
            turns = np.floor(inside.mean() / params.width)
            found.append((fraction, origin - np.array([0, turns * params.width])))
        else:
            roll = round(middle) - params.width // 2
            found.append((np.roll(fraction, -roll, axis=1), origin + np.array([0, roll])))
    return found


def shade(params: Params, state: State) -> Floats:
    """Brightness of the image, (H, W) in 0..1: white cores in a black shell on white."""
    total = state.outer.copy()
    for core, origin in zip(state.cores, state.origins, strict=True):
        total[nodes(params, origin)] += core
    return np.asarray(np.clip(total / params.psi_0, 0, 1))


def masses(state: State) -> Floats:
    """Mass of the fluid, of the outer field and of every core's, (2 + M,)."""
    return np.array([state.f.sum(), state.outer.sum(), *state.cores.sum(axis=(1, 2))])
