"""Droplets that were in view but not seen, before their first box and after their last one.

A droplet whose first box lies a step and more behind the place where others are first seen was
there in the image before, and was missed. Only where droplets are few is the flow remembered, and
enough known to tell.
"""

from collections.abc import Iterator, Sequence
from math import erfc, log, sqrt

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.tracking.droplet.flow import Flow
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.droplet.passages import Passages
from droptrack.tracking.droplet.prediction import MIN_DEVIATION
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.tracker import LONG_GAP, Unseen

MAX_UNSEEN = LONG_GAP  # frames that are told of, at either end
MIN_BEYOND = 2  # droplets that were seen further out; one may have been false
LANE = 1.0  # diameters, across the flow, within which droplets are on the same way


def unseen_of(
    tracks: Tracks,
    ends: Sequence[tuple[int, int, int]],
    images: Sequence[bool],
    flow: Flow,
    passages: Passages,
    noise: Noise,
) -> Iterator[Unseen]:
    """Those frames next to the ends of tracks.

    `ends`: row, frames since that end, and -1 for the first box, 1 for the last; `images`: of the
    last frames until now, whether there is one.
    """
    for row, ago, way in ends:
        first = len(images) - 1 - ago + way
        frames = images[first::way] if first >= 0 else ()
        at = (tracks.last_position if way > 0 else tracks.first_position)[row]
        diameter = tracks.diameters[[row]]
        mean, variance = flow.velocity_at(at[None], diameter)
        if not frames or not np.isfinite(variance[0]) or not mean.any():
            continue
        deviation = sqrt(float(variance[0])) / float(diameter[0]) + flow.deviation
        step = way * mean[0] / diameter[0]
        places = passages.left if way > 0 else passages.entered
        beyond = _beyond(at, step, places, float(diameter[0]))
        length = float(np.hypot(*step))
        n = _frames_in_view(
            frames[:MAX_UNSEEN], beyond, length, deviation, passages.miss_rate, noise
        )
        missed = sum(frames[:n])
        inside = passages.probability_inside(missed * length * float(diameter[0]))
        if n and passages.miss_rate**missed > inside:
            yield Unseen(int(tracks.ids[row]), ago, way, n, (float(mean[0, 0]), float(mean[0, 1])))


def _beyond(at: Floats, step: Floats, places: Floats, diameter: float) -> float:
    """How far out from `at` (2,), along a step (2,), droplets were seen for sure, in diameters."""
    x, y = step / np.hypot(*step)
    off = (places - at) / diameter
    far = off @ np.array([x, y])
    same = np.abs(off @ np.array([-y, x])) < LANE
    return float(np.sort(far[same])[-MIN_BEYOND]) if same.sum() >= MIN_BEYOND else -np.inf


def _frames_in_view(
    frames: Sequence[bool],
    beyond: float,
    step: float,
    deviation: float,
    miss_rate: float,
    noise: Noise,
) -> int:
    """In how many frames, of those next to an end, a droplet was in view.

    `frames`: whether they have an image; `beyond` and `step`: diameters. Not being seen is more
    probable where it is out of view than where a detector misses it, so it must be well inside. A
    droplet that would be in view in all these frames has appeared, or gone, inside.
    """
    n, log_odds = 0, 0.0
    for k, image in enumerate(frames, 1):
        if not image:
            continue
        spread = sqrt(noise.centre**2 + MIN_DEVIATION**2 + (k * deviation) ** 2)
        outside = erfc((beyond - k * step) / spread / sqrt(2)) / 2
        log_odds = log(miss_rate * max(1 - outside, 1e-300)) - log(max(outside, 1e-300))
        if log_odds < 0:
            return n
        n = k
    return 0
