"""Maps to boxes, compiled: what detector.py says of arrays, in loops."""

from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]

FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}
_MAP, _ROWS = types.float32[:, :, :, ::1], types.float32[:, ::1]
_FLOATS = types.float64[:, ::1]


@njit(**FAST)
def _overlap(boxes: Floats, i: int, k: int) -> float:
    """Intersection over union of two boxes."""
    common = 1.0
    for x, w in ((0, 2), (1, 3)):
        low = max(boxes[i, x] - boxes[i, w] / 2, boxes[k, x] - boxes[k, w] / 2)
        high = min(boxes[i, x] + boxes[i, w] / 2, boxes[k, x] + boxes[k, w] / 2)
        common *= max(high - low, 0.0)
    both = boxes[i, 2] * boxes[i, 3] + boxes[k, 2] * boxes[k, 3]
    return float(common / (both - common))


# compiled when they are imported, not at the first frame
@njit((_MAP, _FLOATS, types.float64, types.float64, types.float64), **FAST)
def decode_head(
    raw: Float32s, anchors: Floats, stride: float, scale_x_y: float, least: float
) -> Float32s:
    """`detector.decode_head`, where `least` is the threshold's logit."""
    n_anchors, n_values, n_rows, n_columns = raw.shape
    n = 0
    for anchor in range(n_anchors):
        for row in range(n_rows):
            for logit in raw[anchor, 4, row]:
                n += logit > least
    found = np.empty((n, n_values), np.float32)
    n = 0
    for anchor in range(n_anchors):
        for row in range(n_rows):
            for column in range(n_columns):
                if not raw[anchor, 4, row, column] > least:
                    continue
                values = raw[anchor, :, row, column]
                for k in range(n_values):
                    found[n, k] = 1 / (1 + np.exp(-values[k]))
                found[n, 0] = (scale_x_y * (found[n, 0] - 0.5) + 0.5 + column) / n_columns
                found[n, 1] = (scale_x_y * (found[n, 1] - 0.5) + 0.5 + row) / n_rows
                for k, cells in ((2, n_columns), (3, n_rows)):
                    size = np.exp(min(values[k], np.float32(10))) * anchors[anchor, k - 2]
                    found[n, k] = size / stride / cells
                n += 1
    return found


@njit((_ROWS, types.int64, types.int64, types.float64, types.float64), **FAST)
def select(
    rows: Float32s, width: int, height: int, threshold: float, max_iou: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """`detector.select`: boxes (K, 4) px, scores (K,) and classes (K,), the best first."""
    boxes = np.empty((len(rows), 4))
    scores, class_ids = np.empty(len(rows)), np.empty(len(rows), np.int64)
    n, last = 0, rows.shape[1]
    for row in range(len(rows)):
        best = 5
        finite = True
        for k in range(last):
            finite &= np.isfinite(rows[row, k])
            best = k if k > 5 and rows[row, k] > rows[row, best] else best
        score = np.float64(rows[row, 4] * rows[row, best])
        if finite and score > threshold and rows[row, 2] > 0 and rows[row, 3] > 0:
            for k, size in ((0, width), (1, height), (2, width), (3, height)):
                boxes[n, k] = rows[row, k] * np.float64(size)
            scores[n], class_ids[n] = score, best - 5
            n += 1
    kept = np.empty(n, np.int64)
    n_kept = 0
    for i in np.argsort(-scores[:n], kind="mergesort"):
        double = False
        for k in kept[:n_kept]:
            double |= class_ids[k] == class_ids[i] and _overlap(boxes, k, i) > max_iou
        if not double:
            kept[n_kept] = i
            n_kept += 1
    return boxes[kept[:n_kept]], scores[kept[:n_kept]], class_ids[kept[:n_kept]]
