"""How good detections are: average precision by Darknet's definition."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from droptrack.detections import Detections, iou_matrix


@dataclass(frozen=True)
class Precision:
    """Average precision, and precision and recall at one score."""

    average_precision: float
    precision: float
    recall: float
    n_truths: int
    n_detections: int


def average_precision(
    pairs: Iterable[tuple[Detections, Detections]], min_iou: float = 0.5, score: float = 0.25
) -> Precision:
    """Precision of (detections, truth) pairs, one an image, of one class.

    As Darknet's ``detector map``: detections of all images by falling score; each takes the truth
    it overlaps best, if by more than `min_iou` and not taken yet, else it is false; the area under
    the curve of the best precision at each recall or above. `score` is where precision and recall
    are taken. NaN without any truth.
    """
    scores: list[NDArray[np.float64]] = []
    hits: list[NDArray[np.bool_]] = []
    n_truths = 0
    for detections, truth in pairs:
        order = np.argsort(-detections.scores, kind="stable")
        scores.append(detections.scores[order])
        hits.append(_hits(detections[order], truth, min_iou))
        n_truths += len(truth)
    all_scores = np.concatenate(scores) if scores else np.zeros(0)
    order = np.argsort(-all_scores, kind="stable")
    hit = np.concatenate(hits)[order] if hits else np.zeros(0, bool)
    if not n_truths:
        return Precision(np.nan, np.nan, np.nan, 0, len(hit))
    found = np.cumsum(hit)
    precision = found / np.arange(1, len(hit) + 1)
    recall = np.concatenate([[0.0], found / n_truths])
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    n = int((all_scores > score).sum())
    n_found = int(found[n - 1]) if n else 0
    return Precision(
        float((np.diff(recall) * envelope).sum()),
        n_found / n if n else np.nan,
        n_found / n_truths,
        n_truths,
        len(hit),
    )


def _hits(detections: Detections, truth: Detections, min_iou: float) -> NDArray[np.bool_]:
    """Which detections, best score first, are the first to take their best-overlapping truth."""
    hit = np.zeros(len(detections), bool)
    if not len(truth) or not len(detections):
        return hit
    iou = iou_matrix(detections.boxes, truth.boxes)
    best = iou.argmax(axis=1)
    good = np.flatnonzero(iou[np.arange(len(best)), best] > min_iou)
    _, first = np.unique(best[good], return_index=True)
    hit[good[first]] = True
    return hit
