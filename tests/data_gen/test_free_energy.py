from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.free_energy import reference as fe
from droptrack.data.arrays import Bools, Floats
from droptrack.errors import DroptrackError

numba = pytest.importorskip("numba")
from data_gen.lattice_boltzmann.free_energy.solver import Solver

SMALL: dict[str, Any] = {"core_radius": 7.0, "shell_radius": 22.0, "rest_steps": 0, "window": 40}


def small(cores: int = 2, **changes: Any) -> fe.Params:
    values = SMALL | {"width": 64, "height": 60, "cores": cores, "core_distance": 9.0} | changes
    return fe.Params(**values)


def masks(params: fe.Params, state: fe.State) -> list[tuple[Bools, Floats]]:
    """Where the cores are, and the corners of these arrays, x not wrapped."""
    patches = fe.patches(params, state)
    return [(p > 0.5, o) for (p, _), o in zip(patches, state.origins.astype(float), strict=True)]


def rough_state(params: fe.Params, seed: int = 0) -> fe.State:
    """Off-centre cores and windows, one across the periodic edge, in a disturbed flow."""
    rng = np.random.default_rng(seed)
    state = fe.initial_state(params)
    state = replace(state, outer=np.roll(state.outer, 25, axis=1), step=13)
    if params.window:
        state = replace(state, origins=state.origins + [[0, 25], [3, 22]][: params.cores])
    else:
        state = replace(state, cores=np.roll(state.cores, 25, axis=2))
    f = state.f * rng.uniform(0.97, 1.03, state.f.shape)
    return replace(state, f=f, cores=state.cores + rng.uniform(0, 0.05, state.cores.shape))


