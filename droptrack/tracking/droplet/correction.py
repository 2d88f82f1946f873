"""What tracks learn from their detections."""

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.tracking import motion_filter
from droptrack.tracking.droplet.matching import Matches
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.prediction import detection_variance
from droptrack.tracking.droplet.tracks import Observations, Tracks, diameters_of
from droptrack.tracking.motion_filter import KinematicState, squares
from droptrack.tracking.row_selection import RowSelection, select

JUMP_SQUARE = 12.0  # in variances of a detection, from which on a box is wrong or a droplet jumped
SIZE_GAIN = 0.2  # of a new size, and a new descriptor, in a track's mean one
AREA_GAIN = 0.02  # of a new area in the track's mean area over a long time
MIN_STEADY_HITS = 4  # of a track from which noise is learned,
MIN_STEADY_TRACKS = 3  # and how many of them that takes


def correct(
    tracks: Tracks, found: Observations, matches: Matches, noise: Noise, p: DropletParameters
) -> tuple[Tracks, Noise]:
    """Predicted tracks with their detections of a frame, and the noise as known after it."""
    if not len(matches.rows):
        return tracks, noise
    rows, seen = RowSelection(matches.rows, len(tracks)), found[matches.columns]
    positions, diameters = seen.boxes[:, :2], rows.of(tracks.diameters)
    innovation = (positions - rows.of(tracks.state.position)) / diameters[:, None]
    change = seen.log_sizes - rows.of(tracks.log_sizes)
    if p.learn_noise:
        noise = _learn(noise, tracks, rows, innovation, change)
    predicted = tracks.state[rows.rows]
    state = _correct_state(predicted, positions, squares(innovation), diameters, noise)
    hits, nothing = rows.of(tracks.hits) + 1, np.zeros(len(matches.rows), np.int64)
    share = 1 / hits
    size_gain, area_gain = np.maximum(SIZE_GAIN, share)[:, None], np.maximum(AREA_GAIN, share)
    log_sizes = rows.of(tracks.log_sizes) + size_gain * change
    log_area = rows.of(tracks.log_area)
    log_area = log_area + area_gain * (np.log(seen.boxes[:, 2] * seen.boxes[:, 3]) - log_area)
    descriptors = tracks.descriptors
    if p.appearance:
        mean = (1 - size_gain) * rows.of(descriptors) + size_gain * seen.descriptors
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        descriptors = rows.replaced(descriptors, mean)
    corrected = tracks.replaced(
        hits=rows.replaced(tracks.hits, hits),
        missed=rows.replaced(tracks.missed, nothing),
        unseen=rows.replaced(tracks.unseen, nothing),
        evidence=rows.replaced(tracks.evidence, rows.of(tracks.evidence) + matches.evidence),
        log_sizes=rows.replaced(tracks.log_sizes, log_sizes),
        log_area=rows.replaced(tracks.log_area, log_area),
        diameters=rows.replaced(tracks.diameters, diameters_of(log_sizes)),
        last_position=rows.replaced(tracks.last_position, positions),
        innovation=rows.replaced(tracks.innovation, innovation),
        descriptors=descriptors,
        state=tracks.state.replaced(rows, state),
    )
    return corrected, noise


def _correct_state(
    predicted: KinematicState, positions: Floats, square: Floats, diameters: Floats, noise: Noise
) -> KinematicState:
    """States of K predicted tracks seen at positions (K, 2).

    `square` (K,): of their innovations, in squared diameters.
    """
    jumped = square > JUMP_SQUARE * detection_variance(predicted, diameters, noise)
    state = motion_filter.update(predicted, positions, noise.centre * diameters)
    if jumped.any():
        which = np.flatnonzero(jumped)
        after = motion_filter.jump(predicted[which], select(positions, which))
        state = state.replaced(RowSelection(which, len(jumped)), after)
    return state


def _learn(
    noise: Noise, tracks: Tracks, rows: RowSelection, innovation: Floats, change: Floats
) -> Noise:
    """The noise as learned from those tracks that have been seen for some frames without a gap.

    `innovation`, `change` (K, 2): of the tracks in `rows`.
    """
    often, before = rows.of(tracks.hits) >= MIN_STEADY_HITS, rows.of(tracks.missed) == 1
    steady = (often & before).nonzero()[0]
    if len(steady) < MIN_STEADY_TRACKS:
        return noise
    variance = rows.of(tracks.state.covariance)[:, 0] / rows.of(tracks.diameters) ** 2
    return noise.learned(
        select(innovation, steady),
        select(rows.of(tracks.innovation), steady),
        select(variance, steady),
        select(change, steady),
    )
