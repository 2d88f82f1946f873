"""What can be set of the droplet tracker."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DropletParameters:
    """Lengths are in droplet diameters, times in frames. The switches are there to be measured."""

    max_step: float = 2.5  # how far a droplet may move in its track's first frame
    unknown_step: float = 0.5  # standard deviation of the first step where there is no flow
    noise: float = 0.04  # standard deviation of a box's centre, at first; it is learned
    acceleration: float = 0.05  # standard deviation, at first; it is learned
    size_noise: float = 0.15  # of the logarithm of width and height, at first; it is learned
    max_age: int = 20  # frames that a droplet may be missed
    short_gap: int = 6  # of them, those after which one detection is enough to find it again
    n_init: int = 3  # detections that confirm a track
    appearance: float = 0.0  # cost of a cosine distance of one
    flow: bool = True  # velocities that are not known are those of the neighbours
    expect_velocity: tuple[float, float] | None = None  # px a frame, where nothing is known yet
    size: bool = True  # sizes count
    jointly: bool = True  # one assignment of all; else each pair in turn, the best first
    both_ways: bool = True  # lost tracks are merged with new ones, as seen from both ends of a gap
    learn_noise: bool = True
    duplicates: bool = True  # a new box on a droplet that has one waits
