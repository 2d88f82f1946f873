"""The vectorised filter against filterpy's general one, track by track."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from droptrack.tracking.deepsort import kalman

Floats = NDArray[np.float64]


def reference(measurement: Floats) -> KalmanFilter:
    """filterpy's filter with DeepSORT's matrices, state [cx, cy, a, h and their rates]."""
    f = KalmanFilter(dim_x=8, dim_z=4)
    f.F = np.eye(8) + np.eye(8, k=4)
    f.H = np.eye(4, 8)
    f.x = np.concatenate([measurement, np.zeros(4)])[:, None]
    h = measurement[3]
    f.P = np.diag(np.square([h / 10, h / 10, 1e-2, h / 10, h / 16, h / 16, 1e-5, h / 16]))
    return f


def set_noise(f: KalmanFilter) -> None:
    h = f.x[3, 0]
    f.Q = np.diag(np.square([h / 20, h / 20, 1e-2, h / 20, h / 160, h / 160, 1e-5, h / 160]))


def set_measurement_noise(f: KalmanFilter) -> None:
    h = f.x[3, 0]
    f.R = np.diag(np.square([h / 20, h / 20, 1e-1, h / 20]))


def test_fifty_frames_of_five_tracks_agree_with_filterpy() -> None:
    rng = np.random.default_rng(0)
    first = np.column_stack(
        [rng.uniform(0, 500, (5, 2)), rng.uniform(0.5, 2, 5), rng.uniform(10, 80, 5)]
    )
    filters = [reference(z) for z in first]
    mean, covariance = kalman.initiate(first)
    z = first
    for frame in range(50):
        mean, covariance = kalman.predict(mean, covariance)
        for f in filters:
            set_noise(f)
            f.predict()
        z = z + rng.normal(0, 2, z.shape) * [1, 1, 0.02, 1] + [3, 1, 0, 0.2]
        if frame == 20:
            continue  # a missed frame
        for i, f in enumerate(filters):
            set_measurement_noise(f)
            innovation = z[i] - f.x[:4, 0]
            spread = f.H @ f.P @ f.H.T + f.R
            expected = innovation @ np.linalg.solve(spread, innovation)
            distance = kalman.gating_distance(mean, covariance, z)[i]
            assert distance == pytest.approx(expected, rel=1e-9)
            f.update(z[i])
        mean, covariance = kalman.update(mean, covariance, z)
        for i, f in enumerate(filters):
            np.testing.assert_allclose(mean[i].T.ravel(), f.x[:, 0], rtol=1e-9, atol=1e-9)
            full = np.zeros((8, 8))
            for k in range(4):
                full[np.ix_([k, k + 4], [k, k + 4])] = covariance[i, k]
            np.testing.assert_allclose(full, f.P, rtol=1e-8, atol=1e-9)


def test_boxes_are_measured_and_given_back() -> None:
    boxes = np.array([[5.0, 6.0, 8.0, 4.0], [1.0, 2.0, 3.0, 9.0]])
    mean, _ = kalman.initiate(kalman.measurements_of(boxes))
    np.testing.assert_allclose(kalman.boxes_of(mean), boxes)


def test_steady_gate_is_about_a_quarter_of_the_height() -> None:
    """The published constants let a droplet stray 0.26 heights in one direction."""
    box = np.array([[100.0, 100.0, 40.0, 40.0]])
    z = kalman.measurements_of(box)
    mean, covariance = kalman.initiate(z)
    for _ in range(200):
        mean, covariance = kalman.update(*kalman.predict(mean, covariance), z)
    mean, covariance = kalman.predict(mean, covariance)
    shifts = np.arange(0, 40, 0.05)
    moved = np.repeat(z, len(shifts), axis=0)
    moved[:, 0] += shifts
    inside = kalman.gating_distance(mean, covariance, moved) < kalman.CHI_SQUARE_95[4]
    assert shifts[inside].max() / 40 == pytest.approx(0.26, abs=0.01)
