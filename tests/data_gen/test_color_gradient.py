from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.geometry import (
    Params,
    droplet_fractions,
    power_cells,
    solid_nodes,
    wall_push,
)
from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

numba = pytest.importorskip("numba")
from data_gen.lattice_boltzmann.color_gradient.solver import Solver


def small(**changes: Any) -> Params:
    values: dict[str, Any] = {
        "droplets": 3, "height": 60, "throat_height": 20, "throat_length": 20, "inlet_length": 60,
        "outlet_length": 30, "window": 50, "rest_steps": 3, "ramp_steps": 10,
    }  # fmt: skip
    return Params(**(values | changes))


def rough_state(params: Params) -> cg.State:
    """Droplets that overlap, touch walls and the throat's corner, in a disturbed flow."""
    rng = np.random.default_rng(5)
    state = cg.initial_state(params)
    e = np.roll(state.emulsion, 14, axis=1) * ~solid_nodes(params)
    labels = state.labels * rng.uniform(0.9, 1.05, state.labels.shape)
    f = state.f * rng.uniform(0.95, 1.05, state.f.shape)
    state = replace(state, f=f, emulsion=e, labels=labels, step=7)
    state.origins[:, 1] += [14, 12, 16]
    for k in range(len(labels)):
        labels[k][solid_nodes(params)[cg.nodes(state, k)]] = 0
    return state


def test_compiled_steps_are_the_reference_to_rounding() -> None:
    params = small()
    state = rough_state(params)
    solver = Solver(params, state)
    solver.run(40)
    for _ in range(40):
        state = cg.step(params, state)
    assert solver.state.step == state.step == 47
    for name in ("f", "emulsion", "labels", "origins"):
        np.testing.assert_allclose(
            getattr(solver.state, name), getattr(state, name), rtol=0, atol=1e-10
        )


def test_result_depends_neither_on_threads_nor_on_how_steps_are_divided() -> None:
    params = small()
    states = []
    for threads, parts in ((1, (40,)), (numba.config.NUMBA_NUM_THREADS, (1, 7, 32))):
        numba.set_num_threads(threads)
        solver = Solver(params, rough_state(params))
        for steps in parts:
            solver.run(steps)
        states.append(solver.state)
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    for name in ("f", "emulsion", "labels"):
        assert (getattr(states[0], name) == getattr(states[1], name)).all()


def test_windows_do_not_change_what_happens() -> None:
    wide = small(window=60)
    narrow = replace(wide, window=50)
    states = []
    for params in (wide, narrow):
        solver = Solver(params, cg.initial_state(params))
        solver.run(200)
        states.append(solver.state)
    np.testing.assert_allclose(cg.label_sum(states[0]), cg.label_sum(states[1]), atol=1e-4)
    np.testing.assert_allclose(states[0].f, states[1].f, atol=1e-5)


def test_collision_keeps_mass_adds_the_force_and_the_stress_of_the_interfaces() -> None:
    params = Params(droplets=0, tau=0.8)
    rng = np.random.default_rng(3)
    f = lattice.W[:, None, None] * rng.uniform(0.8, 1.2, (9, 4, 5))
    force = rng.uniform(-0.01, 0.01, (2, 4, 5))
    g = rng.uniform(-0.1, 0.1, (2, 2, 4, 5))
    g[0, 1] = g[1, 0]
    nowhere = np.zeros((4, 5), bool)
    plain = cg.collide(params, f, force, 0 * g, nowhere)
    post = cg.collide(params, f, force, g, nowhere)
    np.testing.assert_allclose(lattice.density(post), lattice.density(f))
    np.testing.assert_allclose(lattice.momentum(post), lattice.momentum(f) + force)
    # an isotropic part aside, the perturbation is 4/9 A (G - I tr G): tension along interfaces
    added = lattice.momentum_flux(post - plain)
    a = 9 * params.sigma / (4 * params.tau)
    np.testing.assert_allclose(added[0, 1], 4 / 9 * a * g[0, 1], atol=1e-15)
    np.testing.assert_allclose(added[0, 0] - added[1, 1], 4 / 9 * a * (g[0, 0] - g[1, 1]))


def test_fluxes_of_droplets_film_and_outer_fluid_add_up_to_nothing() -> None:
    params = small()
    state = rough_state(params)
    solver = Solver(params, state)
    rho = lattice.density(state.f)
    sums = cg.label_sum(state) * rho
    mass = cg.masses(state)
    solver.run(1)
    after = cg.masses(solver.state)
    np.testing.assert_allclose(after, mass, rtol=1e-6)  # not even into walls or corners
    assert cg.label_sum(solver.state).max() < 1.02 * (sums / np.maximum(rho, 1e-9)).max()


def drop_in_emulsion(radius: float, stretch: float) -> tuple[Params, cg.State]:
    """A stretched droplet within a round emulsion, in fluid that is not at rest."""
    size = round(2 * (radius + 22))
    params = Params(
        height=size, throat_height=size, throat_length=0, inlet_length=size, outlet_length=0,
        droplets=1, radius=radius, u_in=0.0, window=round(5 * radius), wall_force=0.0, phi=0.6,
    )  # fmt: skip
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    profile = np.array([np.hypot(x / stretch, y * stretch) - radius, np.hypot(x, y) - radius - 12])
    c, e = (1 - np.tanh(params.steepness * profile)) / 2
    state = cg.state_of(params, c[None], e)
    u = 5e-3 * np.stack([np.sin(2 * np.pi * y / size), np.sin(2 * np.pi * x / size)])
    return params, replace(state, f=lattice.equilibrium(np.ones((size, size)), u))


