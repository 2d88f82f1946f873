"""Velocities told by neighbours and by patterns, on fields whose answer is known."""

import numpy as np
import pytest

from droptrack.tracking.neighbour_velocity import displacement_of_pattern, velocity_of_neighbours


def lattice(rng: np.random.Generator, disorder: float) -> np.ndarray:
    row, column = np.mgrid[:12, :14].reshape(2, -1)
    places = np.column_stack([column + row % 2 / 2, row * np.sqrt(0.75)]) * 20.0
    return np.asarray(places + rng.normal(0, disorder * 20, places.shape))


def test_a_linear_field_is_its_neighbours_mean_in_the_middle() -> None:
    rng = np.random.default_rng(0)
    known = lattice(rng, 0.0)
    velocities = known @ np.array([[0.01, 0.02], [-0.03, 0.01]]) + [2, 1]
    middle = known[[75]]
    others = np.arange(len(known)) != 75
    mean, variance = velocity_of_neighbours(
        middle, np.array([20.0]), known[others], velocities[others]
    )
    np.testing.assert_allclose(mean[0], velocities[75], atol=1e-9)
    around = ((velocities - velocities[75]) ** 2).sum(axis=1)[others]
    near = np.argsort(((known[others] - middle) ** 2).sum(axis=1))[:6]
    assert variance[0] == pytest.approx(around[near].mean() / 2)


def test_far_or_few_neighbours_are_no_flow() -> None:
    points, diameters = np.array([[0.0, 0]]), np.array([10.0])
    far = np.array([[100.0, 0], [0, 100], [100, 100]])
    assert np.isinf(velocity_of_neighbours(points, diameters, far, far)[1])
    assert np.isinf(velocity_of_neighbours(points, diameters, far[:2] / 10, far[:2])[1])
    assert np.isfinite(velocity_of_neighbours(points, diameters, far / 10, far)[1])


@pytest.mark.parametrize("step", [(9.0, 4.0), (33.0, -8.0), (40.0, 0.0)])
def test_a_pattern_tells_its_displacement(step: tuple[float, float]) -> None:
    """Disordered by 15 % of the spacing: also beyond the next droplet's place."""
    places = lattice(np.random.default_rng(1), 0.15)
    rows = np.arange(len(places))
    found, share = displacement_of_pattern(
        places, np.full(len(places), 20.0), rows, places + step, 2.5
    )
    right = np.hypot(*(found - step).T) < 1e-9
    assert right.mean() > 0.95
    assert np.median(share[right]) > 0.8


def test_a_packing_that_moves_by_half_a_spacing_goes_one_way() -> None:
    """Disordered by 3 %: half a spacing to the left would fit nearly as well."""
    places = lattice(np.random.default_rng(2), 0.03)
    rows = np.arange(len(places))
    found, _ = displacement_of_pattern(
        places, np.full(len(places), 19.0), rows, places + np.array([10.0, 0]), 2.5
    )
    assert (np.hypot(*(found - [10.0, 0]).T) < 1e-9).mean() > 0.98


def test_no_pattern_has_no_share() -> None:
    none, one = np.zeros((0, 2)), np.ones((1, 2))
    step, share = displacement_of_pattern(one, np.ones(1), np.array([0]), none, 2.5)
    assert (step.tolist(), share.tolist()) == ([[0, 0]], [0])
