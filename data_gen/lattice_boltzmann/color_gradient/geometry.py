"""Channel and starting droplets of the constriction: parameters, walls, equal cells in a disc."""

import functools
import math
from dataclasses import dataclass, fields

import numpy as np
from scipy import ndimage

from data_gen.lattice_boltzmann import lattice
from droptrack.data.arrays import Bools, Floats
from droptrack.errors import DroptrackError

WALL_RANGE = 3.6  # of the push of walls


@dataclass(frozen=True, kw_only=True)
class Params:
    """The parameters in lattice units. Raises DroptrackError for impossible ones."""

    height: int = 205  # h
    throat_height: int = 41  # h_s
    throat_length: int = 82  # l_s
    inlet_length: int = 124
    outlet_length: int = 186
    droplets: int = 19  # N_d; 0 for the flow alone
    radius: float = 10.0  # of a circle of a droplet's area
    phi: float = 0.9  # the droplets' share of the emulsion
    sigma: float = 0.05
    tau: float = 1.0
    rho_0: float = 1.0
    u_in: float = 4e-3  # U_in
    beta: float = 0.7  # recolouring
    near_contact: float = 0.1  # A_h / sigma
    contact_distance: float = 2.5  # h_0
    wall_force: float = 0.01  # A_w; without it droplets pin to walls and tear
    rest_steps: int = 900  # before the inlet opens
    ramp_steps: int = 2000  # while it opens
    window: int = 64  # side of a droplet's window
    seed: int = 0  # of the droplets' places

    def __post_init__(self) -> None:
        for field in fields(self):
            if not math.isfinite(getattr(self, field.name)):
                raise DroptrackError(f"{field.name}: should be a finite number")
        for name in ("radius", "sigma", "rho_0", "beta", "throat_height", "inlet_length"):
            if getattr(self, name) <= 0:
                raise DroptrackError(f"{name} {getattr(self, name):g}: should be above 0")
        for name in ("droplets", "throat_length", "near_contact", "wall_force", "rest_steps"):
            if getattr(self, name) < 0:
                raise DroptrackError(f"{name} {getattr(self, name):g}: should not be negative")
        lattice.check_viscosity(self.tau)
        if not 0 <= self.u_in <= 0.1:
            raise DroptrackError(f"u_in {self.u_in:g}: should be within 0..0.1 (low Mach number)")
        if self.u_in * self.height / self.throat_height > 0.15:
            raise DroptrackError(
                f"u_in {self.u_in:g}: the flow in the throat would reach "
                f"{self.u_in * self.height / self.throat_height:.2g}; should stay below 0.15"
            )
        if self.sigma > 0.2:
            raise DroptrackError(f"sigma {self.sigma:g}: unstable above 0.2")
        if not 0.3 <= self.beta <= 1:
            raise DroptrackError(f"beta {self.beta:g}: should be within 0.3..1")
        if not 0.5 <= self.phi < 1:
            raise DroptrackError(f"phi {self.phi:g}: should be within 0.5..1")
        if not 0 < self.contact_distance <= 3:
            raise DroptrackError("contact_distance: should be within 0..3 nodes")
        if self.throat_height > self.height or (self.height - self.throat_height) % 2:
            raise DroptrackError(
                f"throat_height {self.throat_height} in a channel of {self.height}: should be less "
                "by an even number of nodes"
            )
        if self.throat_height < 12:
            raise DroptrackError(
                f"throat_height {self.throat_height}: narrower than its interfaces; 12 or more"
            )
        self._check_room()

    def _check_room(self) -> None:
        if not self.droplets:
            return
        if self.radius < 5:
            raise DroptrackError(
                f"radius {self.radius:g}: should be 5 or more, as interfaces are 3"
            )
        room = min(self.height, self.inlet_length) - 8
        if self.emulsion_diameter > room:
            raise DroptrackError(
                f"{self.droplets} droplets of radius {self.radius:g} at phi {self.phi:g} are an "
                f"emulsion {self.emulsion_diameter:.0f} across, which does not fit the inlet's "
                f"{room}; take fewer, smaller ones or a larger channel"
            )
        if self.window < 5 * self.radius:
            raise DroptrackError(
                f"window {self.window}: should be {math.ceil(5 * self.radius)} or more for "
                f"droplets of radius {self.radius:g}, which stretch"
            )

    @property
    def width(self) -> int:
        """Length of the whole channel."""
        return self.inlet_length + self.throat_length + self.outlet_length

    @property
    def emulsion_diameter(self) -> float:
        """D, from the droplets' area and their share of the emulsion."""
        return 2 * self.radius * math.sqrt(self.droplets / self.phi)

    @property
    def steepness(self) -> float:
        """Of the profile (1 + tanh(s d)) / 2 where recolouring balances diffusion, tau = 1."""
        return 0.9024 * self.beta

    def inlet_velocity(self, step: int) -> float:
        """Velocity at the inlet at a step."""
        opened = (step - self.rest_steps) / max(self.ramp_steps, 1)
        return self.u_in * min(max(opened, 0.0), 1.0)