@pytest.mark.parametrize(("radius", "tolerance"), [(10, 0.05), (18, 0.02), (24, 0.02)])
def test_laplace_law_mass_and_spurious_currents(radius: float, tolerance: float) -> None:
    params, state = drop_in_emulsion(radius, 1.1)
    mass = cg.masses(state)
    solver = Solver(params, state)
    solver.run(6000 if radius < 20 else 10000)
    state = solver.state
    np.testing.assert_allclose(cg.masses(state), mass, rtol=1e-6)
    pressure = lattice.density(state.f) / 3
    y, x = np.mgrid[: params.height, : params.width] + 0.5
    ((c, origin),) = cg.patches(state)
    mask = c > 0.5
    cy, cx = np.mean(np.nonzero(mask), axis=1) + origin + 0.5
    r = np.hypot(x - cx, y - cy)
    inside = pressure[r < radius - 5].mean()
    film = pressure[(radius + 5 < r) & (r < radius + 7)].mean()
    r_drop = np.sqrt(cg.label_sum(state).sum() / np.pi)
    assert (inside - film) / (params.sigma / r_drop) == pytest.approx(1, abs=tolerance)
    _, u = cg.velocity(state.f, np.zeros((2, *r.shape)), solid_nodes(params))
    viscosity = (params.tau - 0.5) / 3
    assert viscosity * np.hypot(*u).max() / params.sigma < 1e-3


def test_poiseuille_flow_between_inlet_and_outlet() -> None:
    params = Params(
        droplets=0, height=40, throat_height=40, throat_length=0, inlet_length=60,
        outlet_length=100, u_in=5e-3, rest_steps=0, ramp_steps=1, window=40,
    )  # fmt: skip
    solver = Solver(params, cg.initial_state(params))
    solver.run(12000)
    rho, u = cg.velocity(solver.state.f, np.zeros((2, 40, 160)), solid_nodes(params))
    y = np.arange(40) + 0.5
    profile = (rho * u[0])[:, 110]
    assert profile.mean() == pytest.approx(params.u_in, rel=5e-3)  # all that enters arrives
    expected = 6 * profile.mean() * y * (40 - y) / 40**2
    np.testing.assert_allclose(profile, expected, atol=5e-3 * expected.max())


@pytest.mark.parametrize("n", [7, 19])
def test_starting_droplets_are_equal_and_fill_their_share(n: int) -> None:
    params = Params(droplets=n)
    labels, emulsion = droplet_fractions(params, np.random.default_rng(2))
    areas = labels.sum(axis=(1, 2))
    np.testing.assert_allclose(areas, np.pi * params.radius**2, rtol=0.05)
    assert areas.sum() / emulsion.sum() == pytest.approx(params.phi, rel=0.01)
    assert labels.sum(axis=0).max() < 1.01


def test_power_cells_are_different_for_each_seed_and_equal_for_the_same() -> None:
    first, again, other = (power_cells(5, np.random.default_rng(s))[0] for s in (1, 1, 2))
    assert (first == again).all()
    assert not np.allclose(first, other)


def test_walls_push_away_and_weaken_by_half_a_node() -> None:
    params = small()
    push = wall_push(params)
    assert push[1, 0, 5] == pytest.approx(1)
    assert push[1, 2, 5] == pytest.approx(1 / 4)
    assert push[1, -1, 5] == pytest.approx(-1)
    assert push[0, 10, 59] == pytest.approx(-1)  # left of the throat's wall
    assert not push[:, 30, 30].any()


def test_a_droplet_is_carried_with_the_flow() -> None:
    height, length, mean = 60, 120, 0.01
    params = Params(
        droplets=1, radius=8, height=height, throat_height=height, throat_length=0, phi=0.6,
        inlet_length=60, outlet_length=length - 60, u_in=mean, rest_steps=0, ramp_steps=1,
    )  # fmt: skip
    state = cg.initial_state(params)
    profile = np.zeros((2, height, length))
    y = np.arange(height) + 0.5
    profile[0] = (6 * mean * y * (height - y) / height**2)[:, None]
    solver = Solver(
        params, replace(state, f=lattice.equilibrium(np.ones((height, length)), profile))
    )

    def centre(state: cg.State) -> Floats:
        ((c, origin),) = cg.patches(state)
        mask = c > 0.5
        return np.asarray(np.mean(np.nonzero(mask), axis=1) + origin)

    solver.run(1500)
    start = centre(solver.state)
    solver.run(1000)
    moved = centre(solver.state) - start
    assert moved[0] == pytest.approx(0, abs=0.05)
    assert 0.9 * 15 < moved[1] < 15  # a little slower than the flow in the middle, at 0.015


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"droplets": 40}, "does not fit the inlet"),
        ({"tau": 0.5}, "relaxation time"),
        ({"sigma": 0.5}, "unstable"),
        ({"u_in": 0.05}, "throat"),
        ({"throat_height": 9}, "narrower"),
        ({"throat_height": 40}, "even"),
        ({"radius": 3.0}, "5 or more"),
        ({"window": 20}, "window"),
        ({"phi": 1.5}, "phi"),
    ],
)
def test_impossible_parameters_are_refused_with_the_reason(
    changes: dict[str, Any], reason: str
) -> None:
    with pytest.raises(DroptrackError, match=reason):
        Params(**changes)
