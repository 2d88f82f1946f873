"""Non-maximum suppression."""

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

from droptrack.data.arrays import Rows
from droptrack.data.detections import Detections, intersections, iou_of_pairs, xyxy_from_boxes
from droptrack.data.neighbours import pairs_within

# of a box beyond another: with less, it is a part of the same droplet
MIN_SHARE_OUTSIDE = 0.25
# of a box between two others, that each of them has
MIN_SHARE_OF_SCORE = 0.5


def suppress_duplicates(
    detections: Detections, max_iou: float, *, greedy: bool = False
) -> Detections:
    """Non-maximum suppression, best score first, of all classes together: a droplet has one class.

    Where that leaves a box between two others instead of these, which is how a network may see two
    droplets that touch, the two are left instead (`boxes_between`). `greedy`: as Darknet has it,
    within each class, and no more than that.
    """
    while True:
        kept = _best(detections, max_iou, within_classes=greedy)
        if greedy or not len(between := boxes_between(detections, kept, max_iou)):
            return detections[kept]
        detections = detections[np.delete(np.arange(len(detections)), between)]


def _best(detections: Detections, max_iou: float, *, within_classes: bool) -> Rows:
    """Rows that greedy suppression keeps, best score first."""
    groups = detections.class_ids if within_classes else np.zeros_like(detections.class_ids)
    rectangles = xyxy_from_boxes(detections.boxes)
    rectangles[:, 2:] = detections.boxes[:, 2:]
    kept: Sequence[int] = cv2.dnn.NMSBoxesBatched(
        rectangles.tolist(),
        detections.scores.tolist(),
        groups.tolist(),
        score_threshold=0.0,
        nms_threshold=max_iou,
    )
    return np.asarray(kept, np.int64)


def boxes_between(detections: Detections, kept: Rows, max_iou: float) -> Rows:
    """Rows of kept boxes that stand where two others should, on both sides of the middle.

    Both have an IoU with it above `max_iou`, with one another below; MIN_SHARE_OUTSIDE of each lies
    beyond it, so that they are no two halves of its droplet; and neither is much less likely.
    """
    boxes, scores = detections.boxes, detections.scores
    lost = np.setdiff1d(np.arange(len(boxes)), kept)
    reach = (boxes[lost, 2:].max(axis=1) + boxes[kept, 2:].max(initial=0)) / 2
    row, place = pairs_within(boxes[lost, :2], reach, boxes[kept, :2])
    one, best = lost[row], kept[place]
    same = iou_of_pairs(boxes[one], boxes[best]) > max_iou
    # a lost box is the duplicate of the best of those that suppress it
    order = np.lexsort((place[same], one[same]))
    one, first = np.unique(one[same][order], return_index=True)
    best = best[same][order][first]
    outside = 1 - intersections(boxes[one], boxes[best]) / boxes[one, 2:].prod(axis=1)
    beside = (outside > MIN_SHARE_OUTSIDE) & (scores[one] >= MIN_SHARE_OF_SCORE * scores[best])
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