@functools.lru_cache(maxsize=4)
def solid_nodes(params: Params) -> Bools:
    """The channel's solid nodes, (H, W), read-only: above and below the throat."""
    solid = np.zeros((params.height, params.width), bool)
    wall = (params.height - params.throat_height) // 2
    throat = slice(params.inlet_length, params.inlet_length + params.throat_length)
    solid[:wall, throat] = True
    solid[params.height - wall :, throat] = True
    solid.flags.writeable = False
    return solid


@functools.lru_cache(maxsize=4)
def wall_push(params: Params) -> Floats:
    """Unit vectors away from walls times 2^-(d - 1), (2, H, W), for distances d < WALL_RANGE.

    Read-only; d is the distance to the centre of the nearest solid node, 1 beside a wall.
    """
    solid = np.pad(solid_nodes(params), ((1, 1), (0, 0)), constant_values=True)
    d, nearest = ndimage.distance_transform_edt(~solid, return_indices=True)
    y, x = np.mgrid[: d.shape[0], : d.shape[1]]
    away = np.stack([x - nearest[1], y - nearest[0]]) / np.maximum(d, 1)
    push = away * 2.0 ** (1 - d) * ((d < WALL_RANGE) & (d > 0))
    push = np.ascontiguousarray(push[:, 1:-1])
    push.flags.writeable = False
    return push


def power_cells(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Sites (N, 2) and weights (N,) of n cells of equal area in the unit disc.

    Centroidal power diagram, by turns of Lloyd's step and of weights that correct the areas.
    """
    t = (np.arange(160) + 0.5) / 80 - 1
    points = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    points = points[(points**2).sum(axis=1) < 1]
    angle, r = rng.uniform(0, 2 * np.pi, n), 0.95 * np.sqrt(rng.uniform(0, 1, n))
    sites = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
    weights = np.zeros(n)
    wanted = len(points) / n
    for turn in range(400):
        power = (sites**2).sum(axis=1) - weights - 2 * points @ sites.T  # less |point|^2
        owner = power.argmin(axis=1)
        area = np.bincount(owner, minlength=n)
        weights += 0.3 * (1 - area / wanted) / n
        weights -= weights.mean()
        if turn < 300:  # then only the areas
            for axis in range(2):
                sums = np.bincount(owner, points[:, axis], minlength=n)
                sites[:, axis] = np.where(area > 0, sums / np.maximum(area, 1), sites[:, axis])
    return sites, weights


def droplet_fractions(params: Params, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Fractions of the droplets (N, H, W) and of the emulsion (H, W) at the start.

    The droplets are the cells, each shrunk by the half film that leaves them the share phi.
    """
    shape = (params.height, params.width)
    labels, emulsion = np.zeros((params.droplets, *shape)), np.zeros(shape)
    if not params.droplets:
        return labels, emulsion
    y, x = np.mgrid[: params.height, : params.inlet_length] + 0.5
    x, y = x - params.inlet_length / 2, y - params.height / 2
    radius = params.emulsion_diameter / 2
    to_rim = radius - np.hypot(x, y)
    s = params.steepness
    emulsion[:, : params.inlet_length] = (1 + np.tanh(s * to_rim)) / 2
    near = to_rim > -30  # beyond, a profile is 0 to rounding
    x, y, to_rim = x[near], y[near], to_rim[near]  # (P,)
    sites, weights = power_cells(params.droplets, rng)
    sites, weights = sites * radius, weights * radius**2
    power = (x - sites[:, :1]) ** 2 + (y - sites[:, 1:]) ** 2 - weights[:, None]  # (N, P)
    depth = np.repeat(to_rim[None], params.droplets, axis=0)  # to the nearest edge of the cell
    for k in range(params.droplets):
        for j in range(params.droplets):
            if j != k:
                apart = np.hypot(*(sites[j] - sites[k]))
                np.minimum(depth[k], (power[j] - power[k]) / (2 * apart), out=depth[k])
    low, high = -3.0, radius
    wanted = params.droplets * math.pi * params.radius**2
    for _ in range(40):
        shrink = (low + high) / 2
        total = ((1 + np.tanh(s * (depth - shrink))) / 2).sum()
        low, high = (shrink, high) if total > wanted else (low, shrink)
    inlet = labels[:, :, : params.inlet_length]
    inlet[:, near] = (1 + np.tanh(s * (depth - shrink))) / 2
    return labels, emulsion
