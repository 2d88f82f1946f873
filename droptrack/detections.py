"""Detections of one frame, box conversions, overlaps, suppression of doubles.

Boxes are (N, 4) float64 [cx, cy, w, h] px; every other layout has its name: `boxes_xyxy` is
[left, top, right, bottom], `boxes_relative` is [cx, cy, w, h] as fractions of the picture's size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from droptrack.association import pairs_within

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

OUTSIDE = 0.25  # share of a box beyond another, from which it is not a part of the same droplet
LEAST_OF_SCORE = 0.5  # of a box between two others, that each of them has at least


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


def suppress_doubles(detections: Detections, max_iou: float, *, greedy: bool = False) -> Detections:
    """Non-maximum suppression within each class, greedy, best score first.

    Where that leaves a box between two others instead of these, which is how a network may see two
    droplets that touch, the two are left instead (`boxes_between`); not with `greedy`, as Darknet
    has it.
    """
    while True:
        kept = _best(detections, max_iou)
        if greedy or not len(between := boxes_between(detections, kept, max_iou)):
            return detections[kept]
        detections = detections[np.delete(np.arange(len(detections)), between)]


def _best(detections: Detections, max_iou: float) -> Rows:
    """Rows that greedy suppression keeps, best score first."""
    rectangles = xyxy_from_boxes(detections.boxes)
    rectangles[:, 2:] = detections.boxes[:, 2:]
    kept: Sequence[int] = cv2.dnn.NMSBoxesBatched(
        rectangles.tolist(),
        detections.scores.tolist(),
        detections.class_ids.tolist(),
        score_threshold=0.0,
        nms_threshold=max_iou,
    )
    return np.asarray(kept, np.int64)


def boxes_between(detections: Detections, kept: Rows, max_iou: float) -> Rows:
    """Rows of kept boxes that stand where two others should, on both sides of the middle.

    Both overlap with it by more than `max_iou`, one another by less; OUTSIDE of each lies beyond
    it, so that they are no two halves of its droplet; and neither is much less likely.
    """
    boxes, scores, class_ids = detections.boxes, detections.scores, detections.class_ids
    lost = np.setdiff1d(np.arange(len(boxes)), kept)
    reach = (boxes[lost, 2:].max(axis=1) + boxes[kept, 2:].max(initial=0)) / 2
    row, place = pairs_within(boxes[lost, :2], reach, boxes[kept, :2])
    one, best = lost[row], kept[place]
    double = (iou_of_pairs(boxes[one], boxes[best]) > max_iou) & (class_ids[one] == class_ids[best])
    # a lost box is the double of the best of those that it overlaps with
    order = np.lexsort((place[double], one[double]))
    one, first = np.unique(one[double][order], return_index=True)
    best = best[double][order][first]
    outside = 1 - intersections(boxes[one], boxes[best]) / boxes[one, 2:].prod(axis=1)
    beside = (outside > OUTSIDE) & (scores[one] >= LEAST_OF_SCORE * scores[best])
    found = set()
    for i, k in combinations(np.flatnonzero(beside).tolist(), 2):
        a, b, m = one[i], one[k], best[i]
        if (
            m == best[k]
            and (boxes[a, :2] - boxes[m, :2]) @ (boxes[b, :2] - boxes[m, :2]) < 0
            and iou_of_pairs(boxes[a], boxes[b]) <= max_iou
        ):
            found.add(int(m))
    return np.array(sorted(found), np.int64)
