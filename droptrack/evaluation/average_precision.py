"""How good detections are: average precision by Darknet's definition and by COCO's."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from droptrack.data.detections import Detections, iou_matrix

Pair = tuple[Detections, Detections]  # what was found on an image, and its ground truth

# which detections Darknet's `detector map` counts
MIN_SCORE = 0.005  # the score that they exceed
MAX_IOU = 0.45  # the IoU above which two are duplicates
OPERATING_SCORE = 0.25  # above it, precision, recall, F1 and the average IoU are taken


@dataclass(frozen=True, kw_only=True)
class DetectionScores:
    """Average precision, and what Darknet counts above one score; NaN where undefined."""

    average_precision: float  # mean over the classes that the ground truth has
    precision: float
    recall: float
    f1: float
    average_iou: float  # of what was found above the score, false ones count as 0
    n_ground_truths: int
    n_detections: int
    of_classes: Mapping[int, float] = field(default_factory=dict)  # average precision of each


@dataclass
class _Class:
    """What was found of one class in all images."""

    scores: list[NDArray[np.float64]] = field(default_factory=list)
    ious: list[NDArray[np.float64]] = field(default_factory=list)  # 0 where false
    n_ground_truths: int = 0


def average_precision(
    pairs: Iterable[Pair], min_iou: float = 0.5, score: float = OPERATING_SCORE
) -> DetectionScores:
    """Scores of (detections, ground truth) pairs, one an image.

    As Darknet's ``detector map``: detections of a class in all images by falling score; each takes
    the labelled droplet with which it has the best IoU, if that is more than `min_iou` and none
    took the droplet before, else it is false; the area under the curve of the best precision at
    each recall or above. `score` is where precision, recall, F1 and the average IoU are taken. NaN
    without any labelled droplet.
    """
    classes: dict[int, _Class] = {}
    for detections, truth in pairs:
        for class_id in np.union1d(detections.class_ids, truth.class_ids).tolist():
            mine = detections[detections.class_ids == class_id]
            mine = mine[np.argsort(-mine.scores, kind="stable")]
            expected = truth[truth.class_ids == class_id]
            counts = classes.setdefault(class_id, _Class())
            counts.scores.append(mine.scores)
            counts.ious.append(_ious_of_hits(mine, expected, min_iou))
            counts.n_ground_truths += len(expected)
    n_truths = sum(counts.n_ground_truths for counts in classes.values())
    scores = _concatenated(part for counts in classes.values() for part in counts.scores)
    if not n_truths:
        return DetectionScores(
            average_precision=np.nan,
            precision=np.nan,
            recall=np.nan,
            f1=np.nan,
            average_iou=np.nan,
            n_ground_truths=0,
            n_detections=len(scores),
        )
    ious = _concatenated(part for counts in classes.values() for part in counts.ious)
    counted = ious[scores > score]
    n_hits = int((counted > 0).sum())
    areas = {k: _area(counts) for k, counts in classes.items() if counts.n_ground_truths}
    return DetectionScores(
        average_precision=float(np.mean(list(areas.values()))),
        precision=n_hits / len(counted) if len(counted) else np.nan,
        recall=n_hits / n_truths,
        f1=2 * n_hits / (len(counted) + n_truths),
        average_iou=float(counted.mean()) if len(counted) else np.nan,
        n_ground_truths=n_truths,
        n_detections=len(scores),
        of_classes=areas,
    )


def _concatenated(parts: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.concatenate([np.zeros(0), *parts])


def _area(counts: _Class) -> float:
    """Area under the curve of precision over recall."""
    order = np.argsort(-np.concatenate(counts.scores), kind="stable")
    found = np.cumsum(np.concatenate(counts.ious)[order] > 0)
    precision = found / np.arange(1, len(found) + 1)
    recall = np.concatenate([[0.0], found / counts.n_ground_truths])
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(recall) * envelope).sum())


def _ious_of_hits(detections: Detections, truth: Detections, min_iou: float) -> NDArray[np.float64]:
    """Of detections, best score first: the IoU with a droplet that none before took, or 0."""
    ious = np.zeros(len(detections))
    if not len(truth) or not len(detections):
        return ious
    iou = iou_matrix(detections.boxes, truth.boxes)
    best = iou.argmax(axis=1)
    good = np.flatnonzero(iou[np.arange(len(best)), best] > min_iou)
    _, first = np.unique(best[good], return_index=True)
    hits = good[first]
    ious[hits] = iou[hits, best[hits]]
    return ious


def coco_average_precision(pairs: Sequence[Pair]) -> tuple[float, float]:
    """COCO's AP50-95 and AP50 of (detections, ground truth) pairs, one an image.

    NaN without any labelled droplet. An image may have any number of droplets, where COCO's own
    tables stop at 100. Needs hotcoco.
    """
    from hotcoco import COCO, COCOeval

    truths: list[dict[str, object]] = []
    found: list[dict[str, object]] = []
    for image, pair in enumerate(pairs, start=1):
        for rows, boxes in zip((found, truths), pair, strict=True):
            corners = boxes.boxes[:, :2] - boxes.boxes[:, 2:] / 2
            for corner, box, score, class_id in zip(
                corners.tolist(),
                boxes.boxes.tolist(),
                boxes.scores.tolist(),
                boxes.class_ids.tolist(),
                strict=True,
            ):
                row = {"image_id": image, "category_id": class_id, "bbox": [*corner, *box[2:]]}
                rows.append(row | {"score": score, "area": box[2] * box[3], "iscrowd": 0})
    for number, truth in enumerate(truths, start=1):
        truth["id"] = number
    if not truths or not found:
        return (0.0, 0.0) if truths else (np.nan, np.nan)
    class_ids = sorted({int(str(truth["category_id"])) for truth in truths})
    table = COCO(
        {
            "images": [{"id": n, "width": 1, "height": 1} for n in range(1, len(pairs) + 1)],
            "categories": [{"id": class_id, "name": str(class_id)} for class_id in class_ids],
            "annotations": truths,
        }
    )
    evaluation = COCOeval(table, table.load_res(found), "bbox")
    evaluation.params.max_dets = [1, 10, max(len(detections) for detections, _ in pairs)]
    evaluation.evaluate()
    evaluation.accumulate()
    tables: dict[str, NDArray[np.float64]] = evaluation.eval or {}
    precision = tables["precision"][:, :, :, 0, -1]  # IoU, recall, class
    return float(precision.mean()), float(precision[0].mean())
