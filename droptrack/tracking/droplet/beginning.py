"""The first frames, tracked again where later ones show that a wrong velocity was believed.

Of two images alone, often several steps explain the droplets, in a train above all; three tell
more.
"""

from typing import NamedTuple

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.tracking.droplet.flow import MIN_SHARE, Flow
from droptrack.tracking.droplet.noise import median
from droptrack.tracking.droplet.prediction import MAX_DEVIATIONS, PATTERN_DEVIATION
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.tracker import Velocity

MAX_FRAMES = 24  # of the beginning
MIN_IMAGES = 3  # that can tell more than the first two


class FrameInput(NamedTuple):
    """What a tracker is given of a frame: see its `update`."""

    boxes: Floats
    descriptors: Floats
    image: bool


def other_velocity(tracks: Tracks, flow: Flow) -> Velocity | None:
    """The velocity that all images tell together, if most tracks began with another."""
    moving = tracks.hits > 1
    if len(flow.images) < MIN_IMAGES or not moving.any():
        return None
    diameter = median(tracks.diameters)
    common = flow.common_step(diameter)
    if common is None or (common.ambiguous and common.share < MIN_SHARE):
        return None
    off = np.hypot(*(tracks.state.velocity[moving] - common.velocity).T)
    if median(off) <= MAX_DEVIATIONS * PATTERN_DEVIATION * diameter:
        return None
    x, y = common.velocity.tolist()
    return x, y
