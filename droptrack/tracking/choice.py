"""Which tracker: the one made for droplets, or DeepSORT."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from math import isfinite
from pathlib import Path

from droptrack.data.report import Value
from droptrack.errors import DroptrackError
from droptrack.tracking.appearance import DescriptorExtractor, describe, describe_nothing
from droptrack.tracking.appearance_network import NetworkAppearance
from droptrack.tracking.deepsort.tracker import DeepSortParameters, DeepSortTracker
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracker import DropletTracker
from droptrack.tracking.tracker import Tracker

APPEARANCE_COST = (
    10.0  # of a droplet tracker that compares descriptors: cost of a cosine distance of one
)
REPORTED_AS = {"duplicates": "second_boxes"}  # names that reports have had from the first


class TrackerName(StrEnum):
    """All trackers."""

    droplet = "droplet"
    deepsort = "deepsort"


@dataclass(frozen=True, kw_only=True)
class TrackerConfig:
    """Which tracker, and what to change of its settings.

    `max_age`: frames that a droplet may be missed; `n_init`: detections that confirm a droplet;
    without, the chosen tracker's own. `max_cosine_distance`, `nn_budget` and `max_iou_distance` are
    DeepSORT's (`DeepSortParameters`). `appearance`: a network that tells droplets apart, an .onnx
    file or a Darknet .cfg with its `appearance_weights`; `appearance_size`: width and height of its
    input, px. `expect_velocity`: px a frame, of droplets that enter where none is known, for the
    droplet tracker.
    """

    name: TrackerName = TrackerName.droplet
    max_age: int | None = None
    n_init: int | None = None
    expect_velocity: tuple[float, float] | None = None
    max_cosine_distance: float = DeepSortParameters.max_cosine_distance
    nn_budget: int = DeepSortParameters.nn_budget
    max_iou_distance: float = DeepSortParameters.max_iou_distance
    appearance: Path | None = None
    appearance_weights: Path | None = None
    appearance_size: tuple[int, int] = (64, 64)


def parse_velocity(text: str) -> tuple[float, float]:
    """``24,-1.5`` as px a frame in x and y; raises DroptrackError for another text.

    >>> parse_velocity("24,-1.5")
    (24.0, -1.5)
    """
    parts = text.split(",")
    try:
        x, y = (float(part) for part in parts)
    except ValueError:
        raise DroptrackError(
            f"--expect-velocity {text}: should be px a frame in x and y, such as 24,-1.5"
        ) from None
    if not (isfinite(x) and isfinite(y)):
        raise DroptrackError(f"--expect-velocity {text}: should be finite")
    return x, y


def make_tracker(
    config: TrackerConfig, *, by_descriptors: bool = False
) -> tuple[Tracker, dict[str, Value]]:
    """A tracker, and its settings for the report.

    `by_descriptors`: the droplet tracker compares descriptors even without an appearance network,
    as DeepSORT always does.
    """
    if config.name is TrackerName.deepsort:
        parameters = DeepSortParameters(
            max_cosine_distance=config.max_cosine_distance,
            nn_budget=config.nn_budget,
            max_iou_distance=config.max_iou_distance,
            max_age=config.max_age or DeepSortParameters.max_age,
            n_init=config.n_init or DeepSortParameters.n_init,
        )
        return DeepSortTracker(parameters), asdict(parameters)
    compares = by_descriptors or config.appearance is not None
    own = DropletParameters(
        appearance=APPEARANCE_COST if compares else 0.0,
        max_age=config.max_age or DropletParameters.max_age,
        n_init=config.n_init or DropletParameters.n_init,
        expect_velocity=config.expect_velocity,
    )
    settings = {REPORTED_AS.get(name, name): value for name, value in asdict(own).items()}
    expected = settings.pop("expect_velocity")
    if expected is not None:
        settings["expect_velocity_px"] = "{:g}, {:g}".format(*expected)
    return DropletTracker(own), settings


def choose_descriptor(config: TrackerConfig) -> DescriptorExtractor:
    """What gives a tracker its descriptors: a network of the user's, else grey levels and size.

    The droplet tracker without such a network gets none: it compares none then.
    """
    if config.appearance is not None:
        size = config.appearance_size
        return NetworkAppearance(config.appearance, config.appearance_weights, size)
    return describe if config.name is TrackerName.deepsort else describe_nothing
