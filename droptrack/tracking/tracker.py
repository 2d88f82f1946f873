"""What every tracker does: detections of a frame in, the identity of each of them out."""

from dataclasses import dataclass
from typing import Protocol

from droptrack.data.arrays import Floats, Rows


@dataclass(frozen=True, kw_only=True)
class Update:
    """What one frame did.

    track_ids (M,): the track of each detection, from 1; confirmed: tracks that are droplets from
    now on, their earlier detections too; terminated: tracks that will not be seen again; merged:
    pairs of a track, not confirmed before, and the older one that it turned out to continue, whose
    identity it has from this frame on.
    """

    track_ids: Rows
    confirmed: tuple[int, ...] = ()
    terminated: tuple[int, ...] = ()
    merged: tuple[tuple[int, int], ...] = ()


class Tracker(Protocol):
    """Tracks droplets; `update` is called for each frame, also for those without detections."""

    @property
    def max_age(self) -> int:
        """Frames that a droplet may be missed and still be the same."""

    @property
    def n_init(self) -> int:
        """Detections that confirm a track."""

    @property
    def delay(self) -> int:
        """Frames after its first detection by which a track is confirmed, merged or terminated."""

    def update(self, boxes: Floats, descriptors: Floats) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D)."""


def check_descriptors(boxes: Floats, descriptors: Floats) -> None:
    """Raise ValueError unless there is a descriptor for each box."""
    if len(boxes) != len(descriptors):
        raise ValueError(f"{len(boxes)} boxes with {len(descriptors)} descriptors")
