"""Frames -> detections: what an engine does, and what all engines share."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

import cv2

from droptrack.data.arrays import Float32s
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.data.normalisation import UNCHANGED, Normalisation
from droptrack.data.region import Region
from droptrack.data.stage_times import StageTimes
from droptrack.detection.decoding import select
from droptrack.detection.scale import Canvas
from droptrack.errors import DroptrackError


class Computed(NamedTuple):
    """A network's outputs, and the seconds they took once their turn had come."""

    outputs: Any
    seconds: float


class Computing(Protocol):
    """An input on its way through a network."""

    def result(self) -> Computed:
        """Wait until it is done; raises RuntimeError or cv2.error when the engine fails."""


class Engine(Protocol):
    """Runs a network; each file in `engines` has one or two.

    `name` says what runs it and how precisely; `parallel` is the number of inputs that it computes
    at once, `opencv_threads` the number of threads in which it lets OpenCV compute.
    """

    name: str
    parallel: int
    opencv_threads: int

    def prepare(self, frames: Sequence[Frame]) -> Any:
        """Frames (H, W, 3) of one size -> the network's input."""

    def start(self, prepared: Any) -> Computing:
        """Give the network an input, and do not wait for it."""

    def rows(self, outputs: Any) -> list[Float32s]:
        """Of each frame, the decoded rows (N, 5 + C) that may be droplets, see `decode_head`."""


class Finder(Protocol):
    """What finds droplets in frames: a `Detector`, or several."""

    @property
    def engine(self) -> Engine:
        """What runs the network."""

    def detect(self, frames: Sequence[Frame]) -> list[Detections]:
        """See `Detector.detect`."""

    def start(self, frames: Sequence[Frame], times: StageTimes) -> Callable[[], list[Detections]]:
        """See `Detector.start`."""


class Detector:
    """Finds droplets in frames with an engine.

    `threshold`: minimum score of a detection; `max_iou`: IoU above which two detections are one
    droplet; `greedy`: as for `suppress_duplicates`; `normalisation`: how frames are changed for the
    network; `canvas`: what they are extended to, so that they need not be stretched; `region`:
    where droplets count, by their boxes' centres; None: everywhere.
    """

    def __init__(
        self,
        engine: Engine,
        threshold: float,
        max_iou: float,
        *,
        greedy: bool = False,
        normalisation: Normalisation = UNCHANGED,
        canvas: Canvas | None = None,
        region: Region | None = None,
    ) -> None:
        self.engine, self.threshold, self.max_iou = engine, threshold, max_iou
        self.greedy, self.normalisation = greedy, normalisation
        self.canvas, self.region = canvas, region

    def detect(self, frames: Sequence[Frame]) -> list[Detections]:
        """The detections of each of some frames (H, W, 3) of one size, in one pass.

        Raises DroptrackError when the engine fails, as for want of memory.
        """
        return self.start(frames, StageTimes())()

    def start(self, frames: Sequence[Frame], times: StageTimes) -> Callable[[], list[Detections]]:
        """Give frames to the network, which computes them meanwhile; wait with what is returned.

        Both may raise DroptrackError.
        """
        canvas = self.canvas
        if canvas is not None:
            frames = [canvas.extended(frame) for frame in frames]
        height, width = frames[0].shape[:2]
        with self._failures():
            with times.measure("preprocess"):
                prepared = self.engine.prepare([self.normalisation.shown(one) for one in frames])
            computing = self.engine.start(prepared)

        def finish() -> list[Detections]:
            with self._failures():
                outputs, seconds = computing.result()
            times.add("network", seconds)
            with times.measure("decode_boxes"):
                found = [
                    select(rows, width, height, self.threshold, self.max_iou, greedy=self.greedy)
                    for rows in self.engine.rows(outputs)
                ]
                return [self._counted(one) for one in found]

        return finish

    def _counted(self, found: Detections) -> Detections:
        """Those that lie in the frame, and in the region of interest if there is one."""
        if self.canvas is not None:
            found = self.canvas.within(found)
        if self.region is not None:
            found = found[self.region.contains(found.boxes[:, :2])]
        return found

    @contextmanager
    def _failures(self) -> Iterator[None]:
        try:
            yield
        except (RuntimeError, cv2.error) as error:
            raise DroptrackError(
                f"{self.engine.name}: the network failed: {first_line(error)}"
            ) from error


def first_line(error: Exception) -> str:
    """What an engine has to say in one line."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
