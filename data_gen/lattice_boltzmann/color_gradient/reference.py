"""Dense emulsion through a constriction: the colour-gradient model of the paper's appendix A.

Lattice units, fields indexed [y, x] with y up. This file is the reference in plain NumPy, one
function per term; compiled_*.py compile the same terms.

The paper's two sets of populations cannot keep 49 droplets apart and countable. Here one set f
carries the whole fluid, and mass fractions say what it is made of: c_k for each droplet, E for the
emulsion, that is the droplets and the film B = E - sum_k c_k between them; 1 - E is the outer
fluid C. A droplet cannot merge with another by construction: that there is no coalescence is built
in, not a result. Interfaces A-B and B-C carry sigma, A-A and A-C twice that, so B wets everything.

Sources: Latva-Kokko and Rothman, PRE 71, 056702 (2005) for the recolouring; Montessori et al.,
J. Fluid Mech. 872, 327 (2019) for the near-contact force; Leclaire et al. (2012) for B_i.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.color_gradient.geometry import (
    Params,
    droplet_fractions,
    solid_nodes,
    wall_push,
)
from data_gen.lattice_boltzmann.lattice import CX, CY, OPPOSITE, W
from droptrack.data.arrays import Bools, Floats

RECENTRE_STEPS = 16  # between moves of the windows
B = np.array([-4 / 27] + 4 * [2 / 27] + 4 * [5 / 108])
LENGTH = np.array([1.0] + 4 * [1.0] + 4 * [np.sqrt(2)])  # |c_i|, c_0 aside
NO_GRADIENT = 1e-13  # below, a gradient has no direction
NOTHING = 1e-11  # fractions below are set to 0, so that droplets end
CONTACT_GRADIENT = 0.005  # above, a node belongs to an interface


@dataclass(frozen=True, kw_only=True)
class State:
    """What a step changes. Only the names are frozen: a solver's next run overwrites f in place.

    f (9, H, W) populations, 0 in solid nodes; emulsion (H, W) the fraction E; labels (N, h, w) the
    fractions c_k in windows; origins (N, 2) int64, the [y, x] of their lower left nodes; step.
    """

    f: Floats
    emulsion: Floats
    labels: Floats
    origins: NDArray[np.int64]
    step: int


def nodes(state: State, k: int) -> tuple[Any, ...]:
    """Index of the grid's nodes under the window of droplet k."""
    y, x = state.origins[k]
    h, w = state.labels.shape[1:]
    return (slice(y, y + h), slice(x, x + w))


def label_sum(state: State) -> Floats:
    """Sum of all droplets' fractions, (H, W)."""
    total = np.zeros_like(state.emulsion)
    for k, label in enumerate(state.labels):
        total[nodes(state, k)] += label
    return total


def gradient(c: Floats) -> Floats:
    """Gradient of a fraction that is 0 outside its array and in solids, (2, h, w)."""
    return lattice.gradient(np.pad(c, 1))


def direction(grad: Floats) -> Floats:
    """Unit vector along a gradient, 0 where there is none."""
    return np.asarray(grad / np.maximum(np.hypot(*grad), NO_GRADIENT))


def tension(grad: Floats) -> Floats:
    """grad c grad c / |grad c|, (2, 2, h, w): what an interface adds to G of Eq. A3."""  # noqa: D403
    return lattice.outer(grad, direction(grad))


def recolouring(params: Params, c: Floats, grad: Floats) -> Floats:
    """Flux beta c (1 - c) n that keeps an interface sharp (Omega^(3) of Eq. A2), (2, h, w)."""
    return np.asarray(params.beta * c * (1 - c) * direction(grad))


