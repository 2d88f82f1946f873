"""Positions that move at a nearly constant velocity: a Kalman filter, for all tracks at once.

The two coordinates are alike and do not mix, so that a state is a position (N, 2) and a velocity
(N, 2) a frame with one covariance for both coordinates: (N, 3), the variance of the position, the
covariance of position and velocity, the variance of the velocity. Accelerations are white noise
(Bar-Shalom, Li & Kirubarajan 2001, section 6.3.2, "discrete white noise acceleration").
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats

Selection = NDArray[np.int64] | NDArray[np.bool_] | slice


@dataclass(frozen=True)
class Motion:
    """States of N droplets: position (N, 2) px, velocity (N, 2) px a frame, covariance (N, 3)."""

    position: Floats
    velocity: Floats
    covariance: Floats

    def __getitem__(self, rows: Selection) -> "Motion":
        return Motion(self.position[rows], self.velocity[rows], self.covariance[rows])

    def __setitem__(self, rows: Selection, values: "Motion") -> None:
        self.position[rows] = values.position
        self.velocity[rows] = values.velocity
        self.covariance[rows] = values.covariance


def squares(vectors: Floats) -> Floats:
    """Squared lengths (N,) of vectors (N, 2)."""
    x, y = vectors.T  # a sum along so short an axis takes longer than all else
    return np.asarray(x * x + y * y)


def predict(state: Motion, acceleration: Floats) -> Motion:
    """One frame on; `acceleration` (N,): its standard deviation, px a frame²."""
    p, c, v = state.covariance.T
    q = acceleration**2
    spread = np.array([p + 2 * c + v + q / 4, c + v + q / 2, v + q])
    return Motion(state.position + state.velocity, state.velocity, spread.T)


def update(state: Motion, measured: Floats, noise: Floats) -> Motion:
    """Correct predictions with positions (N, 2); `noise` (N,): their standard deviation, px."""
    p, c, v = state.covariance.T
    innovation = measured - state.position
    gain_p, gain_v = p / (p + noise**2), c / (p + noise**2)
    spread = np.array([(1 - gain_p) * p, (1 - gain_p) * c, v - gain_v * c])
    return Motion(
        state.position + gain_p[:, None] * innovation,
        state.velocity + gain_v[:, None] * innovation,
        spread.T,
    )


def jump(state: Motion, measured: Floats) -> Motion:
    """Correct predictions with positions (N, 2) much too far off, as likely wrong as right.

    Mean and covariance of both cases: nothing was measured, or the droplet has jumped there and
    its velocity has changed by as much, as in a plastic event.
    """
    half = (measured - state.position) / 2
    between = (half**2).sum(axis=1, keepdims=True) / 2  # a coordinate
    return Motion(state.position + half, state.velocity + half, state.covariance + between)


def smooth(filtered: Motion, predicted: Motion, later: Motion) -> Motion:
    """One step back of Rauch, Tung & Striebel (1965).

    `filtered`: the states of a frame; `predicted`: those that the filter expected for the next
    frame; `later`: the smoothed states of that next frame.
    """
    p, c, v = filtered.covariance.T
    pp, pc, pv = predicted.covariance.T
    # the gain is P F' P_next^-1 with F = [[1, 1], [0, 1]]
    determinant = pp * pv - pc**2
    a, b = p + c, c  # rows of P F'
    d, e = c + v, v
    g00, g01 = (a * pv - b * pc) / determinant, (b * pp - a * pc) / determinant
    g10, g11 = (d * pv - e * pc) / determinant, (e * pp - d * pc) / determinant
    dx = later.position - predicted.position
    dv = later.velocity - predicted.velocity
    dp, dc, dw = (later.covariance - predicted.covariance).T
    spread = np.array(
        [
            p + g00 * g00 * dp + 2 * g00 * g01 * dc + g01 * g01 * dw,
            c + g00 * g10 * dp + (g00 * g11 + g01 * g10) * dc + g01 * g11 * dw,
            v + g10 * g10 * dp + 2 * g10 * g11 * dc + g11 * g11 * dw,
        ]
    )
    return Motion(
        filtered.position + g00[:, None] * dx + g01[:, None] * dv,
        filtered.velocity + g10[:, None] * dx + g11[:, None] * dv,
        spread.T,
    )
