"""What may be droplets of a frame, and how much speaks for each: what several scales show is one.

A network finds droplets of some 10 to 150 px of its input, and says nothing, or something else at
each scale, of others. So a droplet is what the network sees again at other scales: its evidence is
the mean of its scores at all scales that show it in a size the network knows.

Frames are looked at in tiles, so that one compiled network serves all scales, and of a large input
only some tiles are, so that it takes about as long for all frames.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import Detections, iou_matrix
from droptrack.data.frames import Frame, grey_frame, grey_plane
from droptrack.data.stage_times import StageTimes
from droptrack.detection.detector import Detector
from droptrack.detection.suppression import suppress_duplicates

TILE = 480  # px, the sides of the input
STEP = math.sqrt(2)  # from one scale to the next
STEPS = range(-7, 6)  # tried, from the default scale on
MIN_SIDE_PX = 48  # of an input
ALL_SIDE_PX = 96  # of an input; of smaller ones only droplets count that fill the frame, to
FILLING = 0.6  # of its smaller side: other scales do not show these in a size that is known
MAX_AREA_PX = 9e6  # of an input
MARGIN_PX = 2.0  # of the input, between a whole droplet and a tile's edge
MAX_TILES = 6  # looked at in a frame, at each scale
KNOWN_PX = (12.0, 120.0)  # sizes of droplets in the input
MIN_SEEN_PX = 6.0  # of the frame: what is smaller may be dust, or a block of JPEG
MIN_SCORE = 0.1  # of a detection that counts at all
SURE = 0.4  # of one that a user would get
SAME_IOU = 0.5  # of two boxes of one droplet
DOUBT = 0.35  # evidence below which a detection does harm
CERTAIN = 0.5  # evidence of a droplet, so that what is in it is none
MIN_INSIDE = 0.8  # share of a box's area
MIN_SHOWN = 3  # scales that full evidence takes


@dataclass(frozen=True, kw_only=True)
class Look:
    """What one scale shows of a frame: boxes (N, 4) px of the frame, their scores (N,), and the
    tiles (T, 4) [left, top, right, bottom] px that were looked at; whether these are all.
    """  # noqa: D205

    boxes: Floats
    scores: Floats
    tiles: Floats
    is_whole: bool

    def covers(self, boxes: Floats, size: tuple[int, int], margin: float) -> Bools:
        """Which boxes (N,) lie whole in a tile, or end with it at the frame's edge."""
        low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
        first = np.where(self.tiles[:, :2] > 0, self.tiles[:, :2] + margin, -np.inf)
        last = np.where(self.tiles[:, 2:] < size, self.tiles[:, 2:] - margin, np.inf)
        inside = (low[:, None] >= first) & (high[:, None] <= last)
        return np.asarray(np.any(np.all(inside, axis=2), axis=1), bool)

    def reaches(self, boxes: Floats) -> Bools:
        """Which boxes (N,) have their centres in a tile, whole or not."""
        centres = boxes[:, None, :2]
        inside = (centres >= self.tiles[:, :2]) & (centres <= self.tiles[:, 2:])
        return np.asarray(np.any(np.all(inside, axis=2), axis=1), bool)


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What may be droplets of a frame of `size` (width, height) px, by all `looks` together.

    Boxes (N, 4) px, their scores (scales, N) at each scale, and their evidence (N,).
    """

    size: tuple[int, int]
    looks: dict[float, Look]
    boxes: Floats
    scores: Floats
    evidence: Floats

    @property
    def diameters(self) -> Floats:
        """sqrt(w h), (N,) px."""
        return np.asarray(np.sqrt(self.boxes[:, 2:].prod(axis=1)))


def look_for_droplets(frame: Frame, detector: Detector, default: float) -> Seen:
    """What may be droplets of a frame (H, W, 3), at the scales around a default one.

    `detector`: on inputs of TILE x TILE px, without a canvas, with a threshold of MIN_SCORE.
    """
    size = (frame.shape[1], frame.shape[0])
    looks = _look(frame, detector, default)
    boxes, scores = _merged(looks, size)
    evidence = _evidence(boxes, scores, looks, size)
    return Seen(size=size, looks=looks, boxes=boxes, scores=scores, evidence=evidence)


def scales_for(width: int, height: int, default: float) -> list[float]:
    """The scales that are tried for frames of a size, the default one among them.

    >>> [round(scale, 2) for scale in scales_for(1200, 600, 0.8)]
    [0.1, 0.14, 0.2, 0.28, 0.4, 0.57, 0.8, 1.13, 1.6, 2.26, 3.2]
    """
    scales = (default * STEP**k for k in STEPS)
    return [
        scale
        for scale in scales
        if scale * min(width, height) >= MIN_SIDE_PX and scale**2 * width * height <= MAX_AREA_PX
    ]


def _look(frame: Frame, detector: Detector, default: float) -> dict[float, Look]:
    """What each scale shows of a frame, from the coarsest on."""
    height, width = frame.shape[:2]
    plane = grey_plane(frame)
    image = np.asarray(frame if plane is None else plane)
    looks: dict[float, Look] = {}
    found = np.zeros((0, 2))  # centres of what coarser scales showed
    for scale in scales_for(width, height, default):
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        resized = np.asarray(cv2.resize(image, size), np.uint8)
        tiles = _tiles(size, found * scale)
        running = [detector.start([_cut(resized, tile)], StageTimes()) for tile in tiles]
        parts = [_whole(wait()[0], tile, size) for wait, tile in zip(running, tiles, strict=True)]
        together = Detections(
            np.concatenate([part.boxes for part in parts]),
            np.concatenate([part.scores for part in parts]),
            np.zeros(sum(len(part) for part in parts), np.int64),  # whatever its class
        )
        seen = suppress_duplicates(together, detector.max_iou, greedy=True)  # tiles overlap
        counted = _counts(seen.boxes / scale, scale, (width, height))
        looks[scale] = Look(
            boxes=seen.boxes[counted] / scale,
            scores=seen.scores[counted],
            tiles=np.minimum(tiles / scale, [width, height, width, height]),
            is_whole=len(tiles) == math.prod(_n_tiles(size)),
        )
        found = np.concatenate([found, looks[scale].boxes[looks[scale].scores >= SURE, :2]])
    return looks


def _tiles(size: tuple[int, int], places: Floats) -> Floats:
    """At most MAX_TILES tiles (T, 4) px of an input of a size: where most of the places are.

    Where there are none, those in the middle.
    """
    columns, rows = _n_tiles(size)
    starts = [
        np.linspace(0, max(0, side - TILE), n)
        for side, n in zip(size, (columns, rows), strict=True)
    ]
    corners = np.round(np.array([[x, y] for y in starts[1] for x in starts[0]]))
    if len(corners) > MAX_TILES:
        within = (places[:, None] >= corners) & (places[:, None] < corners + TILE)
        away = np.hypot(*(corners + TILE / 2 - np.array(size) / 2).T)
        order = np.lexsort([away, -within.all(axis=2).sum(axis=0)])
        corners = corners[order[:MAX_TILES]]
    return np.hstack([corners, corners + TILE])


def _n_tiles(size: tuple[int, int]) -> tuple[int, int]:
    """Columns and rows of the tiles that an input of a size has."""
    return max(1, math.ceil(size[0] / TILE)), max(1, math.ceil(size[1] / TILE))


def _cut(image: Frame, tile: Floats) -> Frame:
    """A tile of an image (H, W) or (H, W, 3), extended by its edge where it is smaller."""
    left, top, right, bottom = tile.astype(int).tolist()
    part = image[top:bottom, left:right]
    below, beside = TILE - part.shape[0], TILE - part.shape[1]
    whole = np.asarray(
        cv2.copyMakeBorder(part, 0, below, 0, beside, cv2.BORDER_REPLICATE), np.uint8
    )
    return grey_frame(whole) if whole.ndim == 2 else whole


def _whole(found: Detections, tile: Floats, size: tuple[int, int]) -> Detections:
    """What a tile of an input of a size shows whole: no edge of the tile cuts it; px of the input.

    The input's own edges may.
    """
    boxes = np.column_stack([found.boxes[:, :2] + tile[:2], found.boxes[:, 2:]])
    low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
    inside = (low >= np.where(tile[:2] > 0, tile[:2] + MARGIN_PX, -np.inf)) & (
        high <= np.where(tile[2:] < size, tile[2:] - MARGIN_PX, np.inf)
    )
    keep = np.asarray(inside.all(axis=1), bool)
    return Detections(boxes[keep], found.scores[keep], found.class_ids[keep])


def _merged(looks: dict[float, Look], size: tuple[int, int]) -> tuple[Floats, Floats]:
    """What may be droplets, seen at one or more scales: boxes (N, 4), scores (scales, N) or 0."""
    boxes, scores = np.zeros((0, 4)), np.zeros((len(looks), 0))
    for k, (scale, look) in enumerate(looks.items()):
        whole = look.covers(look.boxes, size, MARGIN_PX / scale)
        mine, certain = look.boxes[whole], look.scores[whole]
        old, new = _pairs(boxes, mine)
        scores[k, old] = certain[new]
        better = certain[new] >= scores[:, old].max(axis=0, initial=0)
        boxes[old[better]] = mine[new[better]]
        alone = np.setdiff1d(np.arange(len(mine)), new)
        added = np.zeros((len(looks), len(alone)))
        added[k] = certain[alone]
        boxes = np.concatenate([boxes, mine[alone]])
        scores = np.hstack([scores, added])
    return boxes, scores


def _pairs(these: Floats, those: Floats) -> tuple[Rows, Rows]:
    """Which boxes are each other's best, and of one droplet."""
    if not len(these) or not len(those):
        return np.zeros(0, int), np.zeros(0, int)
    iou = iou_matrix(these, those)
    best = iou.argmax(axis=1)
    mine = np.arange(len(these))
    mutual = (iou.argmax(axis=0)[best] == mine) & (iou[mine, best] >= SAME_IOU)
    return np.flatnonzero(mutual), best[mutual]


