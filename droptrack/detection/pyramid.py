"""Droplets of very different sizes: one network at several scales, each for sizes of its own.

Every level finds droplets of a part of the range of diameters, as large in its input as the network
knows them; what it finds of other sizes, as parts of large droplets and rows of small ones, does
not count.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.data.stage_times import StageTimes
from droptrack.detection.detector import Detector, Engine
from droptrack.detection.looks import SeveralLooks
from droptrack.detection.scale import DIAMETER_PX
from droptrack.detection.suppression import suppress_duplicates
from droptrack.errors import DroptrackError

MAX_RATIO = 6.0  # of the largest to the smallest diameter that one scale is good for
MAX_LEVELS = 3
MARGIN = 1.25  # beyond the range, by which a size may be wrong


@dataclass(frozen=True)
class Sizes:
    """Diameters of droplets, px of the frames, that one scale is for."""

    smallest: float
    largest: float

    @property
    def scale(self) -> float:
        """Px of the input for a px of the frames."""
        return DIAMETER_PX / math.sqrt(self.smallest * self.largest)

    def hold(self, found: Detections) -> Detections:
        """The detections of these sizes, by sqrt(w h), within MARGIN."""
        diameters = np.sqrt(found.boxes[:, 2:].prod(axis=1))
        fits = (diameters >= self.smallest / MARGIN) & (diameters <= self.largest * MARGIN)
        return found[np.asarray(fits, bool)]


def levels_for(smallest: float, largest: float) -> list[Sizes]:
    """The parts of a range of diameters, in equal ratios, the smallest droplets first.

    Raises DroptrackError for a range of more than MAX_LEVELS parts.

    >>> [(part.smallest, part.largest) for part in levels_for(10, 360)]
    [(10.0, 60.0), (60.0, 360.0)]
    """
    ratio = largest / smallest
    n = max(1, math.ceil(math.log(ratio) / math.log(MAX_RATIO) - 1e-9))
    if n > MAX_LEVELS:
        raise DroptrackError(
            f"--diameter {smallest:g}-{largest:g}: the largest should be at most "
            f"{MAX_RATIO**MAX_LEVELS:g} times the smallest"
        )
    limits = [round(smallest * ratio ** (k / n), 6) for k in range(n + 1)]
    return [Sizes(*pair) for pair in pairwise(limits)]


class Pyramid:
    """Finds droplets with a detector a level: (sizes, detector), smallest sizes first."""

    def __init__(self, levels: Sequence[tuple[Sizes, Detector | SeveralLooks]]) -> None:
        self._levels = levels
        self._max_iou = levels[0][1].max_iou

    @property
    def engine(self) -> Engine:
        """What runs the network: of all levels, the one that takes longest."""
        return self._levels[0][1].engine

    def detect(self, frames: Sequence[Frame]) -> list[Detections]:
        """As `Detector.detect`."""
        return self.start(frames, StageTimes())()

    def start(self, frames: Sequence[Frame], times: StageTimes) -> Callable[[], list[Detections]]:
        """As `Detector.start`: all levels compute meanwhile."""
        waits = [(sizes, level.start(frames, times)) for sizes, level in self._levels]

        def finish() -> list[Detections]:
            by_level = [[sizes.hold(found) for found in wait()] for sizes, wait in waits]
            return [self._together(of_frame) for of_frame in zip(*by_level, strict=True)]

        return finish

    def _together(self, found: Sequence[Detections]) -> Detections:
        """What the levels found in a frame, each droplet once."""
        together = Detections(
            np.concatenate([one.boxes for one in found]),
            np.concatenate([one.scores for one in found]),
            np.concatenate([one.class_ids for one in found]),
        )
        return suppress_duplicates(together, self._max_iou)
