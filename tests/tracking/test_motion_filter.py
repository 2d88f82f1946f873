"""The filter of positions and velocities, against draws of what it stands for."""

import numpy as np

from droptrack.tracking.motion_filter import KinematicState, jump


def test_a_jump_is_the_mean_and_covariance_of_both_cases() -> None:
    """Half of the draws stay as they were, half are where the droplet was measured."""
    rng = np.random.default_rng(0)
    n, covariance = 400_000, np.array([[0.5, 0.2], [0.2, 0.3]])
    position, velocity, measured = np.array([3.0, 4.0]), np.array([1.0, -1.0]), np.array([9.0, 6.0])
    found = jump(
        KinematicState(position[None], velocity[None], np.array([[0.5, 0.2, 0.3]])), measured[None]
    )
    moved = rng.random(n) < 0.5
    spread = np.zeros(3)
    for k in (0, 1):  # a coordinate
        draws = rng.multivariate_normal([position[k], velocity[k]], covariance, n)
        draws[moved] += measured[k] - position[k]
        np.testing.assert_allclose(
            draws.mean(axis=0), [found.position[0, k], found.velocity[0, k]], atol=0.02
        )
        p_v = np.cov(draws.T)
        spread += np.array([p_v[0, 0], p_v[0, 1], p_v[1, 1]]) / 2  # one for both coordinates
    np.testing.assert_allclose(found.covariance[0], spread, rtol=0.01)
