"""Positions that move at a nearly constant velocity: a Kalman filter, for all tracks at once.

The two coordinates are alike and do not mix, so that a state is a position (N, 2) and a velocity
(N, 2) a frame with one covariance for both coordinates: (N, 3), the variance of the position, the
covariance of position and velocity, the variance of the velocity. Accelerations are white noise
(Bar-Shalom, Li & Kirubarajan 2001, section 6.3.2, "discrete white noise acceleration").
"""

from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.tracking.row_selection import RowSelection, Selection, select


@dataclass(frozen=True)
class KinematicState:
    """States of N droplets: position (N, 2) px, velocity (N, 2) px a frame, covariance (N, 3)."""

    position: Floats
    velocity: Floats
    covariance: Floats

    def __getitem__(self, rows: Selection) -> "KinematicState":
        return KinematicState(
            select(self.position, rows), select(self.velocity, rows), select(self.covariance, rows)
        )

    def followed_by(self, others: "KinematicState") -> "KinematicState":
        """Both, these first."""
        return KinematicState(
            np.concatenate([self.position, others.position]),
            np.concatenate([self.velocity, others.velocity]),
            np.concatenate([self.covariance, others.covariance]),
        )

    def replaced(self, rows: RowSelection, values: "KinematicState") -> "KinematicState":
        """With other values in some rows."""
        return KinematicState(
            rows.replaced(self.position, values.position),
            rows.replaced(self.velocity, values.velocity),
            rows.replaced(self.covariance, values.covariance),
        )


def squares(vectors: Floats) -> Floats:
    """Squared lengths (N,) of vectors (N, 2)."""
    x, y = vectors[:, 0], vectors[:, 1]  # a sum along so short an axis takes longer than all else
    return np.asarray(x * x + y * y)


def predict(state: KinematicState, acceleration: Floats) -> KinematicState:
    """One frame on; `acceleration` (N,): its standard deviation, px a frame²."""
    p, c, v = state.covariance.T
    q = acceleration**2
    spread = np.array([p + 2 * c + v + q / 4, c + v + q / 2, v + q])
    return KinematicState(state.position + state.velocity, state.velocity, spread.T)


def update(state: KinematicState, measured: Floats, noise: Floats) -> KinematicState:
    """Correct predictions with positions (N, 2); `noise` (N,): their standard deviation, px."""
    p, c, v = state.covariance.T
    innovation, variance = measured - state.position, p + noise**2
    gain_p, gain_v = p / variance, c / variance
    rest = 1 - gain_p
    spread = np.array([rest * p, rest * c, v - gain_v * c])
    return KinematicState(
        state.position + gain_p[:, None] * innovation,
        state.velocity + gain_v[:, None] * innovation,
        spread.T,
    )


def jump(state: KinematicState, measured: Floats) -> KinematicState:
    """Correct predictions with positions (N, 2) much too far off, as likely wrong as right.

    Mean and covariance of both cases: nothing was measured, or the droplet has jumped there and
    its velocity has changed by as much, as in a plastic event.
    """
    half = (measured - state.position) / 2
    between = (half**2).sum(axis=1, keepdims=True) / 2  # a coordinate
    return KinematicState(state.position + half, state.velocity + half, state.covariance + between)


def smooth(
    filtered: KinematicState, predicted: KinematicState, later: KinematicState
) -> KinematicState:
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
    return KinematicState(
        filtered.position + g00[:, None] * dx + g01[:, None] * dv,
        filtered.velocity + g10[:, None] * dx + g11[:, None] * dv,
        spread.T,
    )