def _evidence(
    boxes: Floats, scores: Floats, looks: dict[float, Look], size: tuple[int, int]
) -> Floats:
    """The mean score (N,) over the scales that show a droplet whole, in a size that is known."""
    sides = np.sqrt(boxes[:, 2:].prod(axis=1))
    shown = np.stack(
        [
            (sides * scale >= KNOWN_PX[0])
            & (sides * scale <= KNOWN_PX[1])
            & look.covers(boxes, size, MARGIN_PX / scale)
            & _counts(boxes, scale, size)
            for scale, look in looks.items()
        ]
    )
    shown &= sides >= MIN_SEEN_PX
    mean = (scores * shown).sum(axis=0) / np.maximum(shown.sum(axis=0), MIN_SHOWN)
    return _without_what_is_inside(boxes, mean, size)


def _counts(boxes: Floats, scale: float, size: tuple[int, int]) -> Bools:
    """Which boxes (N, 4) px of a frame of a size a scale speaks for: all, or what fills it."""
    return _fills(boxes, size) | (scale * min(size) >= ALL_SIDE_PX)


def _fills(boxes: Floats, size: tuple[int, int]) -> Bools:
    """Which boxes (N, 4) px are of droplets that fill a frame of a size."""
    return np.asarray(np.sqrt(boxes[:, 2:].prod(axis=1)) >= FILLING * min(size), bool)


def _without_what_is_inside(boxes: Floats, evidence: Floats, size: tuple[int, int]) -> Floats:
    """The evidence (N,), 0 of what lies in a droplet at least twice as large: cells, reflections.

    And of what fills the frame and has droplets in it that are larger than it in a row: the view.
    """
    evidence = evidence.copy()
    inside = np.zeros(len(boxes), bool)
    corners = np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])
    area = boxes[:, 2:].prod(axis=1)
    fills = _fills(boxes, size)
    for outer in np.flatnonzero(evidence > CERTAIN):
        shared = np.minimum(corners[:, 2:], corners[outer, 2:]) - np.maximum(
            corners[:, :2], corners[outer, :2]
        )
        within = np.maximum(shared, 0).prod(axis=1) > MIN_INSIDE * area
        within &= 4 * area < area[outer]
        row = np.sqrt(area[within & (evidence > DOUBT)]).sum()
        if fills[outer] and row > np.sqrt(area[outer]):
            evidence[outer] = 0
        else:
            inside |= within
    return np.where(inside, 0.0, evidence)
