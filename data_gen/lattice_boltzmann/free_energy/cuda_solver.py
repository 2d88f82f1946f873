"""A running free-energy simulation on a GPU: the same interface and states as the CPU's."""

from numba import cuda

from data_gen.lattice_boltzmann.cuda_device import blocks_of, device_name
from data_gen.lattice_boltzmann.free_energy import reference as fe
from data_gen.lattice_boltzmann.free_energy.cuda import collide, transport
from data_gen.lattice_boltzmann.free_energy.solver import constants


class Solver:
    """A running simulation: holds the fields on the GPU, where they stay until asked for.

    Every time that windows move, the state is asked for.
    """

    def __init__(self, params: fe.Params, state: fe.State) -> None:
        self.params, self.device = params, device_name()
        self._constants = constants(params)
        self._step, self._origins = state.step, state.origins
        self._state: fe.State | None = state
        shape = (params.height, params.width)
        self._f, self._outer = cuda.to_device(state.f), cuda.to_device(state.outer)
        self._post, self._u = cuda.device_array((9, *shape)), cuda.device_array((2, *shape))
        self._outer_new, self._outer_mu = cuda.device_array(shape), cuda.device_array(shape)
        self._place_cores(state)
        self._launch = blocks_of(shape)

    def _place_cores(self, state: fe.State) -> None:
        self._cores = cuda.to_device(state.cores)
        self._cores_new = cuda.device_array(state.cores.shape)
        self._cores_mu = cuda.device_array(state.cores.shape)
        self._origins = state.origins
        self._windows = cuda.to_device(state.origins % [self.params.height, self.params.width])

    @property
    def state(self) -> fe.State:
        """The state now."""
        if self._state is None:
            self._state = fe.State(
                f=self._f.copy_to_host(),
                outer=self._outer.copy_to_host(),
                cores=self._cores.copy_to_host(),
                origins=self._origins,
                step=self._step,
            )
        return self._state

    def run(self, steps: int) -> None:
        """Advance by a number of steps."""
        for _ in range(steps):
            if self._step % fe.RECENTRE_STEPS == 0 and self.params.window:
                self._place_cores(fe.recentre(self.params, self.state))
            self._advance()
            self._step += 1
            self._state = None

    def _advance(self) -> None:
        """One step: the launches queue on the GPU, nothing waits for them here."""
        p, launch, periodic = self.params, self._launch, self.params.window == 0
        collide[launch](
            self._f, self._post, self._u, self._outer, self._outer_mu, self._cores,
            self._cores_mu, self._windows, periodic, self._constants,
        )  # fmt: skip
        bottom, top = (6 * p.rho_0 * v for v in fe.wall_velocities(p, self._step))
        transport[launch](
            self._f, self._post, self._u, self._outer, self._outer_new, self._outer_mu,
            self._cores, self._cores_new, self._cores_mu, self._windows, periodic, bottom, top,
            self._constants,
        )  # fmt: skip
        self._outer, self._outer_new = self._outer_new, self._outer
        self._cores, self._cores_new = self._cores_new, self._cores
