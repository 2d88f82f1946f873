"""Cores in a shell between walls that move against each other (appendix B)."""

from collections.abc import Iterable

import numpy as np
from scipy import ndimage

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.free_energy import reference as fe
from data_gen.lattice_boltzmann.settings import Device, changed
from data_gen.lattice_boltzmann.simulation import Simulation
from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

CORE_DISTANCE = {1: 0.0, 2: 18.0, 3: 21.0, 4: 24.0}  # of the centres from the middle
STEPS = {"small": 80_000, "paper": 150_000}  # about half a turn and a whole one

# beyond these a run counts as unstable
MAX_DENSITY_CHANGE = 0.2
MAX_VELOCITY = 0.3
MAX_FIELD = 2.0  # times psi_0


def shear_parameters(cores: int, settings: Iterable[str] = ()) -> fe.Params:
    """The paper's parameters with 1 to 4 cores, and with `name=value` settings applied.

    Raises DroptrackError for impossible ones.
    """
    params = changed(fe.Params(cores=cores, core_distance=CORE_DISTANCE[cores]), settings)
    if params.cores < 1:
        raise DroptrackError("cores 0: a video needs one or more")
    return params


class Shear(Simulation[fe.Params, fe.State]):
    """A multi-core emulsion in shear."""

    name = "shear"
    model = "free_energy"

    def __init__(self, params: fe.Params, state: fe.State, device: Device = "cpu") -> None:
        super().__init__(params, state, device)
        self._start = fe.masses(fe.initial_state(params))

    @classmethod
    def initial_state(cls, params: fe.Params) -> fe.State:
        """Round cores in a round shell, at rest."""
        return fe.initial_state(params)

    def patches(self) -> list[tuple[Floats, Floats]]:
        """The cores."""
        return fe.patches(self.params, self.state)

    def shade(self) -> Floats:
        """White cores in a black shell on white."""
        return fe.shade(self.params, self.state)

    def unstable(self) -> str | None:
        """Values that are not finite, or fast, or far from where the model holds."""
        state = self.state
        rho = lattice.density(state.f)
        if not (np.isfinite(rho).all() and np.isfinite(state.outer).all()):
            return "values that are not finite"
        if abs(rho / self.params.rho_0 - 1).max() > MAX_DENSITY_CHANGE:
            return f"density from {rho.min():.3g} to {rho.max():.3g}"
        speed = np.hypot(*lattice.momentum(state.f)).max() / self.params.rho_0
        if speed > MAX_VELOCITY:
            return f"velocity {speed:.3g}"
        highest = max((core.max() for core in state.cores), default=0.0)
        if not highest < MAX_FIELD * self.params.psi_0:
            return f"a field of {highest:.3g}, psi_0 is {self.params.psi_0:g}"
        return None

    def checks(self) -> dict[str, float]:
        """Maximum drift of a mass, density, velocity, and the pieces of the worst core."""
        state = self.state
        rho = lattice.density(state.f)
        u = fe.velocity(state, fe.forces(self.params, state)[0])
        pieces = [ndimage.label(p > 0.5)[1] for p, _ in self.patches()]
        drift = np.abs(fe.masses(state) / self._start - 1)
        return {
            "mass_drift": float(drift.max()),
            "density_min": float(rho.min()),
            "density_max": float(rho.max()),
            "velocity_max": float(np.hypot(*u).max()),
            "pieces": float(max(pieces, default=0)),
            "droplets": float(sum(n > 0 for n in pieces)),
        }