def constraint(sharpening: list[Floats], of_emulsion: Floats, of_film: Floats) -> Floats:
    """Q = sum_k a_k + a_B - a_E (given on the whole grid): what the fluxes would add up to.

    With q_k = a_k - c_k Q, q_B = a_B - B Q and q_E = a_E + (1 - E) Q the fluxes of droplets, film
    and outer fluid sum to 0, and so the fractions stay at 1 together; without, labels overlap.
    """
    return np.asarray(sum(sharpening) + of_film - of_emulsion)


def near_contact_force(
    params: Params, c: Floats, grad: Floats, origin: NDArray[np.int64], total: Floats, e: Floats
) -> Floats:
    """F_rep: A_h O grad c, O the fraction of others a distance h_0 outward, (2, h, w)."""
    force = np.zeros_like(grad)
    y, x = np.nonzero((grad**2).sum(axis=0) > CONTACT_GRADIENT**2)
    g = grad[:, y, x]
    outward = -g / np.hypot(*g)
    x_out = x + params.contact_distance * outward[0]
    y_out = y + params.contact_distance * outward[1]
    own = sampled(c, y_out, x_out)
    others = sampled(total, y_out + origin[0], x_out + origin[1]) - own
    others += 1 - sampled(e, y_out + origin[0], x_out + origin[1])
    force[:, y, x] = params.near_contact * params.sigma * others * g
    return force


def sampled(field: Floats, y: Floats, x: Floats) -> Floats:
    """Bilinear values of a field between its nodes, 0 outside."""
    padded = np.pad(field, 4)
    y_0, x_0 = np.floor(y).astype(int), np.floor(x).astype(int)
    t, s = y - y_0, x - x_0
    low = (1 - s) * padded[y_0 + 4, x_0 + 4] + s * padded[y_0 + 4, x_0 + 5]
    high = (1 - s) * padded[y_0 + 5, x_0 + 4] + s * padded[y_0 + 5, x_0 + 5]
    return np.asarray((1 - t) * low + t * high)


def velocity(f: Floats, force: Floats, solid: Bools) -> tuple[Floats, Floats]:
    """Density and velocity (sum_i c_i f_i + F / 2) / rho; 0 and near 0 in solid nodes."""
    rho = lattice.density(f)
    return rho, (lattice.momentum(f) + force / 2) / (rho + solid)


def collide(params: Params, f: Floats, force: Floats, g: Floats, solid: Bools) -> Floats:
    """Regularised collision with Guo's force and the perturbation of Eq. A3, (9, H, W).

    f_i = w_i [rho + 3 c.(rho u + F/2) + 9/2 (c c - I/3):S] + 2 A [w_i c c:G - B_i tr G] with
    S = rho u u + (1 - omega) Pi_neq + (1 - omega/2) (u F + F u) and A = 9 sigma / (4 tau).
    """
    omega = 1 / params.tau
    rho, u = velocity(f, force, solid)
    unit = np.eye(2)[:, :, None, None]
    inertia = rho * lattice.outer(u, u)
    non_equilibrium = lattice.momentum_flux(f) - rho / 3 * unit - inertia
    work = lattice.outer(u, force) + lattice.outer(force, u)
    stress = inertia + (1 - omega) * non_equilibrium + (1 - omega / 2) * work
    cc = np.einsum("id,ie->ide", lattice.C, lattice.C)
    hermite = np.einsum("ide,deyx->iyx", cc, stress) - np.einsum("ddyx->yx", stress) / 3
    w, b = W[:, None, None], B[:, None, None]
    post = w * (rho + 3 * lattice.along(rho * u + force / 2) + 4.5 * hermite)
    a = 9 * params.sigma / (4 * params.tau)
    post += 2 * a * (w * np.einsum("ide,deyx->iyx", cc, g) - b * np.einsum("ddyx->yx", g))
    return np.asarray(post * ~solid)


def outgoing(c: Floats, post: Floats, rho: Floats, q: Floats) -> Floats:
    """What of a component leaves each node in each direction, (9, h, w).

    c f_i + rho w_i q . c_i / |c_i| (recolouring after Latva-Kokko and Rothman).
    """
    return np.asarray(c * post + rho * (W / LENGTH)[:, None, None] * lattice.along(q))


