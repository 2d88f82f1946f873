"""Which of the bundled models suits a video: the one for simulations, or that for footage.

The model for simulations is fast and draws tight boxes, and of what laboratories film it finds
little. The other one knows both. So the first is taken where it finds the same as the second, and
where droplets are large enough for an input of its own size; the second chooses its scale.
"""

from collections.abc import Iterable

import numpy as np

from droptrack.data.detections import Detections, iou_matrix

SAME_IOU = 0.5  # of two boxes of one droplet
MIN_AGREEMENT = 0.9
MIN_SIDE_PX = 20.0  # of most droplets in the input; of smaller ones both miss the same


def agreement(these: Iterable[Detections], those: Iterable[Detections]) -> float:
    """The share (F1) of droplets that two networks both find in the same frames; 0 of none.

    >>> one = Detections(np.array([[50.0, 40, 20, 20]]), np.ones(1), np.zeros(1, np.int64))
    >>> two = Detections(np.array([[51.0, 40, 20, 20], [9, 9, 9, 9]]), np.ones(2), np.zeros(2, int))
    >>> round(agreement([one], [two]), 3)
    0.667
    """
    n_both, n_all = 0, 0
    for mine, other in zip(these, those, strict=True):
        n_all += len(mine) + len(other)
        if len(mine) and len(other):
            iou = iou_matrix(mine.boxes, other.boxes)
            best = iou.argmax(axis=1)
            mutual = iou.argmax(axis=0)[best] == np.arange(len(mine))
            n_both += int((mutual & (iou.max(axis=1) >= SAME_IOU)).sum())
    return 2 * n_both / n_all if n_all else 0.0


def typical_side(found: Iterable[Detections]) -> float:
    """The median of sqrt(w h) of the droplets of some frames, px; 0 of none.

    >>> boxes = np.array([[50.0, 40, 20, 20], [9, 9, 9, 16]])
    >>> typical_side([Detections(boxes, np.ones(2), np.zeros(2, int))])
    16.0
    """
    sides = np.concatenate(
        [np.zeros(0), *(np.sqrt(one.boxes[:, 2:].prod(axis=1)) for one in found)]
    )
    return float(np.median(sides)) if len(sides) else 0.0
