"""A network's maps -> boxes."""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from droptrack.compiled import compiled_twin
from droptrack.data.arrays import Bools, Float32s, Floats
from droptrack.data.detections import Detections
from droptrack.detection.suppression import (
    MIN_SHARE_OF_SCORE,
    MIN_SHARE_OUTSIDE,
    suppress_duplicates,
)
from droptrack.network.darknet_cfg import MAX_LOG_SIZE, YoloHead


def load_loops() -> ModuleType | None:
    """The compiled loops, if there are any; whoever loads them beforehand need not wait later."""
    return compiled_twin(__name__)


def decode_heads(
    maps: Sequence[Float32s], heads: Sequence[YoloHead], threshold: float
) -> list[Float32s]:
    """Of each image, the rows (N, 5 + C) of all heads from their maps (B, A * (5 + C), h, w)."""
    found = []
    for image in range(len(maps[0])):
        parts = []
        for raw, head in zip(maps, heads, strict=True):
            shape = (len(head.mask), 5 + head.classes, *raw.shape[2:])
            parts.append(decode_head(raw[image].reshape(shape), head, threshold))
        found.append(np.concatenate(parts))
    return found


def decode_head(raw: Float32s, head: YoloHead, threshold: float) -> Float32s:
    """Decode a head's map of logits (A, 5 + C, rows, columns).

    Returns rows (N, 5 + C) of those predictions whose objectness is above the threshold: the box
    [cx, cy, w, h] relative to the image, objectness, class probabilities (YOLOv3, section 2.1).
    """
    rows, columns = raw.shape[2:]
    with np.errstate(divide="ignore"):  # thresholds of 0 and 1
        min_logit = np.log(np.float64(threshold)) - np.log1p(-threshold)
    if (loops := load_loops()) is not None:
        whole = np.ascontiguousarray(raw, np.float32)
        found = loops.decode_head(
            whole, head.anchors, head.stride, head.scale_x_y, min_logit, MAX_LOG_SIZE
        )
        return np.asarray(found)
    from scipy.special import expit  # it takes longer to import than all else here

    likely = np.flatnonzero(raw[:, 4] > min_logit)
    if not len(likely):
        return np.zeros((0, raw.shape[1]), np.float32)
    anchor, cell = np.divmod(likely, rows * columns)
    row, column = np.divmod(cell, columns)
    chosen = raw[anchor, :, row, column]  # (N, 5 + C)
    probability = expit(chosen)
    in_cell = head.scale_x_y * (probability[:, :2] - 0.5) + 0.5
    size = np.exp(np.minimum(chosen[:, 2:4], MAX_LOG_SIZE)) * head.anchors[anchor] / head.stride
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
    """Decoded rows (N, 5 + C) of all heads -> the detections in an image of the given size.

    A score is objectness times the best class's probability; those up to the threshold are dropped,
    then the duplicates (`suppress_duplicates`). With `greedy`, as Darknet has it, a box counts for
    every class whose score is above the threshold.
    """
    if (loops := load_loops()) is not None:
        whole = np.ascontiguousarray(rows, np.float32)
        settings = loops.Suppression(max_iou, MIN_SHARE_OUTSIDE, MIN_SHARE_OF_SCORE)
        return Detections(*loops.select(whole, width, height, threshold, greedy, settings))
    scores: Floats = (rows[:, 4:5] * rows[:, 5:]).astype(np.float64)  # (N, C)
    sized = np.asarray((rows[:, 2:4] > 0).all(axis=1) & np.isfinite(rows).all(axis=1))
    counted: Bools = np.greater(scores, threshold) & sized[:, None]
    if not greedy:
        counted &= np.arange(scores.shape[1]) == scores.argmax(axis=1)[:, None]
    kept, class_ids = np.nonzero(counted)
    boxes = rows[kept, :4].astype(np.float64) * [width, height, width, height]
    found = Detections(boxes, scores[kept, class_ids], class_ids)
    return suppress_duplicates(found, max_iou, greedy=greedy)
