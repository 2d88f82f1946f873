"""Which tracker: the one made for droplets, or DeepSORT."""

from dataclasses import asdict, replace
from enum import StrEnum
from pathlib import Path

from droptrack.data.report import Value
from droptrack.tracking import deepsort
from droptrack.tracking.appearance import Describe, describe, describe_nothing
from droptrack.tracking.appearance_network import NetworkAppearance
from droptrack.tracking.deepsort import Parameters
from droptrack.tracking.droplet_tracker import DropletParameters, DropletTracker
from droptrack.tracking.tracker import Tracker

APPEARANCE = 10.0  # cost of a cosine distance of one


class TrackerName(StrEnum):
    """The trackers there are."""

    droplet = "droplet"
    deepsort = "deepsort"


def make_tracker(
    name: TrackerName,
    deepsort_parameters: Parameters,
    *,
    max_age: int | None = None,
    n_init: int | None = None,
    by_appearance: bool = False,
) -> tuple[Tracker, dict[str, Value]]:
    """A tracker, and its settings for the report.

    `max_age` and `n_init` take the place of the chosen tracker's own; the rest of
    `deepsort_parameters` is DeepSORT's alone. `by_appearance`: the droplet tracker looks at the
    descriptors, which DeepSORT always does.
    """
    if name == TrackerName.deepsort:
        p = deepsort_parameters
        p = replace(p, max_age=max_age or p.max_age, n_init=n_init or p.n_init)
        return deepsort.Tracker(p), asdict(p)
    own = DropletParameters(appearance=APPEARANCE if by_appearance else 0.0)
    own = replace(own, max_age=max_age or own.max_age, n_init=n_init or own.n_init)
    return DropletTracker(own), asdict(own)


def choose_appearance(
    tracker: TrackerName, network: Path | None, weights: Path | None, size: tuple[int, int]
) -> Describe:
    """What describes droplets for a tracker: a network of the user's, else grey levels and size.

    Nothing for the droplet tracker without such a network, which does not look then.
    """
    if network is not None:
        return NetworkAppearance(network, weights, size)
    return describe if tracker is TrackerName.deepsort else describe_nothing
