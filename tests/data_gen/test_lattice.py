import numpy as np
import pytest

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.lattice import CS2
from droptrack.data.arrays import Floats


def rough_state(seed: int = 0, shape: tuple[int, int] = (6, 7)) -> Floats:
    """Positive populations far from equilibrium."""
    return lattice.W[:, None, None] * np.random.default_rng(seed).uniform(0.5, 1.5, (9, *shape))


def test_weights_are_isotropic_up_to_fourth_order() -> None:
    c, w, unit = lattice.C, lattice.W, np.eye(2)
    assert w.sum() == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(np.einsum("i,ia,ib", w, c, c), CS2 * unit, atol=1e-15)
    fourth = np.einsum("ab,cd->abcd", unit, unit)
    fourth = fourth + fourth.transpose(0, 2, 1, 3) + fourth.transpose(0, 3, 2, 1)
    np.testing.assert_allclose(np.einsum("i,ia,ib,ic,id", w, c, c, c, c), fourth / 9, atol=1e-15)


def test_equilibrium_has_the_density_momentum_and_stress_of_a_moving_ideal_gas() -> None:
    rng = np.random.default_rng(1)
    rho, u = rng.uniform(0.5, 2, (4, 5)), rng.uniform(-0.2, 0.2, (2, 4, 5))
    f = lattice.equilibrium(rho, u)
    np.testing.assert_allclose(lattice.density(f), rho)
    np.testing.assert_allclose(lattice.momentum(f), rho * u, atol=1e-15)
    stress = CS2 * rho * np.eye(2)[:, :, None, None] + rho * lattice.outer(u, u)
    np.testing.assert_allclose(lattice.momentum_flux(f), stress, atol=1e-15)


def test_collision_keeps_mass_and_momentum_and_relaxes_the_stress_with_tau_plus() -> None:
    f = rough_state()
    rho, m = lattice.density(f), lattice.momentum(f)
    f_eq = lattice.equilibrium(rho, m / rho)
    after = lattice.relax(f, f_eq, tau_plus=1.7, tau_minus=0.6)
    np.testing.assert_allclose(lattice.density(after), rho)
    np.testing.assert_allclose(lattice.momentum(after), m, atol=1e-15)
    stress = lattice.momentum_flux(f - f_eq)
    np.testing.assert_allclose(
        lattice.momentum_flux(after - f_eq), (1 - 1 / 1.7) * stress, atol=1e-15
    )


def test_force_adds_no_mass_and_its_momentum_less_the_half_step_in_the_velocity() -> None:
    rng = np.random.default_rng(2)
    u, force = rng.uniform(-0.1, 0.1, (2, 2, 3, 4))
    term = lattice.guo_force(u, force, tau_plus=1.7, tau_minus=0.6)
    np.testing.assert_allclose(lattice.density(term), 0, atol=1e-15)
    np.testing.assert_allclose(lattice.momentum(term), (1 - 0.5 / 0.6) * force, atol=1e-15)
    work = (1 - 0.5 / 1.7) * (lattice.outer(u, force) + lattice.outer(force, u))
    np.testing.assert_allclose(lattice.momentum_flux(term), work, atol=1e-15)


def test_streaming_moves_each_population_by_its_velocity() -> None:
    f = np.zeros((9, 5, 5))
    f[:, 2, 2] = np.arange(1, 10)
    moved = lattice.stream(f)
    for i, (cx, cy) in enumerate(lattice.C):
        assert moved[i, 2 + cy, 2 + cx] == i + 1


def test_solid_nodes_send_everything_back_and_keep_mass() -> None:
    solid = np.zeros((6, 7), bool)
    solid[2:4, 3] = True
    f = rough_state()
    f[:, solid] = 0
    moved = lattice.stream_among_solids(f, solid)
    assert moved.sum() == pytest.approx(f.sum(), rel=1e-14)
    assert moved[1, 2, 4] == f[3, 2, 4]  # a wall to its west
    assert moved[6, 0, 6] == f[8, 0, 6]  # the corner of the box
    assert moved[5, 3, 2] == f[5, 2, 1]  # free


