"""One network at several scales around one: the mean of its looks is better than each of them.

What it has learned well it sees at each; what it takes for a droplet, as dust or a digit, mostly at
one. Every second look is at the mirrored frame. The boxes of a droplet become one as in weighted
boxes fusion (Solovyev, Wang and Gabruseva 2021).
"""

from collections.abc import Callable, Sequence

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections, iou_of_pairs
from droptrack.data.frames import Frame
from droptrack.data.neighbours import pairs_within
from droptrack.data.region import Region
from droptrack.data.stage_times import StageTimes
from droptrack.detection.detector import Detector, Engine
from droptrack.detection.suppression import suppress_duplicates

STILL_LOOKS = 3  # at an image that is no frame of a video
MAX_LOOKS = 5
STEP = 1.25  # between their scales
MIN_SCORE = 0.05  # that counts in a look
SAME_IOU = 0.5  # of two boxes of one droplet


def look_factors(n: int) -> list[float]:
    """What the scale is multiplied by for each of `n` looks.

    >>> look_factors(3)
    [1.0, 0.8, 1.25]
    """
    return [STEP ** (-((k + 1) // 2) if k % 2 else k // 2) for k in range(n)]


class SeveralLooks:
    """Finds droplets with several detectors, each at a scale of its own, the chosen one first.

    `threshold`: minimum of a droplet's score, which is the mean over all looks; the detectors
    should have MIN_SCORE or less. `region`: where droplets count; the detectors should have none.
    """

    def __init__(
        self, looks: Sequence[Detector], threshold: float, region: Region | None = None
    ) -> None:
        self._looks, self._threshold, self._region = looks, threshold, region
        self.max_iou = looks[0].max_iou

    @property
    def engine(self) -> Engine:
        """What runs the network, at the scale that was chosen."""
        return self._looks[0].engine

    def detect(self, frames: Sequence[Frame]) -> list[Detections]:
        """As `Detector.detect`."""
        return self.start(frames, StageTimes())()

    def start(self, frames: Sequence[Frame], times: StageTimes) -> Callable[[], list[Detections]]:
        """As `Detector.start`: all looks compute meanwhile."""
        width = frames[0].shape[1]
        mirrored = [np.ascontiguousarray(frame[:, ::-1]) for frame in frames]
        waits = [
            look.start(mirrored if k % 2 else frames, times) for k, look in enumerate(self._looks)
        ]

        def finish() -> list[Detections]:
            by_look = [wait() for wait in waits]
            by_look[1::2] = [[mirrored_back(one, width) for one in look] for look in by_look[1::2]]
            return [self._together(of_frame) for of_frame in zip(*by_look, strict=True)]

        return finish

    def _together(self, found: Sequence[Detections]) -> Detections:
        fused, _ = fuse(found)
        counts = fused.scores >= self._threshold
        if self._region is not None:
            counts &= self._region.contains(fused.boxes[:, :2])
        return suppress_duplicates(fused[counts], self.max_iou)


def mirrored_back(found: Detections, width: int) -> Detections:
    """What is found in a mirrored frame, where it is in the frame of a width, px."""
    boxes = found.boxes.copy()
    boxes[:, 0] = width - boxes[:, 0]
    return Detections(boxes, found.scores, found.class_ids)


def fuse(looks: Sequence[Detections]) -> tuple[Detections, Floats]:
    """Detections of several looks as one, and the share (N,) of looks that show each.

    The surest detection comes first; each look has one box a droplet at most. Boxes are means,
    weighted by the scores; a score is the mean over all looks; the class is that of the surest.

    >>> box = np.array([[50.0, 50, 20, 20]])
    >>> one, two = (Detections(box + [d, 0, 0, 0], np.array([0.8]), np.zeros(1, int))
    ...             for d in (0, 2))
    >>> fused, shares = fuse([one, two])
    >>> fused.boxes.round(6).tolist(), fused.scores.round(6).tolist(), shares.tolist()
    ([[51.0, 50.0, 20.0, 20.0]], [0.8], [1.0])
    """
    look_of = np.repeat(np.arange(len(looks)), [len(look) for look in looks])
    boxes = np.concatenate([look.boxes for look in looks])
    scores = np.concatenate([look.scores for look in looks])
    class_ids = np.concatenate([look.class_ids for look in looks])
    reach = np.hypot(*boxes[:, 2:].T) / 2  # centres of boxes of one droplet are no further apart
    row, place = pairs_within(boxes[:, :2], reach, boxes[:, :2])
    iou = iou_of_pairs(boxes[row], boxes[place])
    order = np.lexsort([-iou, row])
    row, place = (rows[order][iou[order] >= SAME_IOU] for rows in (row, place))
    starts = np.searchsorted(row, np.arange(len(boxes) + 1))
    free = np.ones(len(boxes), bool)
    members = []
    for i in np.argsort(-scores, kind="stable"):
        if free[i]:
            near = place[starts[i] : starts[i + 1]]
            near = near[free[near]]
            _, best = np.unique(look_of[near], return_index=True)
            members.append(near[best])
            free[near[best]] = False
    n = len(members)
    fused = [np.average(boxes[some], axis=0, weights=scores[some]) for some in members]
    surest = [some[scores[some].argmax()] for some in members]
    together = Detections(
        np.array(fused).reshape(n, 4),
        np.array([scores[some].sum() / len(looks) for some in members]),
        class_ids[np.array(surest, int)],
    )
    return together, np.array([len(some) / len(looks) for some in members])
