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

CENTRE_RANGE = (0.01, 0.25)  # diameters
SIZE_RANGE = (0.05, 0.5)
ACCELERATION_RANGE = (0.01, 0.2)  # diameters a frame²
MIN_FALSE_DENSITY = 1e-3
LEARNING_RATE = 0.05  # share of a frame in what is learned
FULL_WEIGHT = 10  # droplets; a frame with fewer counts for less
MAX_LOG_RATIO = 2.0  # of the variance of innovations to the expected one, in a frame
MAX_LOG_SIZE_RATIO = 1.0  # the same of sizes, of standard deviations
MAX_INNOVATION_SQUARE = 1.0  # squared diameters; more counts as this
MIN_POWER = 1e-12  # mean square of innovations, squared diameters
MIN_VARIANCE = 1e-6  # so that there is a logarithm
MEDIAN_CHI_SQUARE = 2 * log(2)  # with two degrees of freedom


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Standard deviations of detections and motions, as known so far."""

    centre: float  # of a box's centre, diameters
    acceleration: float  # diameters a frame²
    size: float  # of the logarithm of width and height
    lessons: int = 0  # frames from which they were learned

    def learned(
        self, innovation: Floats, before: Floats, variance: Floats, change: Floats
    ) -> "Noise":
        """As known after a frame with N droplets that are tracked well.

        `innovation`, `before` (N, 2): of this detection and of the one before, in diameters;
        `variance` (N,): of the prediction, diameters²; `change` (N, 2): of the logarithm of width
        and height.
        """
        square = squares(innovation)
        size = median(square / (variance + self.centre**2)) / MEDIAN_CHI_SQUARE
        whiteness = _autocorrelation(innovation, before, square)
        lessons = self.lessons + 1
        weight = max(LEARNING_RATE, 1 / (1 + lessons)) * min(1.0, len(innovation) / FULL_WEIGHT)
        log_ratio = log(max(size, MIN_VARIANCE))
        grow = weight * _within(log_ratio, (-MAX_LOG_RATIO, MAX_LOG_RATIO)) / 2
        turn = weight * _within(whiteness, (-1, 1)) / 2
        change_size = median(squares(change)) / MEDIAN_CHI_SQUARE
        log_size_ratio = log(max(change_size, MIN_VARIANCE) / self.size**2) / 2
        more = weight * _within(log_size_ratio, (-MAX_LOG_SIZE_RATIO, MAX_LOG_SIZE_RATIO))
        return Noise(
            centre=_within(self.centre * exp(grow - turn), CENTRE_RANGE),
            acceleration=_within(self.acceleration * exp(grow + turn), ACCELERATION_RANGE),
            size=_within(self.size * exp(more), SIZE_RANGE),
            lessons=lessons,
        )


@dataclass(frozen=True)
class FalseBoxes:
    """How dense boxes are that are no droplets, as known so far."""

    density: float = MIN_FALSE_DENSITY  # boxes a squared diameter
    lessons: int = 0  # frames from which it was learned

    def learned(self, density: float) -> "FalseBoxes":
        """As known after a frame with this density."""
        lessons = self.lessons + 1
        weight = max(LEARNING_RATE, 1 / (1 + lessons))
        excess = max(density, MIN_FALSE_DENSITY) - self.density
        return FalseBoxes(self.density + weight * excess, lessons)


def median(values: Floats) -> float:
    """Of numbers (N,), one at least. NumPy's own takes ten times as long for 50."""
    middle, ordered = len(values) // 2, values.copy()
    ordered.partition(middle)
    if len(values) % 2:
        return float(ordered[middle])
    return float((ordered[:middle].max() + ordered[middle]) / 2)


def _autocorrelation(innovation: Floats, before: Floats, square: Floats) -> float:
    """Of innovations (N, 2), with squares (N,), and those before; 0 if they are white."""
    limit = MAX_INNOVATION_SQUARE
    power = float(np.minimum(square, limit).sum())
    (x, y), (x_before, y_before) = innovation.T, before.T
    agreement = np.minimum(np.maximum(x * x_before + y * y_before, -limit), limit)
    return float(agreement.sum()) / max(power, MIN_POWER * len(square))


def _within(value: float, limits: tuple[float, float]) -> float:
    return float(min(max(value, limits[0]), limits[1]))
