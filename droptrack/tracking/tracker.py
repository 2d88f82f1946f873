"""What every tracker does: detections of a frame in, the identity of each of them out."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Update:
    """What one frame did.

    track_ids (M,): the track of each detection, from 1; confirmed: tracks that are droplets from
    now on, their earlier detections too; ended: tracks that will not be seen again; joined: pairs
    of a track, not confirmed before, and the older one that it turned out to continue, whose
    identity it has from this frame on.
    """

    track_ids: NDArray[np.int64]
    confirmed: tuple[int, ...]
    ended: tuple[int, ...]
    joined: tuple[tuple[int, int], ...] = ()


class Tracker(Protocol):
    """Follows droplets; `update` is called for each frame, also for those without detections."""

    @property
    def max_age(self) -> int:
        """Frames that a droplet may be missed and still be the same."""

    @property
    def n_init(self) -> int:
        """Detections that make a droplet."""

    @property
    def delay(self) -> int:
        """Frames after a droplet's first detection by which it is confirmed or joined, or ended."""

    def update(self, boxes: NDArray[np.float64], descriptors: NDArray[np.float64]) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D)."""