@pytest.mark.parametrize(("window", "order"), [(0, 2), (40, 2), (40, 4)])
def test_compiled_steps_are_the_reference_to_rounding(window: int, order: int) -> None:
    params = small(window=window, flux_order=order, epsilon=0.01, rest_steps=30, force_x=1e-6)
    state = rough_state(params)
    solver = Solver(params, state)
    solver.run(60)  # the walls start at 30, the windows move at 50
    for _ in range(60):
        state = fe.step(params, state)
    assert solver.state.step == state.step == 73
    for name in ("f", "outer", "cores", "origins"):
        np.testing.assert_allclose(
            getattr(solver.state, name), getattr(state, name), rtol=0, atol=1e-13
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
    for name in ("f", "outer", "cores"):
        assert (getattr(states[0], name) == getattr(states[1], name)).all()


def test_the_arrays_of_a_state_cannot_be_changed() -> None:
    state = Solver(small(), fe.initial_state(small())).state
    for array in (state.f, state.outer, state.cores, state.origins):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def free_energy(params: fe.Params, psi: Floats) -> float:
    """F of Eq. B2 for fields (n, H, W), with the gradient term of the 9-point Laplacian."""
    pairs = [(i, j) for i in range(len(psi)) for j in range(i)]
    bulk = params.a / 4 * psi**2 * (psi - params.psi_0) ** 2
    laps = np.array([lattice.laplacian(lattice.pad(p, periodic_x=True)) for p in psi])
    repulsion = sum(
        params.epsilon * psi[i] * psi[j] + params.epsilon_quadratic * (psi[i] * psi[j]) ** 2
        for i, j in pairs
    )
    return float(bulk.sum() - params.k / 2 * (psi * laps).sum() + np.sum(repulsion))


def test_chemical_potential_is_the_derivative_of_the_free_energy() -> None:
    params = fe.Params(cores=0, epsilon=0.03)
    psi = np.random.default_rng(1).uniform(-0.2, 2.2, (3, 6, 5))
    total, squares = psi.sum(axis=0), (psi**2).sum(axis=0)
    mu = fe.potential(params, lattice.pad(psi[1], periodic_x=True), total, squares)
    for y, x in ((0, 0), (3, 2), (5, 4)):  # both walls, the periodic edge, the middle
        change = np.zeros_like(psi)
        change[1, y, x] = 1e-5
        slope = (free_energy(params, psi + change) - free_energy(params, psi - change)) / 2e-5
        assert mu[y, x] == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("order", [2, 4])
def test_advection_moves_a_profile_and_lets_nothing_through_walls(order: int) -> None:
    params = fe.Params(cores=0, flux_order=order)
    x = np.arange(32) + 0.5
    psi = np.tile(np.sin(2 * np.pi * x / 32), (8, 1))
    u = np.zeros((2, 8, 32))
    u[0], u[1] = 0.1, 0.3
    divergence = fe.advection(params, psi, fe.pad_velocity(u, periodic_x=True), periodic_x=True)
    assert abs(divergence.sum()) < 1e-13
    expected = 0.1 * 2 * np.pi / 32 * np.cos(2 * np.pi * x / 32)
    k = 2 * np.pi / 32
    error = 0.1 * (k**3 / 6 if order == 2 else k**5 / 30)
    np.testing.assert_allclose(np.abs(divergence[3] - expected).max(), error, rtol=0.05)
    np.testing.assert_allclose(divergence[0] - divergence[3], 0.3 * psi[0])


@pytest.mark.parametrize("magic", [3 / 16, 1 / 4])
def test_couette_and_poiseuille_flow(magic: float) -> None:
    height, force_x = 24, 1e-5
    params = fe.Params(
        width=16, height=height, cores=0, rest_steps=0, force_x=force_x, magic=magic, v_bottom=-0.02
    )
    solver = Solver(params, fe.initial_state(params))
    solver.run(8000)
    u = lattice.momentum(solver.state.f)[0] + force_x / 2
    y = np.arange(height) + 0.5
    poiseuille = force_x * y * (height - y) / (2 * params.viscosity)
    expected = -0.02 + 0.03 * y / height + poiseuille
    error = np.abs(u / params.rho_0 - expected[:, None])
    assert error.max() < (1e-12 if magic == 3 / 16 else 0.005 * poiseuille.max())


def stretched_drop(radius: float) -> tuple[fe.Params, fe.State]:
    """A core drawn out by a fifth, in a round shell, in fluid that is not at rest."""
    shell = radius + 14
    size = round(2 * (shell + 8))
    params = fe.Params(
        width=size, height=size, cores=1, core_radius=radius, shell_radius=shell,
        core_distance=0.0, v_top=0, v_bottom=0, window=0, rest_steps=0,
    )  # fmt: skip
    state = fe.initial_state(params)
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    r = np.hypot(x / 1.2, y * 1.2)
    profile = 1 - np.tanh((r - radius) / params.width_of_interface)
    rho = np.full((size, size), params.rho_0)
    u = 1e-3 * np.stack([np.sin(2 * np.pi * y / size), np.sin(2 * np.pi * x / size)])
    return params, replace(state, cores=profile[None], f=lattice.equilibrium(rho, u))


@pytest.mark.parametrize(("radius", "tolerance"), [(10, 0.05), (18, 0.02), (24, 0.02)])
def test_laplace_law_of_a_core_and_of_the_shell(radius: float, tolerance: float) -> None:
    params, state = stretched_drop(radius)
    before = fe.masses(state)
    solver = Solver(params, state)
    solver.run(8000 if radius < 20 else 12000)
    state = solver.state
    np.testing.assert_allclose(fe.masses(state) / before, 1, atol=1e-11)
    pressure = lattice.density(state.f) / 3
    y, x = np.mgrid[: params.height, : params.width] + 0.5 - params.height / 2
    r = np.hypot(x, y)
    inside, shell, outside = (
        pressure[(low < r) & (r < high)].mean()
        for low, high in ((0, 3), (radius + 6, radius + 8), (radius + 20, radius + 30))
    )
    r_core = np.sqrt((state.cores[0] > 1).sum() / np.pi)
    r_shell = np.sqrt((state.outer < 1).sum() / np.pi)
    sigma = params.surface_tension
    assert (inside - shell) / (sigma / r_core) == pytest.approx(1, abs=tolerance)
    assert (shell - outside) / (sigma / r_shell) == pytest.approx(1, abs=tolerance)


def test_spurious_currents_around_a_drop_left_to_rest() -> None:
    params, stirred = stretched_drop(15)
    solver = Solver(params, replace(fe.initial_state(params), f=stirred.f))
    solver.run(4000)
    u = fe.velocity(solver.state, fe.forces(params, solver.state)[0])
    assert params.viscosity * np.hypot(*u).max() / params.surface_tension < 1e-3


@pytest.mark.parametrize(("order", "lag"), [(2, 0.22), (4, 0.045)])
def test_a_carried_drop_keeps_its_shape_and_moves_with_the_flow(order: int, lag: float) -> None:
    areas, shifts = [], []
    for v in (0.0, 0.02):
        params = small(1, v_top=v, v_bottom=v, core_distance=0.0, flux_order=order)
        state = fe.initial_state(params)
        u = np.zeros((2, 60, 64))
        u[0] = v
        solver = Solver(params, replace(state, f=lattice.equilibrium(2 * np.ones((60, 64)), u)))
        ((mask, origin),) = masks(params, solver.state)
        start = origin[1] + np.nonzero(mask)[1].mean()
        solver.run(4000)  # 1.25 times around
        ((mask, origin),) = masks(params, solver.state)
        shifts.append(origin[1] + np.nonzero(mask)[1].mean() - start)
        core = solver.state.cores[0] > 0.2
        areas.append((mask.sum(), np.ptp(np.nonzero(core)[0]), np.ptp(np.nonzero(core)[1])))
    assert shifts[0] == pytest.approx(0, abs=1e-6)
    assert shifts[1] == pytest.approx(80, rel=lag)
    np.testing.assert_allclose(areas[0], areas[1], atol=1, rtol=0.02)


def test_cores_turn_clockwise_with_the_walls_and_mass_stays() -> None:
    params = fe.Params(rest_steps=0)
    solver = Solver(params, fe.initial_state(params))
    before = fe.masses(solver.state)
    angles = []
    for _ in range(4):
        centre = np.array(
            [np.mean(np.nonzero(m), axis=1) + o for m, o in masks(params, solver.state)]
        )
        y, x = (centre + 0.5 - [params.height / 2, params.width / 2]).T
        angles.append(np.unwrap(np.arctan2(y, x)))
        solver.run(700)
    turned = np.diff(np.unwrap(np.array(angles), axis=0), axis=0).mean(axis=1)
    assert (turned[1:] < 0).all()
    assert turned.sum() < np.radians(-1)
    np.testing.assert_allclose(fe.masses(solver.state) / before, 1, atol=1e-11)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"mobility": 1.0}, "unstable"),
        ({"viscosity": -1.0}, "above 0"),
        ({"viscosity": 9.0}, "relaxation time"),
        ({"k": 0.001}, "interface"),
        ({"cores": 9}, "overlap"),
        ({"core_distance": 40.0}, "do not fit a shell"),
        ({"shell_radius": 90.0}, "does not fit a channel"),
        ({"window": 30}, "window"),
        ({"v_top": 0.5}, "Mach"),
        ({"epsilon": float("nan")}, "finite"),
    ],
)
def test_impossible_parameters_are_refused_with_the_reason(
    changes: dict[str, Any], reason: str
) -> None:
    with pytest.raises(DroptrackError, match=reason):
        fe.Params(**changes)
