"""A running colour-gradient simulation on a GPU: the same interface and states as the CPU's."""

from numba import cuda

from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.cuda import add_up, collide, transport
from data_gen.lattice_boltzmann.color_gradient.geometry import Params, solid_nodes, wall_push
from data_gen.lattice_boltzmann.color_gradient.solver import constants
from data_gen.lattice_boltzmann.cuda_device import blocks_of, device_name, pinned


class Solver:
    """A running simulation: holds the fields on the GPU, where they stay until asked for.

    Only the droplets come to the host by themselves, each time that their windows move.
    """

    def __init__(self, params: Params, state: cg.State) -> None:
        self.params, self.device = params, device_name()
        self._constants = constants(params)
        self._step, self._origins = state.step, state.origins
        self._state: cg.State | None = state
        n, h, w = state.labels.shape
        shape = (params.height, params.width)
        self._f, self._e = cuda.to_device(state.f), cuda.to_device(state.emulsion)
        self._labels = cuda.to_device(state.labels)
        self._windows = cuda.to_device(state.origins)
        self._solid = cuda.to_device(solid_nodes(params))
        self._push = cuda.to_device(wall_push(params))
        self._post, self._q_e = cuda.device_array((9, *shape)), cuda.device_array((2, *shape))
        self._e_new, self._total = cuda.device_array(shape), cuda.device_array(shape)
        self._labels_new, self._q = cuda.device_array((n, h, w)), cuda.device_array((n, 2, h, w))
        self._host_f, self._host_labels = pinned((9, *shape)), pinned((n, h, w))
        self._launch = blocks_of(shape)

    @property
    def state(self) -> cg.State:
        """The state now; the next run overwrites its f."""
        if self._state is None:
            self._f.copy_to_host(self._host_f)
            self._state = cg.State(
                f=self._host_f,
                emulsion=self._e.copy_to_host(),
                labels=self._labels.copy_to_host(),
                origins=self._origins,
                step=self._step,
            )
        return self._state

    def run(self, steps: int) -> None:
        """Advance by a number of steps."""
        for _ in range(steps):
            if self._step % cg.RECENTRE_STEPS == 0:
                self._recentre()
            self._advance()
            self._step += 1
            self._state = None

    def _advance(self) -> None:
        """One step: the launches queue on the GPU, nothing waits for them here."""
        p, launch = self.params, self._launch
        add_up[launch](self._labels, self._windows, self._total)
        collide[launch](
            self._f, self._post, self._e, self._q_e, self._total, self._labels, self._q,
            self._windows, self._solid, self._push, self._constants,
        )  # fmt: skip
        transport[launch](
            self._f, self._post, self._e, self._e_new, self._q_e, self._labels, self._labels_new,
            self._q, self._windows, self._solid, 6 * p.rho_0 * p.inlet_velocity(self._step),
            p.rho_0,
        )  # fmt: skip
        self._e, self._e_new = self._e_new, self._e
        self._labels, self._labels_new = self._labels_new, self._labels

    def _recentre(self) -> None:
        self._labels.copy_to_host(self._host_labels)
        labels, origins = cg.centred(self.params, self._host_labels, self._origins)
        if (origins != self._origins).any():
            self._labels.copy_to_device(labels)
            self._windows.copy_to_device(origins)
            self._origins = origins
