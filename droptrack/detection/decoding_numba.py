"""Maps to boxes, compiled: what decoding.py and suppression.py say of arrays, in loops."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Bools, Float32s, Floats, Rows

FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}
_MAP, _ROWS = types.float32[:, :, :, ::1], types.float32[:, ::1]
_FLOATS = types.float64[:, ::1]


class Suppression(NamedTuple):
    """The constants of suppression.py, and the IoU above which boxes are duplicates."""

    max_iou: float
    outside: float
    score: float


_SUPPRESSION = types.NamedUniTuple(types.float64, 3, Suppression)  # type: ignore[no-untyped-call]


@njit(**FAST)
def _intersection(boxes: Floats, i: int, k: int) -> float:
    """Area that two boxes share."""
    common = 1.0
    for x, w in ((0, 2), (1, 3)):
        low = max(boxes[i, x] - boxes[i, w] / 2, boxes[k, x] - boxes[k, w] / 2)
        high = min(boxes[i, x] + boxes[i, w] / 2, boxes[k, x] + boxes[k, w] / 2)
        common *= max(high - low, 0.0)
    return common


@njit(**FAST)
def _overlap(boxes: Floats, i: int, k: int) -> float:
    """Intersection over union of two boxes."""
    common = _intersection(boxes, i, k)
    return float(common / (boxes[i, 2] * boxes[i, 3] + boxes[k, 2] * boxes[k, 3] - common))


@njit(**FAST)
def _suppress(
    boxes: Floats, groups: Rows, order: Rows, max_iou: float, dropped: Bools, best: Rows
) -> None:
    """Put into `best` (N,) the first of its group in order that each box duplicates, or itself.

    Boxes are gone through in `order`, without those that were dropped.
    """
    kept = np.empty(len(order), np.int64)
    n_kept = 0
    for i in order:
        best[i] = i
        if dropped[i]:
            continue
        for k in kept[:n_kept]:
            apart = abs(boxes[k, 0] - boxes[i, 0]) >= (boxes[k, 2] + boxes[i, 2]) / 2
            if not apart and groups[k] == groups[i] and _overlap(boxes, k, i) > max_iou:
                best[i] = k
                break
        if best[i] == i:
            kept[n_kept] = i
            n_kept += 1


@njit(**FAST)
def _drop_between(
    boxes: Floats, scores: Floats, settings: Suppression, dropped: Bools, best: Rows
) -> bool:
    """Drop the boxes that stand where two others should: `suppression.boxes_between`."""
    beside = np.empty(len(boxes), np.int64)
    n, found = 0, False
    for b in range(len(boxes)):
        m = best[b]
        min_score = settings.score * scores[m]
        inside = _intersection(boxes, b, m) / (boxes[b, 2] * boxes[b, 3])
        if dropped[b] or m == b or scores[b] < min_score or 1 - inside <= settings.outside:
            continue
        for a in beside[:n]:
            if best[a] == m and _overlap(boxes, a, b) <= settings.max_iou:
                x, y = boxes[a, 0] - boxes[m, 0], boxes[a, 1] - boxes[m, 1]
                if x * (boxes[b, 0] - boxes[m, 0]) + y * (boxes[b, 1] - boxes[m, 1]) < 0:
                    dropped[m] = found = True
        beside[n] = b
        n += 1
    return found


# compiled when they are imported, not at the first frame
@njit((_MAP, _FLOATS, types.float64, types.float64, types.float64, types.float64), **FAST)
def decode_head(
    raw: Float32s,
    anchors: Floats,
    stride: float,
    scale_x_y: float,
    min_logit: float,
    max_log_size: float,
) -> Float32s:
    """`decoding.decode_head`, where `min_logit` is the threshold's logit."""
    n_anchors, n_values, n_rows, n_columns = raw.shape
    n = 0
    for anchor in range(n_anchors):
        for row in range(n_rows):
            for logit in raw[anchor, 4, row]:
                n += logit > min_logit
    found = np.empty((n, n_values), np.float32)
    n = 0
    for anchor in range(n_anchors):
        for row in range(n_rows):
            for column in range(n_columns):
                if not raw[anchor, 4, row, column] > min_logit:
                    continue
                values = raw[anchor, :, row, column]
                for k in range(n_values):
                    found[n, k] = 1 / (1 + np.exp(-values[k]))
                found[n, 0] = (scale_x_y * (found[n, 0] - 0.5) + 0.5 + column) / n_columns
                found[n, 1] = (scale_x_y * (found[n, 1] - 0.5) + 0.5 + row) / n_rows
                for k, cells in ((2, n_columns), (3, n_rows)):
                    size = np.exp(min(values[k], np.float32(max_log_size))) * anchors[anchor, k - 2]
                    found[n, k] = size / stride / cells
                n += 1
    return found


@njit((_ROWS, types.int64, types.int64, types.float64, types.boolean, _SUPPRESSION), **FAST)
def select(
    rows: Float32s, width: int, height: int, threshold: float, greedy: bool, settings: Suppression
) -> tuple[Floats, Floats, Rows]:
    """`decoding.select`: boxes (K, 4) px, scores (K,) and classes (K,), the best first."""
    last = rows.shape[1]
    most = len(rows) * (last - 5 if greedy else 1)
    boxes, scores, class_ids = np.empty((most, 4)), np.empty(most), np.empty(most, np.int64)
    n = 0
    for row in range(len(rows)):
        likeliest = 5
        finite = True
        for k in range(last):
            finite &= np.isfinite(rows[row, k])
            likeliest = k if k > 5 and rows[row, k] > rows[row, likeliest] else likeliest
        if not (finite and rows[row, 2] > 0 and rows[row, 3] > 0):
            continue
        for one in range(5, last):
            score = np.float64(rows[row, 4] * rows[row, one])
            if score > threshold and (greedy or one == likeliest):
                for k, size in ((0, width), (1, height), (2, width), (3, height)):
                    boxes[n, k] = rows[row, k] * np.float64(size)
                scores[n], class_ids[n] = score, one - 5
                n += 1
    boxes, scores, class_ids = boxes[:n], scores[:n], class_ids[:n]
    order, best = np.argsort(-scores, kind="mergesort"), np.empty(n, np.int64)
    dropped = np.zeros(n, np.bool_)
    groups = class_ids if greedy else np.zeros(n, np.int64)
    _suppress(boxes, groups, order, settings.max_iou, dropped, best)
    while not greedy and _drop_between(boxes, scores, settings, dropped, best):
        _suppress(boxes, groups, order, settings.max_iou, dropped, best)
    kept = order[(best[order] == order) & ~dropped[order]]
    return boxes[kept], scores[kept], class_ids[kept]
