"""Frames -> detections: what an engine does, and what all engines share."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from droptrack import DroptrackError
from droptrack.compiled import compiled
from droptrack.darknet_files import YoloHead
from droptrack.detections import Detections, suppress_doubles
from droptrack.stage_times import StageTimes
from droptrack.video import Frame, negative

Float32s = NDArray[np.float32]


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


class Detector:
    """Finds droplets in frames with an engine.

    `threshold`: least score of a detection; `max_iou`: overlap from which two detections are one
    droplet; `dark`: droplets are darker than what is around them, and the network learned bright
    ones, so that it is shown the negative; `greedy`: as for `suppress_doubles`.
    """

    def __init__(
        self,
        engine: Engine,
        threshold: float,
        max_iou: float,
        *,
        dark: bool = False,
        greedy: bool = False,
    ) -> None:
        self.engine, self.threshold, self.max_iou = engine, threshold, max_iou
        self.dark, self.greedy = dark, greedy

    def detect(self, frames: Sequence[Frame]) -> list[Detections]:
        """The detections of each of some frames (H, W, 3) of one size, in one pass.

        Raises DroptrackError when the engine fails, as for want of memory.
        """
        return self.start(frames, StageTimes())()

    def start(self, frames: Sequence[Frame], times: StageTimes) -> Callable[[], list[Detections]]:
        """Give frames to the network, which computes them meanwhile; wait with what is returned.

        Both may raise DroptrackError.
        """
        height, width = frames[0].shape[:2]
        with self._failures():
            with times.measure("preprocess"):
                shown = [negative(frame) for frame in frames] if self.dark else frames
                prepared = self.engine.prepare(shown)
            computing = self.engine.start(prepared)

        def finish() -> list[Detections]:
            with self._failures():
                outputs, seconds = computing.result()
            times.add("network", seconds)
            with times.measure("decode_boxes"):
                return [
                    select(rows, width, height, self.threshold, self.max_iou, greedy=self.greedy)
                    for rows in self.engine.rows(outputs)
                ]

        return finish

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


def decode_heads(
    maps: Sequence[Float32s], heads: Sequence[YoloHead], threshold: float
) -> list[Float32s]:
    """Of each picture, the rows (N, 5 + C) of all heads from their maps (B, A * (5 + C), h, w)."""
    found = []
    for picture in range(len(maps[0])):
        parts = []
        for raw, head in zip(maps, heads, strict=True):
            shape = (len(head.mask), 5 + head.classes, *raw.shape[2:])
            parts.append(decode_head(raw[picture].reshape(shape), head, threshold))
        found.append(np.concatenate(parts))
    return found


def decode_head(raw: Float32s, head: YoloHead, threshold: float) -> Float32s:
    """Decode a head's map of logits (A, 5 + C, rows, columns).

    Returns rows (N, 5 + C) of those predictions whose objectness is above the threshold: the box
    [cx, cy, w, h] relative to the picture, objectness, class probabilities (YOLOv3, section 2.1).
    """
    rows, columns = raw.shape[2:]
    least = logit(threshold)
    if (loops := compiled("detector")) is not None:
        whole = np.ascontiguousarray(raw, np.float32)
        found = loops.decode_head(whole, head.anchors, head.stride, head.scale_x_y, least)
        return np.asarray(found)
    likely = np.flatnonzero(raw[:, 4] > least)
    if not len(likely):
        return np.zeros((0, raw.shape[1]), np.float32)
    anchor, cell = np.divmod(likely, rows * columns)
    row, column = np.divmod(cell, columns)
    chosen = raw[anchor, :, row, column]  # (N, 5 + C)
    probability = expit(chosen)
    in_cell = head.scale_x_y * (probability[:, :2] - 0.5) + 0.5
    size = np.exp(np.minimum(chosen[:, 2:4], 10)) * head.anchors[anchor] / head.stride
    found = np.empty(chosen.shape, np.float32)
    found[:, 0] = (in_cell[:, 0] + column) / columns
    found[:, 1] = (in_cell[:, 1] + row) / rows
    found[:, 2], found[:, 3] = size[:, 0] / columns, size[:, 1] / rows
    found[:, 4:] = probability[:, 4:]
    return found


def select(
    rows: Float32s,
    width: int,
    height: int,
    threshold: float,
    max_iou: float,
    *,
    greedy: bool = False,
) -> Detections:
    """Decoded rows (N, 5 + C) of all heads -> the detections in a picture of the given size.

    A score is objectness times the best class's probability; those up to the threshold are dropped,
    then the doubles (`suppress_doubles`).
    """
    if (loops := compiled("detector")) is not None:
        whole = np.ascontiguousarray(rows, np.float32)
        return Detections(*loops.select(whole, width, height, threshold, max_iou, greedy))
    scores = rows[:, 4:5] * rows[:, 5:]  # (N, C)
    class_ids = scores.argmax(axis=1)
    best = scores[np.arange(len(scores)), class_ids].astype(np.float64)
    sized = (rows[:, 2:4] > 0).all(axis=1) & np.isfinite(rows).all(axis=1)
    kept = np.flatnonzero((best > threshold) & sized)
    boxes = rows[kept, :4].astype(np.float64) * [width, height, width, height]
    found = Detections(boxes, best[kept], class_ids[kept])
    return suppress_doubles(found, max_iou, greedy=greedy)