def inlet(params: Params, f: Floats, solid: Bools, step: int) -> None:
    """Add the momentum of fluid that enters at U: bounce-back at a wall that moves inwards."""
    for i in (1, 5, 8):
        f[i, :, 0] += 6 * W[i] * params.rho_0 * params.inlet_velocity(step) * ~solid[:, 0]


def outlet(params: Params, f: Floats, solid: Bools) -> None:
    """Last column: density rho_0, velocity and non-equilibrium part of the column before."""
    before = f[:, :, -2:-1]
    rho = lattice.density(before) + solid[:, -2:-1]
    u = lattice.momentum(before) / rho
    rest = before - lattice.equilibrium(rho, u)
    last = lattice.equilibrium(np.full_like(rho, params.rho_0), u) + rest
    f[:, :, -1:] = last * ~solid[:, -1:]


def step(params: Params, state: State) -> State:
    """One time step."""
    if state.step % RECENTRE_STEPS == 0:
        state = recentre(params, state)
    solid = solid_nodes(params)
    e, total = state.emulsion, label_sum(state)
    e_grad = gradient(e)
    film_grad = e_grad.copy()
    g = tension(e_grad)
    force = params.wall_force * wall_push(params) * e
    sharpening, placed = [], []
    for k, label in enumerate(state.labels):
        grad = gradient(label)
        a = recolouring(params, label, grad)
        at = nodes(state, k)
        force[(slice(None), *at)] += near_contact_force(
            params, label, grad, state.origins[k], total, e
        )
        g[(slice(None), slice(None), *at)] += tension(grad)
        film_grad[(slice(None), *at)] -= grad
        on_grid = np.zeros_like(e_grad)
        on_grid[(slice(None), *at)] = a
        sharpening.append(a)
        placed.append(on_grid)
    a_e = recolouring(params, e, e_grad)
    q = constraint(placed, a_e, recolouring(params, e - total, film_grad))
    post = collide(params, state.f, force, g, solid)
    f = lattice.stream_among_solids(post, solid)
    inlet(params, f, solid, state.step)
    outlet(params, f, solid)
    rho, rho_new = lattice.density(state.f), lattice.density(f) + solid
    leaving = outgoing(e, post, rho, a_e + (1 - e) * q)
    emulsion = lattice.density(lattice.stream_among_solids(leaving, solid)) / rho_new
    emulsion[np.abs(emulsion) < NOTHING] = 0
    labels = np.empty_like(state.labels)
    for k, label in enumerate(state.labels):
        at = nodes(state, k)
        flux = sharpening[k] - label * q[(slice(None), *at)]
        leaving = outgoing(label, post[(slice(None), *at)], rho[at], flux)
        arrived = stream_in_window(leaving, solid, state.origins[k])
        labels[k] = lattice.density(arrived) / rho_new[at]
        labels[k][np.abs(labels[k]) < NOTHING] = 0
    return State(f=f, emulsion=emulsion, labels=labels, origins=state.origins, step=state.step + 1)


def stream_in_window(leaving: Floats, solid: Bools, origin: NDArray[np.int64]) -> Floats:
    """Streaming within a window: solids and the box send back, what leaves the window is lost."""
    h, w = leaving.shape[1:]
    blocked = np.pad(solid, 1, constant_values=True)
    blocked = blocked[origin[0] : origin[0] + h + 2, origin[1] : origin[1] + w + 2]
    padded = np.pad(leaving, ((0, 0), (1, 1), (1, 1)))
    arrived = np.empty_like(leaving)
    for i in range(9):
        back = lattice.shifted(blocked, -CX[i], -CY[i])
        arrived[i] = np.where(
            back, leaving[OPPOSITE[i]], lattice.shifted(padded[i], -CX[i], -CY[i])
        )
    return np.asarray(arrived * ~lattice.shifted(blocked, 0, 0))


