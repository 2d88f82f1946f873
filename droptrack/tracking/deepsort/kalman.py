"""DeepSORT's Kalman filter of boxes, for all tracks at once.

A box is measured as [cx, cy, a, h], a = w / h, and each of these moves at its own constant rate.
All noises are diagonal, so the four filters do not mix: a mean is (N, 4, 2), value and rate a
frame, and a covariance (N, 4, 2, 2). The standard deviations are those of Wojke et al. 2017
(DeepSORT), in proportion to the height.
"""

import numpy as np

from droptrack.data.arrays import Floats

# standard deviations in heights
POSITION_WEIGHT = 1 / 20
VELOCITY_WEIGHT = 1 / 160
FIRST_POSITION_WEIGHT = 2 * POSITION_WEIGHT
FIRST_VELOCITY_WEIGHT = 10 * VELOCITY_WEIGHT
# standard deviations of the aspect ratio
ASPECT = 1e-2
ASPECT_RATE = 1e-5
ASPECT_MEASURED = 1e-1
# for cx, cy, a, h: factors of the height, and what is added for the aspect ratio
OF_HEIGHT = np.array([1.0, 1.0, 0.0, 1.0])
OF_ASPECT = np.array([0.0, 0.0, 1.0, 0.0])

# squared Mahalanobis distance that 95 % of the true measurements stay below, by degrees of freedom
CHI_SQUARE_95 = {2: 5.9915, 4: 9.4877}


def measurements_of(boxes: Floats) -> Floats:
    """Boxes (N, 4) [cx, cy, w, h] -> measurements (N, 4) [cx, cy, w / h, h]."""
    return np.column_stack([boxes[:, :2], boxes[:, 2] / boxes[:, 3], boxes[:, 3]])


def boxes_of(mean: Floats) -> Floats:
    """Means (N, 4, 2) -> boxes (N, 4) [cx, cy, w, h]."""
    cx, cy, aspect, height = mean[:, :, 0].T
    return np.column_stack([cx, cy, aspect * height, height])


def initiate(measurements: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of new tracks from their first measurements (N, 4), at rest."""
    height = measurements[:, 3]
    mean = np.stack([measurements, np.zeros_like(measurements)], axis=2)
    covariance = np.zeros((len(measurements), 4, 2, 2))
    covariance[..., 0, 0] = _deviations(height, FIRST_POSITION_WEIGHT, ASPECT) ** 2
    covariance[..., 1, 1] = _deviations(height, FIRST_VELOCITY_WEIGHT, ASPECT_RATE) ** 2
    return mean, covariance


def predict(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """One frame on."""
    height = mean[:, 3, 0]
    moved = mean.copy()
    moved[..., 0] += mean[..., 1]
    p, c, v = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    spread = np.empty_like(covariance)
    spread[..., 0, 0] = p + 2 * c + v + _deviations(height, POSITION_WEIGHT, ASPECT) ** 2
    spread[..., 0, 1] = spread[..., 1, 0] = c + v
    spread[..., 1, 1] = v + _deviations(height, VELOCITY_WEIGHT, ASPECT_RATE) ** 2
    return moved, spread


def update(mean: Floats, covariance: Floats, measurements: Floats) -> tuple[Floats, Floats]:
    """Correct predictions with their measurements (N, 4)."""
    innovation = measurements - mean[..., 0]
    gain = covariance[..., 0] / innovation_variance(mean, covariance)[..., None]  # (N, 4, 2)
    corrected = mean + gain * innovation[..., None]
    return corrected, covariance - gain[..., :, None] * covariance[..., None, 0, :]


def innovation_variance(mean: Floats, covariance: Floats) -> Floats:
    """Variances (N, 4) of a measurement about its prediction."""
    noise = _deviations(mean[:, 3, 0], POSITION_WEIGHT, ASPECT_MEASURED) ** 2
    return np.asarray(covariance[..., 0, 0] + noise)


def gating_distance(mean: Floats, covariance: Floats, measurements: Floats) -> Floats:
    """Squared Mahalanobis distances (N,) of measurements (N, 4) from N predictions."""
    variance = innovation_variance(mean, covariance)
    return np.asarray(((measurements - mean[:, :, 0]) ** 2 / variance).sum(axis=1))


def _deviations(height: Floats, weight: float, of_aspect: float) -> Floats:
    """Standard deviations (N, 4) of cx, cy, a, h: `weight` heights, and `of_aspect` for a."""
    return np.asarray(weight * height[:, None] * OF_HEIGHT + of_aspect * OF_ASPECT)