def test_derivatives_of_polynomials_are_exact() -> None:
    y, x = np.mgrid[:6, :7].astype(float)
    inner = (slice(1, -1), slice(1, -1))
    field = 3 * x - 2 * y + x**2 + 0.5 * x * y
    grad = lattice.gradient(field)
    np.testing.assert_allclose(grad[0], (3 + 2 * x + 0.5 * y)[inner])
    np.testing.assert_allclose(grad[1], (-2 + 0.5 * x)[inner])
    np.testing.assert_allclose(lattice.laplacian(field), 2, atol=1e-12)


def test_derivatives_converge_with_second_order() -> None:
    errors = []
    for n in (32, 64):
        y, x = (np.mgrid[:n, :n] + 0.5) * 2 * np.pi / n
        padded = lattice.pad(np.sin(x) * np.cos(y), periodic_x=True)
        step = 2 * np.pi / n
        errors.append(
            [
                np.abs(lattice.gradient(padded)[0] / step - np.cos(x) * np.cos(y)).max(),
                np.abs(lattice.laplacian(padded) / step**2 + 2 * np.sin(x) * np.cos(y)).max(),
            ]
        )
    order = np.log2(np.array(errors[0]) / errors[1])
    np.testing.assert_allclose(order, 2, atol=0.05)


def decay_rate(n: int, carrier: float, viscosity: float, steps: int) -> float:
    """Decay rate of a shear wave u_y = 0.01 sin(k x) carried by a flow along x."""
    tau = lattice.viscous_time(viscosity)
    tau_minus = lattice.odd_time(tau, 1 / 4)
    k = 2 * np.pi / n
    x = np.arange(n)
    u = np.zeros((2, 3, n))
    u[0] = carrier
    u[1] = 0.01 * np.sin(k * x)
    f = lattice.equilibrium(np.ones((3, n)), u)
    amplitude = []
    for _ in range(2):
        for _ in range(steps):
            u = lattice.momentum(f) / lattice.density(f)
            f_eq = lattice.equilibrium(lattice.density(f), u)
            f = lattice.stream(lattice.relax(f, f_eq, tau, tau_minus))
        wave = (lattice.momentum(f) / lattice.density(f))[1, 0]
        amplitude.append(abs(np.sum(wave * np.exp(1j * k * x))))
    return float(np.log(amplitude[0] / amplitude[1]) / steps)


@pytest.mark.parametrize(("n", "viscosity"), [(64, 1 / 6), (192, 0.835)])
def test_a_carried_shear_wave_decays_with_the_viscosity(n: int, viscosity: float) -> None:
    expected = viscosity * (2 * np.pi / n) ** 2
    assert decay_rate(n, 0.01, viscosity, 200) == pytest.approx(expected, rel=5e-3)


def test_flow_solver_converges_with_second_order() -> None:
    errors = [
        abs(decay_rate(n, 0.0, 0.1, 8 * (n // 8) ** 2) / (0.1 * (2 * np.pi / n) ** 2) - 1)
        for n in (16, 32)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


def test_couette_and_poiseuille_profiles() -> None:
    height, v, force_x = 20, 0.02, 1e-5
    tau = lattice.viscous_time(0.5)
    tau_minus = lattice.odd_time(tau, 3 / 16)
    force = np.zeros((2, height, 3))
    force[0] = force_x
    y = np.arange(height) + 0.5
    f = lattice.equilibrium(np.ones((height, 3)), np.zeros((2, height, 3)))
    for _ in range(5000):
        rho = lattice.density(f)
        u = (lattice.momentum(f) + force / 2) / rho
        f = lattice.relax(f, lattice.equilibrium(rho, u), tau, tau_minus)
        f = f + lattice.guo_force(u, force, tau, tau_minus)
        f = lattice.stream_in_channel(f, 1.0, -v, v)
    expected = v * (2 * y / height - 1) + force_x * y * (height - y) / (2 * 0.5)
    np.testing.assert_allclose(u[0, :, 1], expected, rtol=5e-3, atol=5e-3 * 2e-4)
