"""What every tracker does: detections of a frame in, the identity of each of them out."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from droptrack.data.arrays import Floats, Rows

LONG_GAP = 3  # frames; a longer one is reported
Velocity = tuple[float, float]  # px a frame


class Resumption(NamedTuple):
    """A droplet that is seen again: its track, how sure that is, and whether it went backwards.

    `confidence`: the probability that it is the same, from 0 to 1; NaN where nobody knows it.
    `against_flow`: the others there go the other way.
    """

    track_id: int
    confidence: float
    against_flow: bool


class Unseen(NamedTuple):
    """A droplet that was in view but not seen, next to its first box or after its last one.

    `ago`: frames since that box; `way`: -1 if it was the first one, 1 if it was the last;
    `n_frames` further that way it was in view; `velocity`: there.
    """

    track_id: int
    ago: int
    way: int
    n_frames: int
    velocity: Velocity


@dataclass(frozen=True, kw_only=True)
class Update:
    """What one frame did.

    track_ids (M,): the track of each detection, from 1; confirmed: tracks that are droplets from
    now on, their earlier detections too; terminated: tracks that will not be seen again; merged:
    pairs of a track, not confirmed before, and the older one that it turned out to continue, whose
    identity it has from this frame on; resumed: droplets seen again after a long gap, in tracks as
    they are named after `merged`; unseen: droplets that turned out to have been in view before
    their first box, or after their last; again: what all frames until this one did, from the first
    with a box on, in place of what was said then; they are `delay` at most.
    """

    track_ids: Rows
    confirmed: tuple[int, ...] = ()
    terminated: tuple[int, ...] = ()
    merged: tuple[tuple[int, int], ...] = ()
    resumed: tuple[Resumption, ...] = ()
    unseen: tuple[Unseen, ...] = ()
    again: "tuple[Update, ...]" = ()


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

    @property
    def possible_velocities(self) -> tuple[Velocity, ...]:
        """Velocities that explain all images alike, the one believed first; none if one does."""

    def update(self, boxes: Floats, descriptors: Floats, *, image: bool | None = None) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D).

        `image`: whether there is an image of the frame, in which droplets can be missed; None where
        nobody knows.
        """

    def finish(self) -> Update:
        """What is known once the last frame has been seen; it has no detections."""


def check_descriptors(boxes: Floats, descriptors: Floats) -> None:
    """Raise ValueError unless there is a descriptor for each box."""
    if len(boxes) != len(descriptors):
        raise ValueError(f"{len(boxes)} boxes with {len(descriptors)} descriptors")
