"""A dense emulsion pushed through a constriction (appendix A)."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from scipy import ndimage

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.geometry import Params, solid_nodes
from data_gen.lattice_boltzmann.settings import Device, changed
from data_gen.lattice_boltzmann.simulation import Simulation
from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

SMALL = Params()
PAPER = Params(
    height=600, throat_height=120, throat_length=240, inlet_length=370, outlet_length=590,
    droplets=49, radius=18.1, u_in=2e-3, window=116,
)  # fmt: skip
SIZES = {"small": SMALL, "paper": PAPER}
STEPS = {"small": 40_000, "paper": 250_000}  # at most
EVERY = {"small": 100, "paper": 400}  # steps per frame

# beyond these a run counts as unstable
DENSITY_RANGE = (0.5, 1.5)
MAX_VELOCITY = 0.4


def constriction_parameters(
    size: Literal["small", "paper"],
    droplets: int | None = None,
    seed: int = 0,
    settings: Iterable[str] = (),
) -> Params:
    """The parameters of a size, with its droplets or another number of them.

    `settings` are `name=value`. Raises DroptrackError for impossible ones.
    """
    params = replace(SIZES[size], seed=seed)
    if droplets is not None:
        params = replace(params, droplets=droplets)
    params = changed(params, settings)
    if params.droplets < 1:
        raise DroptrackError("droplets 0: a video needs one or more")
    return params


class Constriction(Simulation[Params, cg.State]):
    """Droplets that squeeze through a constriction."""

    name = "constriction"
    model = "color_gradient"

    def __init__(self, params: Params, state: cg.State, device: Device = "cpu") -> None:
        super().__init__(params, state, device)
        self._fluid = ~solid_nodes(params)
        self._start = cg.masses(state)

    @classmethod
    def initial_state(cls, params: Params) -> cg.State:
        """The droplets of the seed in the inlet chamber, at rest."""
        return cg.initial_state(params)

    def patches(self) -> list[tuple[Floats, Floats]]:
        """The droplets."""
        return cg.patches(self.state)

    def shade(self) -> Floats:
        """White droplets on black."""
        return cg.shade(self.state)

    def unstable(self) -> str | None:
        """Values that are not finite, densities or velocities out of range."""
        f = self.state.f
        rho = lattice.density(f)[self._fluid]
        if not np.isfinite(rho).all():
            return "values that are not finite"
        if rho.min() < DENSITY_RANGE[0] or rho.max() > DENSITY_RANGE[1]:
            return f"density from {rho.min():.3g} to {rho.max():.3g}"
        speed = np.hypot(*lattice.momentum(f)).max()
        return f"velocity {speed:.3g}" if speed > MAX_VELOCITY else None

    def checks(self) -> dict[str, float]:
        """Maximum drift of a mass, density, velocity, sum of fractions, pieces, droplets out."""
        state = self.state
        rho = lattice.density(state.f)[self._fluid]
        pieces = [ndimage.label(c > 0.5)[1] for c, _ in self.patches()]
        return {
            "mass_drift": float(np.abs(cg.masses(state) / self._start - 1).max(initial=0)),
            "density_min": float(rho.min()),
            "density_max": float(rho.max()),
            "velocity_max": float(np.hypot(*lattice.momentum(state.f)).max()),
            "label_sum_max": float(cg.label_sum(state).max()),
            "pieces": float(max(pieces, default=0)),
            "droplets": float(sum(n > 0 for n in pieces)),
            "through": float(self._through()),
        }

    def _through(self) -> int:
        """Droplets that are wholly in the outlet chamber."""
        end = self.params.inlet_length + self.params.throat_length
        inside = [((c > 0.5).any(axis=0), corner[1]) for c, corner in self.patches()]
        return sum(bool(x.any() and x.argmax() + x_0 >= end) for x, x_0 in inside)

    def finished(self) -> bool:
        """Whether every droplet is through."""
        return self._through() == self.params.droplets

    def outcome(self) -> str:
        """How many droplets are through."""
        return f"{self._through()} of {self.params.droplets} droplets through"

    def arrays(self) -> dict[str, Any]:
        """The state and the masses of the start, for a checkpoint."""
        return super().arrays() | {"start": self._start}

    def load(self, arrays: Mapping[str, Any]) -> None:
        """Resume from a checkpoint's state."""
        values = dict(arrays)
        self._start = values.pop("start")
        super().load(values)
