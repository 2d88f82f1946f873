"""Where tracks are expected in the next frame."""

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking import motion_filter
from droptrack.tracking.droplet.flow import Flow
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
MAX_DEVIATIONS = 2.0  # by which what is remembered may differ from the common step
FIRST_DEVIATION = 0.04  # diameters, of a new track's place


def predict(
    tracks: Tracks,
    boxes: Floats,
    noise: Noise,
    flow: Flow,
    p: DropletParameters,
    *,
    image: bool = True,
    flow_known: bool = False,
) -> Tracks:
    """All tracks one frame on; they count as missed until they are corrected.

    New and lost tracks go with the flow, of which the frame's boxes (M, 4) may tell. In a frame
    without an image, time passes, but nothing is unseen. `flow_known`: what is remembered of the
    flow counts more than what the last images have in common.
    """
    state = _with_flow(tracks, boxes, flow, p, flow_known) if p.flow else tracks.state
    return tracks.replaced(
        state=motion_filter.predict(state, noise.acceleration * tracks.diameters),
        missed=tracks.missed + 1,
        unseen=tracks.unseen + int(image),
        frames=tracks.frames + 1,
        images=tracks.images + int(image),
    )


def detection_variance(state: KinematicState, diameters: Floats, noise: Noise) -> Floats:
    """Variance (N,) of a detection about its prediction, in squared diameters."""
    variance = state.covariance[:, 0] + (noise.centre * diameters) ** 2
    return np.asarray(np.maximum(variance, (MIN_DEVIATION * diameters) ** 2) / diameters**2)


def _with_flow(
    tracks: Tracks, boxes: Floats, flow: Flow, p: DropletParameters, flow_known: bool
) -> KinematicState:
    """States with what the flow tells of the velocities of new tracks and of lost ones."""
    new, seen = tracks.hits == 1, tracks.missed == 0
    if seen.all() and not new.any():
        return tracks.state
    diameters, state = tracks.diameters, tracks.state
    remembered = np.zeros(len(tracks), bool)
    if new.any() and (flow.images or p.expect_velocity is not None):
        state, remembered = _with_remembered_flow(tracks, np.flatnonzero(new), flow, p, flow_known)
        new = new & ~remembered
    rows = np.concatenate([np.flatnonzero(new), np.flatnonzero(~seen & ~new & ~remembered)])
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
        tracks, seen, rows[~has_flow & is_new & seen[rows]], boxes, p.max_step
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


def _with_remembered_flow(
    tracks: Tracks, new: Rows, flow: Flow, p: DropletParameters, flow_known: bool
) -> tuple[KinematicState, Bools]:
    """States with velocities of new tracks as droplets had that passed there before, and of whom.

    Without such droplets, with the velocity that is expected, or that all boxes have in common.
    """
    position, diameters = tracks.last_position[new], tracks.diameters[new]
    mean, variance = flow.velocity_at(position, diameters)
    variance = variance + (flow.deviation * diameters) ** 2
    step = None if p.expect_velocity is None else np.array(p.expect_velocity, float)
    if step is None and (common := flow.common_step(float(np.median(diameters)))) is not None:
        step = common.velocity
    if step is None:
        unknown = variance > (p.unknown_step * diameters) ** 2
    else:
        deviation = PATTERN_DEVIATION * diameters
        other = np.isinf(variance)
        if not flow_known:
            likely = MAX_DEVIATIONS * np.maximum(deviation, np.sqrt(variance))
            other |= np.hypot(*(mean - step).T) > likely
        mean[other], variance[other] = step, deviation[other] ** 2
        unknown = np.zeros(len(new), bool)
    frames = tracks.missed[new]  # since it was seen
    # of a step that nothing tells, the length does not grow with the frames that are missed
    rest = (p.unknown_step * diameters / np.maximum(frames, 1)) ** 2
    mean[unknown], variance[unknown] = 0, rest[unknown]
    at, velocity = tracks.state.position.copy(), tracks.state.velocity.copy()
    covariance = tracks.state.covariance.copy()
    at[new] = tracks.last_position[new] + frames[:, None] * mean
    velocity[new] = mean
    noise = (FIRST_DEVIATION * tracks.diameters[new]) ** 2
    covariance[new] = np.column_stack([noise + frames**2 * variance, frames * variance, variance])
    told = np.zeros(len(tracks), bool)
    told[new[~unknown]] = True
    return KinematicState(at, velocity, covariance), told


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
