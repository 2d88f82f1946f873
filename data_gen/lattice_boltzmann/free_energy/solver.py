"""A running free-energy simulation: its state in the layout of the compiled kernels."""

import numpy as np

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.cpu_threads import count_threads
from data_gen.lattice_boltzmann.free_energy import reference as fe
from data_gen.lattice_boltzmann.free_energy.compiled import RIM, Constants, advance
from droptrack.data.arrays import Floats


def constants(params: fe.Params) -> Constants:
    """The constants of a parameter set."""
    return Constants(
        a=float(params.a),
        k=float(params.k),
        mobility=float(params.mobility),
        epsilon=float(params.epsilon),
        epsilon_quadratic=float(params.epsilon_quadratic),
        psi_0=float(params.psi_0),
        force_x=float(params.force_x),
        omega_plus=1 / params.tau_plus,
        omega_minus=1 / params.tau_minus,
        outer=1.0 if params.flux_order == 4 else 0.0,
    )


class Solver:
    """A running simulation: holds the fields in the kernels' layout."""

    device = "the CPU"

    def __init__(self, params: fe.Params, state: fe.State) -> None:
        self.params = params
        self._constants = constants(params)
        self._state = state

    @property
    def state(self) -> fe.State:
        """The state now."""
        return self._state

    def run(self, steps: int) -> None:
        """Advance by a number of steps."""
        end = self._state.step + steps
        while self._state.step < end:
            if self._state.step % fe.RECENTRE_STEPS == 0:
                self._state = fe.recentre(self.params, self._state)
            until = self._state.step - self._state.step % fe.RECENTRE_STEPS + fe.RECENTRE_STEPS
            if self._state.step < self.params.rest_steps:
                until = min(until, self.params.rest_steps)
            self._state = self._advance(min(until, end) - self._state.step)

    def _advance(self, steps: int) -> fe.State:
        """Steps without a move of the windows or a change of the walls."""
        s, p = self._state, self.params
        periodic = p.window == 0
        f = s.f.copy()
        outer = _with_rim(s.outer[None], periodic_x=True)[0]
        cores = _with_rim(s.cores, periodic_x=periodic)
        outer_mu = np.empty((p.height + 2, p.width + 2))  # a rim of one
        cores_mu = np.empty((p.cores, cores.shape[1] - 2, cores.shape[2] - 2))
        columns = s.origins.copy()
        columns[:, 1] %= p.width
        wall = 6 / 36 * p.rho_0 * np.array(fe.wall_velocities(p, s.step))
        u = np.empty((2, p.height, p.width))
        outer, cores = advance(
            steps, f, np.empty_like(f), np.empty_like(f), outer, outer.copy(), outer_mu,
            cores, cores.copy(), cores_mu, columns, periodic, wall, u, self._constants,
            4 * count_threads(),
        )  # fmt: skip
        inner = (slice(RIM, -RIM), slice(RIM, -RIM))
        return fe.State(
            f=f,
            outer=outer[inner].copy(),
            cores=cores[(slice(None), *inner)].copy(),
            origins=s.origins,
            step=s.step + steps,
        )


def _with_rim(fields: Floats, *, periodic_x: bool) -> Floats:
    return np.ascontiguousarray(lattice.pad(fields, periodic_x=periodic_x, rim=RIM))
