"""Droplets that are seen again after a long gap: how sure that is, and whether the flow agrees."""

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.droplet.flow import Flow
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.neighbour_velocity import velocity_of_neighbours
from droptrack.tracking.tracker import LONG_GAP, Resumption

MIN_HITS = 3  # of a track whose velocity is one of the flow
MIN_WAY = 0.5  # diameters: what is shorter is in no direction


def resumptions(
    tracks: Tracks, rows: Rows, ends: Floats, frames: Rows, log_odds: Floats, flow: Flow
) -> tuple[Resumption, ...]:
    """Those of the lost tracks in `rows` (K,) whose gap is long.

    They are seen again at `ends` (K, 2), px, after a number of `frames` (K,) without a detection.
    `log_odds` (K,): natural, that they are the same; NaN where nothing tells.
    """
    long = frames > LONG_GAP
    if not long.any():
        return ()
    rows, ends, frames, log_odds = rows[long], ends[long], frames[long], log_odds[long]
    confidence = 1 / (1 + np.exp(-np.clip(log_odds, -50, 50)))
    against = _against_flow(tracks, rows, ends, frames, flow)
    return tuple(
        Resumption(*one)
        for one in zip(
            tracks.ids[rows].tolist(), confidence.tolist(), against.tolist(), strict=True
        )
    )


def _against_flow(
    tracks: Tracks, rows: Rows, ends: Floats, frames: Rows, flow: Flow
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether tracks (K,) go backwards in their gaps.

    Compared with other droplets of this frame and those that are remembered; where these are too
    few, with how they went themselves before.
    """
    known = (tracks.hits >= MIN_HITS) & (tracks.missed <= 1)
    known[rows] = False
    start, diameters = tracks.last_position[rows], tracks.diameters[rows]
    velocity, variance = velocity_of_neighbours(
        (start + ends) / 2,
        diameters,
        np.concatenate([tracks.state.position[known], flow.positions]),
        np.concatenate([tracks.state.velocity[known], flow.velocities]),
    )
    alone = np.isinf(variance)
    velocity[alone] = tracks.state.velocity[rows][alone]
    expected = velocity * (frames[:, None] + 1)
    way, least = ends - start, MIN_WAY * diameters
    far = (np.hypot(*way.T) > least) & (np.hypot(*expected.T) > least)
    return np.asarray(far & ((way * expected).sum(axis=1) < 0))