def recentre(params: Params, state: State) -> State:
    """Move every window by whole nodes so that its droplet's box is in its middle."""
    labels, origins = centred(params, state.labels, state.origins)
    return replace(state, labels=labels, origins=origins)


def centred(
    params: Params, labels: Floats, origins: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Labels (N, h, w) and origins (N, 2) of windows with their droplets' boxes in the middle."""
    moved, corners = np.zeros_like(labels), origins.copy()
    h, w = labels.shape[1:]
    room = np.array([params.height - h, params.width - w])
    for k, label in enumerate(labels):
        inside = label > 0.5
        rows, columns = np.nonzero(inside.any(axis=1))[0], np.nonzero(inside.any(axis=0))[0]
        if not len(rows):
            moved[k] = label  # dissolved: the checks report it
            continue
        centre = np.array([rows[0] + rows[-1] + 1, columns[0] + columns[-1] + 1]) / 2
        wanted = np.round(origins[k] + centre - np.array([h, w]) / 2).astype(np.int64)
        corners[k] = np.clip(wanted, 0, room)
        dy, dx = (corners[k] - origins[k]).tolist()
        kept = label[max(dy, 0) : h + min(dy, 0), max(dx, 0) : w + min(dx, 0)]
        y, x = max(-dy, 0), max(-dx, 0)
        moved[k, y : y + kept.shape[0], x : x + kept.shape[1]] = kept
    return moved, corners


def patches(state: State) -> list[tuple[Floats, Floats]]:
    """For every droplet: c_k, (h, w), and the [y, x] of that array's corner."""
    pairs = zip(state.labels, state.origins, strict=True)
    return [(label, origin.astype(float)) for label, origin in pairs]


def shade(state: State) -> Floats:
    """Brightness of the image, (H, W) in 0..1: white droplets with dark films between them."""
    highest = np.zeros_like(state.emulsion)
    for k, label in enumerate(state.labels):
        at = nodes(state, k)
        highest[at] = np.maximum(highest[at], label)
    return np.asarray(np.clip((2 * highest - label_sum(state) - 0.25) / 0.5, 0, 1))


def masses(state: State) -> Floats:
    """Mass of every droplet, sum c_k rho, (N,)."""
    rho = lattice.density(state.f)
    return np.array([(c * rho[nodes(state, k)]).sum() for k, c in enumerate(state.labels)])


def initial_state(params: Params) -> State:
    """The droplets of the seed in the inlet chamber, at rest."""
    solid = solid_nodes(params)
    whole, emulsion = droplet_fractions(params, np.random.default_rng(params.seed))
    return state_of(params, whole, np.where(solid, 0.0, emulsion))


def state_of(params: Params, whole: Floats, emulsion: Floats) -> State:
    """A state at rest from fractions on the whole grid: droplets (N, H, W), emulsion (H, W)."""
    solid = solid_nodes(params)
    h, w = min(params.window, params.height), min(params.window, params.width)
    labels = np.zeros((len(whole), h, w))
    origins = np.zeros((len(whole), 2), np.int64)
    for k, c in enumerate(whole):
        y, x = np.nonzero(c > 0.5)
        corner = [(y.min() + y.max() + 1 - h) // 2, (x.min() + x.max() + 1 - w) // 2]
        origins[k] = np.clip(corner, 0, [params.height - h, params.width - w])
        y_0, x_0 = origins[k]
        labels[k] = c[y_0 : y_0 + h, x_0 : x_0 + w]
    labels[labels < NOTHING] = 0
    rho = np.where(solid, 0.0, params.rho_0)
    f = lattice.equilibrium(rho, np.zeros((2, params.height, params.width)))
    emulsion = np.where(emulsion < NOTHING, 0, emulsion)
    return State(f=f, emulsion=emulsion, labels=labels, origins=origins, step=0)
