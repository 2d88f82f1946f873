"""Where tracks are expected in the next frame."""

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking import motion_filter
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.motion_filter import KinematicState
from droptrack.tracking.neighbour_velocity import displacement_of_pattern, velocity_of_neighbours

MIN_DEVIATION = 0.08  # diameters, of a detection from its prediction
MIN_HITS = 3  # of a track whose velocity is one of the flow
MIN_PATTERN_SHARE = 0.5  # of neighbours that follow, for a pattern to be believed
# standard deviations of velocities, in diameters a frame
NEIGHBOURS_DEVIATION = 0.15  # of a new track from its neighbours' mean
PATTERN_DEVIATION = 0.2  # of a new track from its pattern's displacement
LOST_DEVIATION = 0.1  # of a lost track from its neighbours' mean


def predict(tracks: Tracks, boxes: Floats, noise: Noise, p: DropletParameters) -> Tracks:
    """All tracks one frame on; they count as missed until they are corrected.

    New and lost tracks go with the flow; where no velocity is known, it is found from the frame's
    boxes (M, 4).
    """
    state = _with_flow(tracks, boxes, p.max_step) if p.flow else tracks.state
    return tracks.replaced(
        state=motion_filter.predict(state, noise.acceleration * tracks.diameters),
        missed=tracks.missed + 1,
        frames=tracks.frames + 1,
    )


def detection_variance(state: KinematicState, diameters: Floats, noise: Noise) -> Floats:
    """Variance (N,) of a detection about its prediction, in squared diameters."""
    variance = state.covariance[:, 0] + (noise.centre * diameters) ** 2
    return np.asarray(np.maximum(variance, (MIN_DEVIATION * diameters) ** 2) / diameters**2)


def _with_flow(tracks: Tracks, boxes: Floats, max_step: float) -> KinematicState:
    """States with the velocities of new and lost tracks corrected by the flow around them."""
    new, seen = tracks.hits == 1, tracks.missed == 0
    if seen.all() and not new.any():
        return tracks.state
    diameters, state = tracks.diameters, tracks.state
    rows = np.concatenate([np.flatnonzero(new), np.flatnonzero(~seen & ~new)])
    known = (tracks.hits >= MIN_HITS) & seen
    mean, variance = velocity_of_neighbours(
        state.position[rows], diameters[rows], state.position[known], state.velocity[known]
    )
    has_flow, is_new = np.isfinite(variance), new[rows]
    velocity, covariance = state.velocity.copy(), state.covariance.copy()

    at = has_flow & is_new
    some, deviation = rows[at], NEIGHBOURS_DEVIATION * diameters[rows[at]]
    velocity[some] = mean[at]
    covariance[some, 2] = variance[at] + deviation**2

    some, steps = _steps_of_pattern(
        tracks, seen, rows[~has_flow & is_new & seen[rows]], boxes, max_step
    )
    velocity[some] = steps
    covariance[some, 2] = (PATTERN_DEVIATION * diameters[some]) ** 2

    # the flow is one more measurement of the velocity of lost tracks
    at = has_flow & ~is_new
    some, deviation = rows[at], LOST_DEVIATION * diameters[rows[at]]
    gain = covariance[some, 2] / (covariance[some, 2] + (variance[at] + deviation**2))
    velocity[some] += gain[:, None] * (mean[at] - velocity[some])
    covariance[some, 2] *= 1 - gain
    covariance[some, 1] *= 1 - gain
    return KinematicState(state.position, velocity, covariance)


def _steps_of_pattern(
    tracks: Tracks, seen: Bools, rows: Rows, boxes: Floats, max_step: float
) -> tuple[Rows, Floats]:
    """Those of some tracks whose pattern is found again, and their displacements (R, 2).

    `seen` (N,): the tracks that make the patterns, the ones in question among them.
    """
    steps, share = displacement_of_pattern(
        tracks.state.position[seen],
        tracks.diameters[seen],
        np.searchsorted(np.flatnonzero(seen), rows),
        boxes[:, :2],
        max_step,
    )
    believed = share > MIN_PATTERN_SHARE
    return rows[believed], steps[believed]
