"""How noisy detections and motions are, learned from how far off predictions are.

Innovations, detections less their predictions, should be as large as the filter expects, and of a
good filter they are white (Mehra 1970): those that agree with the ones before tell of motion, those
that alternate of noise in the detections.
"""

from dataclasses import dataclass
from math import exp, log

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.tracking.motion_filter import squares

NOISE_RANGE = (0.01, 0.25)  # diameters
SIZE_NOISE_RANGE = (0.05, 0.5)
ACCELERATION_RANGE = (0.01, 0.2)  # diameters a frame²
FEWEST_FALSE = 1e-3
LEARNING = 0.05  # share of a frame in what is learned


@dataclass
class Noise:
    """Standard deviations, and the density of false boxes, as known so far."""

    centre: float  # of a box's centre, diameters
    acceleration: float  # diameters a frame²
    size: float  # of the logarithm of width and height
    false_density: float = FEWEST_FALSE  # unexpected boxes a squared diameter
    lessons: int = 0  # frames learned from,
    lessons_of_false: int = 0  # and those in which there were droplets

    def learn(self, innovation: Floats, before: Floats, variance: Floats, change: Floats) -> None:
        """Learn from N droplets that are followed well.

        `innovation`, `before` (N, 2): of this detection and of the one before, in diameters;
        `variance` (N,): of the prediction, diameters²; `change` (N, 2): of the logarithm of width
        and height.
        """
        square = squares(innovation)
        size = median(square / (variance + self.centre**2)) / (2 * log(2))
        power = float(np.minimum(square, 1).sum())
        (x, y), (x_before, y_before) = innovation.T, before.T
        agreement = np.minimum(np.maximum(x * x_before + y * y_before, -1), 1)
        memory = float(agreement.sum()) / max(power, 1e-12 * len(square))
        self.lessons += 1
        weight = max(LEARNING, 1 / (1 + self.lessons)) * min(1.0, len(innovation) / 10)
        grow = weight * _within(log(max(size, 1e-6)), (-2, 2)) / 2
        turn = weight * _within(memory, (-1, 1)) / 2
        change_size = median(squares(change)) / (2 * log(2))
        ratio = log(max(change_size, 1e-6) / self.size**2) / 2
        more = weight * _within(ratio, (-1, 1))
        self.size = _within(self.size * exp(more), SIZE_NOISE_RANGE)
        self.centre = _within(self.centre * exp(grow - turn), NOISE_RANGE)
        self.acceleration = _within(self.acceleration * exp(grow + turn), ACCELERATION_RANGE)

    def learn_false(self, density: float) -> None:
        """Learn from a frame's false boxes a squared diameter."""
        self.lessons_of_false += 1
        weight = max(LEARNING, 1 / (1 + self.lessons_of_false))
        self.false_density += weight * (max(density, FEWEST_FALSE) - self.false_density)


def median(values: Floats) -> float:
    """Of numbers (N,), one at least. NumPy's own takes ten times as long for 50."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    low, high = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float((low + high) / 2)


def _within(value: float, limits: tuple[float, float]) -> float:
    return float(min(max(value, limits[0]), limits[1]))
