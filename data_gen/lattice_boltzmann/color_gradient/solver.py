"""A running colour-gradient simulation: its state in the layout of the compiled kernels."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.compiled_collision import Constants, collide
from data_gen.lattice_boltzmann.color_gradient.compiled_transport import Links, transport
from data_gen.lattice_boltzmann.color_gradient.geometry import Params, solid_nodes, wall_push
from data_gen.lattice_boltzmann.cpu_threads import count_threads
from data_gen.lattice_boltzmann.lattice import CX, CY, OPPOSITE
from droptrack.data.arrays import Bools, Floats


def wall_links(solid: Bools) -> Links:
    """Links of a closed box with solid nodes."""
    blocked = np.pad(solid, 1, constant_values=True)
    hits = [~solid & lattice.shifted(blocked, -CX[i], -CY[i]) for i in range(9)]
    i, y, x = np.nonzero(np.array(hits))
    order = np.lexsort((i, x, y))
    start = np.searchsorted(y[order], np.arange(len(solid) + 1))
    return Links(start, x[order], OPPOSITE[i[order]].astype(np.int64), i[order])


def spans_of(labels: Floats) -> NDArray[np.int64]:
    """First and last + 1 column of what is not 0, (N, h + 2, 2), of labels (N, h + 2, w + 2).

    Columns without the rim; w, 0 where a row is empty.
    """
    there = labels[:, :, 1:-1] != 0
    w = there.shape[2]
    some = there.any(axis=2)
    first = np.where(some, there.argmax(axis=2), w)
    last = np.where(some, w - there[:, :, ::-1].argmax(axis=2), 0)
    return np.ascontiguousarray(np.stack([first, last], axis=-1).astype(np.int64))


def constants(params: Params) -> Constants:
    """The constants of a parameter set."""
    return Constants(
        beta=float(params.beta),
        omega=1 / params.tau,
        perturbation=4.5 * params.sigma / params.tau,
        contact=params.near_contact * params.sigma,
        distance=float(params.contact_distance),
        wall_force=float(params.wall_force),
        no_gradient=cg.NO_GRADIENT,
        contact_gradient=cg.CONTACT_GRADIENT,
    )


class Solver:
    """A running simulation: holds the fields in the kernels' layout."""

    device = "the CPU"

    def __init__(self, params: Params, state: cg.State) -> None:
        self.params = params
        self._state = replace(state, f=state.f.copy())
        self._constants = constants(params)
        solid = solid_nodes(params)
        self._links = wall_links(solid)
        self._fluid = np.where(solid, 0.0, 1.0)
        self._push = wall_push(params).copy()  # writable, as the kernels take arrays
        shape = (params.height + 2, params.width + 2)
        self._post, self._q_e = np.zeros((9, *shape)), np.zeros((2, *shape))

    @property
    def state(self) -> cg.State:
        """The state now; the next run overwrites its f."""
        return self._state

    def run(self, steps: int) -> None:
        """Advance by a number of steps."""
        end = self._state.step + steps
        while self._state.step < end:
            step = self._state.step
            if step % cg.RECENTRE_STEPS == 0:
                self._state = cg.recentre(self.params, self._state)
            until = min(step - step % cg.RECENTRE_STEPS + cg.RECENTRE_STEPS, end)
            self._advance(until - step)

    def _advance(self, steps: int) -> None:
        """Steps without a move of the windows."""
        s, rho_0, blocks = self._state, float(self.params.rho_0), 8 * count_threads()
        total = cg.label_sum(s)
        e, labels = np.pad(s.emulsion, 1), np.pad(s.labels, ((0, 0), (1, 1), (1, 1)))
        spans, e_spans = spans_of(labels), self._e_spans()
        q = np.zeros((2, *labels.shape))
        e_new, labels_new = e.copy(), labels.copy()
        spans_new, e_spans_new = spans.copy(), e_spans.copy()
        for step in range(s.step, s.step + steps):
            collide(
                s.f, self._post, e, self._q_e, total, labels, q, spans, e_spans, s.origins,
                self._fluid, self._push, self._constants, blocks,
            )  # fmt: skip
            transport(
                s.f, self._post, e, e_new, self._q_e, total, labels, labels_new, q, spans,
                spans_new, e_spans, e_spans_new, s.origins, self._fluid, self._links,
                6 * rho_0 * self.params.inlet_velocity(step), rho_0, cg.NOTHING, blocks,
            )  # fmt: skip
            e, e_new = e_new, e
            labels, labels_new = labels_new, labels
            spans, spans_new = spans_new, spans
            e_spans, e_spans_new = e_spans_new, e_spans
        inner = (slice(1, -1), slice(1, -1))
        self._state = cg.State(
            f=s.f,
            emulsion=e[inner].copy(),
            labels=labels[(slice(None), *inner)].copy(),
            origins=s.origins,
            step=s.step + steps,
        )

    def _e_spans(self) -> NDArray[np.int64]:
        """Spans of where the emulsion or any droplet is, (H + 2, 2)."""
        there = (self._state.emulsion != 0) | (cg.label_sum(self._state) != 0)
        return np.asarray(spans_of(np.pad(there, 1)[None].astype(float))[0])
