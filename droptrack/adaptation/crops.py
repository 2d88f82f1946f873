"""Real droplets, cut out with what they change around them, and pasted elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from droptrack.adaptation.appearance import OUTSIDE, Measured
from droptrack.adaptation.backgrounds import pixels_of
from droptrack.data.arrays import Float32s, Floats, Pixels
from droptrack.data.detections import iou_matrix
from droptrack.data.set_up import View, outline_distance, part_of

MAX_CROPS = 300
SOFT_PX = 3.0  # over which a crop fades out around its droplet
SIZE_SPREAD = 0.06  # by which pasted droplets are larger or smaller, as a logarithm
MAX_OVERLAP = 0.03  # IoU of droplets that are pasted
TRIES = 10  # places that are tried for each


@dataclass(frozen=True)
class Crop:
    """A droplet: what it changes, (h, w, C) grey levels, and its box (4,) px in that part.

    `view`: the number of the view that it was cut out of.
    """

    change: Float32s
    box: Floats
    view: int


def cut_out(measured: Measured, rng: np.random.Generator) -> list[Crop]:
    """Up to MAX_CROPS of the droplets that no edge cuts; labelled ones first."""
    places = [
        (one.labelled, number, box)
        for number, one in enumerate(measured.seen)
        for box in one.trusted[one.whole]
    ]
    order = rng.permutation(len(places))
    chosen = sorted((places[i] for i in order), key=lambda place: not place[0])[:MAX_CROPS]
    crops = []
    for _, number, box in chosen:
        one, number_of_view = measured.seen[number], measured.view_of[number]
        view = measured.set_up.views[number_of_view]
        behind = view.background
        height, width, channels = behind.shape
        rows, columns, x, y = part_of(box, (width, height), OUTSIDE)
        distance = outline_distance(box, view.profile.corners, x, y)
        share = np.clip((OUTSIDE - distance) / SOFT_PX, 0, 1)[..., None]
        change = pixels_of(one, channels)[rows, columns].astype(np.float32)
        change -= behind[rows, columns]
        place = box - [columns.start, rows.start, 0, 0]
        crops.append(Crop(np.asarray(share * change, np.float32), place, number_of_view))
    return crops


def paste(rng: np.random.Generator, view: View, crops: Sequence[Crop]) -> tuple[Pixels, Floats]:
    """An image (H, W, C) of a view with real droplets, and their boxes (N, 4) px.

    So many as in one of its frames, at places where droplets were seen, none over another.
    """
    canvas = view.background.astype(np.float32)
    n = len(view.frames[rng.integers(len(view.frames))])
    seen = np.concatenate(view.frames)
    placed = np.zeros((0, 4))
    for _ in range(TRIES * n):
        if len(placed) >= n or not len(seen):
            break
        crop = _varied(rng, crops[int(rng.integers(len(crops)))])
        target = seen[rng.integers(len(seen))]
        centre = target[:2] + rng.normal(0, 0.03, 2) * target[2:].min()
        box = _add(canvas, crop, centre, placed)
        if box is not None:
            placed = np.vstack([placed, box])
    return np.clip(canvas + np.float32(0.5), 0, 255).astype(np.uint8), placed


def _varied(rng: np.random.Generator, crop: Crop) -> Crop:
    """A crop mirrored, a little larger or smaller, and with a little more or less contrast."""
    change, box = crop.change, crop.box.copy()
    height, width = change.shape[:2]
    if rng.random() < 0.5:
        change, box[0] = change[:, ::-1], width - box[0]
    if rng.random() < 0.5:
        change, box[1] = change[::-1], height - box[1]
    factor = float(np.exp(rng.normal(0, SIZE_SPREAD)))
    size = (max(2, round(width * factor)), max(2, round(height * factor)))
    resized = cv2.resize(np.ascontiguousarray(change), size)
    resized = np.asarray(resized, np.float32).reshape(size[1], size[0], -1)
    box *= np.tile(np.array(size) / [width, height], 2)
    return Crop(resized * np.float32(rng.uniform(0.85, 1.15)), box, crop.view)


def _add(canvas: Float32s, crop: Crop, centre: Floats, placed: Floats) -> Floats | None:
    """Add a crop at a place, in place; its box, or None where it does not fit in."""
    height, width = crop.change.shape[:2]
    left, top = np.round(centre - crop.box[:2]).astype(int).tolist()
    if left < 0 or top < 0 or left + width > canvas.shape[1] or top + height > canvas.shape[0]:
        return None
    box = crop.box + np.array([left, top, 0, 0])
    if (iou_matrix(box[None], placed) > MAX_OVERLAP).any():
        return None
    canvas[top : top + height, left : left + width] += crop.change
    return np.asarray(box)
