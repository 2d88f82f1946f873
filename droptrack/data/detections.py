"""Detections of one frame, box conversions, IoU, non-maximum suppression.

Boxes are (N, 4) float64 [cx, cy, w, h] px; every other layout has its name: `boxes_xyxy` is
[left, top, right, bottom], `boxes_relative` is [cx, cy, w, h] as fractions of the image's size.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from droptrack.data.arrays import Floats


@dataclass(frozen=True)
class Detections:
    """The droplets found in one frame. Labels are the same type with score 1.

    boxes (N, 4) float64 [cx, cy, w, h] px; scores (N,) float64 in [0, 1]; class_ids (N,) int64.
    Raises ValueError for arrays of other shapes, or boxes that are not finite or not positive.
    """

    boxes: Floats
    scores: Floats
    class_ids: NDArray[np.int64]

    def __post_init__(self) -> None:
        n = len(self.boxes)
        for name, array, shape in (
            ("boxes", self.boxes, (n, 4)),
            ("scores", self.scores, (n,)),
            ("class_ids", self.class_ids, (n,)),
        ):
            if array.shape != shape:
                raise ValueError(f"{name} should have shape {shape}, not {array.shape}")
        if not np.isfinite(self.boxes).all() or not np.isfinite(self.scores).all():
            row = int(np.flatnonzero(~np.isfinite(np.c_[self.boxes, self.scores]).all(axis=1))[0])
            raise ValueError(f"boxes and scores should be finite, row {row} is {self.boxes[row]}")
        if (self.boxes[:, 2:] <= 0).any():
            row = int(np.flatnonzero((self.boxes[:, 2:] <= 0).any(axis=1))[0])
            raise ValueError(f"boxes need a width and height, row {row} is {self.boxes[row]}")

    def __len__(self) -> int:
        return len(self.boxes)

    def __getitem__(self, rows: NDArray[np.int64] | NDArray[np.bool_] | slice) -> "Detections":
        return Detections(self.boxes[rows], self.scores[rows], self.class_ids[rows])


def labels(boxes: ArrayLike) -> Detections:
    """Boxes (N, 4) as labels: score 1, class 0."""
    array = np.asarray(boxes, float).reshape(-1, 4)
    return Detections(array, np.ones(len(array)), np.zeros(len(array), np.int64))


def xyxy_from_boxes(boxes: Floats) -> Floats:
    """[cx, cy, w, h] -> [left, top, right, bottom]."""
    half = boxes[:, 2:] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def boxes_from_xyxy(boxes_xyxy: Floats) -> Floats:
    """[left, top, right, bottom] -> [cx, cy, w, h]."""
    low, high = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
    return np.concatenate([(low + high) / 2, high - low], axis=1)


def iou_matrix(boxes: Floats, others: Floats) -> Floats:
    """Intersection over union of every box (N, 4) with every other (M, 4): (N, M)."""
    return iou_of_pairs(boxes[:, None], others[None])


def intersections(boxes: Floats, others: Floats) -> Floats:
    """Areas (...,) px² that boxes (..., 4) share with others (..., 4), one by one."""
    half, other_half = boxes[..., 2:] / 2, others[..., 2:] / 2
    low = np.maximum(boxes[..., :2] - half, others[..., :2] - other_half)
    high = np.minimum(boxes[..., :2] + half, others[..., :2] + other_half)
    return np.asarray(np.prod(np.maximum(high - low, 0), axis=-1))


def iou_of_pairs(boxes: Floats, others: Floats) -> Floats:
    """Intersection over union (...,) of boxes (..., 4) with others (..., 4), one by one."""
    intersection = intersections(boxes, others)
    areas = np.prod(boxes[..., 2:], axis=-1) + np.prod(others[..., 2:], axis=-1)
    return np.asarray(intersection / np.maximum(areas - intersection, 1e-300))
