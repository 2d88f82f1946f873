"""What a network sees in images at several scales, and mirrored: boxes that all looks agree on.

A network is less sure of what it has not learned, and what it sees then depends on the scale. The
mean of several looks is better than each of them, which is what it can learn from itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from droptrack.adaptation.footage import Shot
from droptrack.data.arrays import Bools, Floats
from droptrack.data.detections import (
    Detections,
    boxes_from_xyxy,
    intersections,
    xyxy_from_boxes,
)
from droptrack.data.samples import N_SAMPLES, spread
from droptrack.detection.detector import Finder
from droptrack.detection.looks import MIN_SCORE, fuse, look_factors, mirrored_back
from droptrack.detection.suppression import suppress_duplicates
from droptrack.pipeline.config import DetectorConfig
from droptrack.pipeline.notes import Say
from droptrack.pipeline.open_detector import OpenedDetector, open_detector

N_LOOKS = 3
EDGE_PX = 2.0  # from an image's edge, within which a droplet may be cut
MIN_SIDE_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class Looks:
    """Detectors at several scales, the first at the one that was chosen."""

    detectors: tuple[Finder, ...]
    opened: OpenedDetector
    max_iou: float  # of two boxes, above which they are one droplet

    @property
    def scale(self) -> float:
        """Px of the network's input for a px of the images."""
        return self.opened.scale


def open_looks(config: DetectorConfig, shots: Sequence[Shot], say: Say) -> Looks:
    """Detectors for images of one size, at the scale that `config` says or the images suggest."""
    height, width = shots[0].frame.shape[:2]
    samples = [shots[place].frame for place in spread(len(shots), N_SAMPLES)]
    low = replace(config, score=MIN_SCORE, looks=1)

    def opened(how: DetectorConfig, tell: Say) -> OpenedDetector:
        return open_detector(how, (width, height), lambda: samples, live=False, say=tell)

    first = opened(low, say)
    if first.alone is not None:  # a network learns at one scale
        first = opened(replace(low, scale=first.alone), say)
    others = [
        opened(replace(low, size=None, diameter_px=None, scale=first.scale * factor), _silent)
        for factor in look_factors(N_LOOKS)[1:]
    ]
    return Looks(
        detectors=tuple(one.detector for one in (first, *others)),
        opened=first,
        max_iou=config.max_iou,
    )


def _silent(_: str) -> None:
    """Say nothing."""


def seen_once(looks: Looks, shot: Shot, which: int = 0) -> Detections:
    """What one of the looks shows of an image."""
    (found,) = looks.detectors[which].detect([shot.frame])
    return within(found, shot.size)


def seen_in_all(looks: Looks, shot: Shot) -> tuple[Detections, Floats]:
    """Droplets of an image, of all looks together, and the share (N,) of looks that show each.

    See `detection.looks.fuse`.
    """
    parts: list[Detections] = []
    mirrored = np.ascontiguousarray(shot.frame[:, ::-1])
    width = shot.frame.shape[1]
    for detector in looks.detectors:
        for frame, turned in ((shot.frame, False), (mirrored, True)):
            (found,) = detector.detect([frame])
            if turned:
                found = mirrored_back(found, width)
            parts.append(within(found, shot.size))
    fused, shares = fuse(parts)
    keep = suppress_duplicates(fused, looks.max_iou, greedy=True)
    order = {tuple(box): share for box, share in zip(fused.boxes.tolist(), shares, strict=True)}
    return keep, np.array([order[tuple(box)] for box in keep.boxes.tolist()])


def within(found: Detections, size: tuple[int, int]) -> Detections:
    """Detections of an image of a size (width, height), cut at its edges."""
    limit = np.array(size, float)
    corners = xyxy_from_boxes(found.boxes)
    corners = np.clip(corners, 0, np.concatenate([limit, limit]))
    boxes = boxes_from_xyxy(corners)
    inside = (found.boxes[:, :2] < limit).all(axis=1) & (boxes[:, 2:] > MIN_SIDE_PX).all(axis=1)
    kept = np.flatnonzero(inside)
    return Detections(boxes[kept], found.scores[kept], found.class_ids[kept])


def cut_by_edge(boxes: Floats, size: tuple[int, int]) -> Bools:
    """Which boxes (N, 4) touch an edge of an image of a size."""
    corners = xyxy_from_boxes(boxes)
    low, high = corners[:, :2] < EDGE_PX, corners[:, 2:] > np.array(size) - EDGE_PX
    return np.asarray((low | high).any(axis=1), bool)


def covered(boxes: Floats, by: Floats) -> Floats:
    """The largest share (N,) of each box (N, 4) that one of other boxes (M, 4) covers."""
    shared = intersections(boxes[:, None], by[None]) / boxes[:, None, 2:].prod(axis=2)
    return np.asarray(shared.max(axis=1, initial=0.0))
