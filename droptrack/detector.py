"""What a detector does, and how raw outputs of YOLO heads become detections."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from droptrack.darknet_files import YoloHead
from droptrack.detections import Detections, suppress_doubles

Float32s = NDArray[np.float32]


class Detector(Protocol):
    """Finds droplets in frames; each engine is one."""

    name: str

    def detect(self, frames: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """The detections of each of some frames (H, W, 3) of one size."""


def decode_head(raw: Float32s, head: YoloHead, threshold: float) -> Float32s:
    """Decode a head's map of logits (A, 5 + C, rows, columns).

    Returns rows (N, 5 + C) of those predictions whose objectness is above the threshold: the box
    [cx, cy, w, h] relative to the picture, objectness, class probabilities (YOLOv3, section 2.1).
    """
    rows, columns = raw.shape[2:]
    logit = np.log(threshold / (1 - threshold))
    anchor, row, column = np.nonzero(raw[:, 4] > logit)
    chosen = raw[anchor, :, row, column]  # (N, 5 + C)
    probability = expit(chosen)
    in_cell = head.scale_x_y * (probability[:, :2] - 0.5) + 0.5
    centre = (in_cell + np.column_stack([column, row])) / [columns, rows]
    network_size = np.array([columns, rows]) * head.stride
    size = np.exp(np.minimum(chosen[:, 2:4], 10)) * head.anchors[anchor] / network_size
    return np.column_stack([centre, size, probability[:, 4:]]).astype(np.float32)


def select(rows: Float32s, width: int, height: int, threshold: float, max_iou: float) -> Detections:
    """Decoded rows (N, 5 + C) of all heads -> the detections in a picture of the given size.

    A score is objectness times the best class's probability; those up to the threshold are dropped,
    then the doubles (`suppress_doubles`).
    """
    scores = rows[:, 4:5] * rows[:, 5:]  # (N, C)
    class_ids = scores.argmax(axis=1)
    best = scores[np.arange(len(scores)), class_ids].astype(np.float64)
    sized = (rows[:, 2:4] > 0).all(axis=1) & np.isfinite(rows).all(axis=1)
    kept = np.flatnonzero((best > threshold) & sized)
    boxes = rows[kept, :4].astype(np.float64) * [width, height, width, height]
    return suppress_doubles(Detections(boxes, best[kept], class_ids[kept]), max_iou)
