"""Boxes, IDs and fading trails on frames."""

import colorsys
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from droptrack.data.detections import Detections, xyxy_from_boxes
from droptrack.data.units import PIXELS, Units, scale_bar
from droptrack.tracking.recorder import Row

Frame = NDArray[np.uint8]

TRAIL_FRAMES = 40
TEXT_PX = 15
BOX_COLOUR = (60, 140, 255)  # BGR
# of classes, BGR, told apart by the colour-blind, too (Okabe & Ito 2008)
CLASS_COLOURS = (
    *((0, 159, 230), (233, 180, 86), (115, 158, 0), (66, 228, 240)),
    *((167, 121, 204), (0, 94, 213), (178, 114, 0)),
)
MAX_SMALL_PX = 700  # of an image whose boxes are drawn thinner


def colour_of(track_id: int) -> tuple[int, int, int]:
    """A BGR colour of a track, unlike those of the tracks before it."""
    red, green, blue = colorsys.hsv_to_rgb(track_id * 0.618034 % 1, 0.85, 1.0)
    return int(255 * blue), int(255 * green), int(255 * red)


def colour_of_class(class_id: int) -> tuple[int, int, int]:
    """The BGR colour of a class."""
    known = class_id < len(CLASS_COLOURS)
    return CLASS_COLOURS[class_id] if known else colour_of(class_id)


class Annotator:
    """Draws frame after frame, and remembers the trails; with a scale bar where it is known.

    Where there are `classes`, their names, each has a colour, and a droplet that of the class that
    it had most often so far, which is the last value of its rows.
    """

    def __init__(self, units: Units = PIXELS, classes: Sequence[str] = ()) -> None:
        self._units, self._classes = units, classes
        self._trails: dict[int, list[tuple[int, float, float]]] = {}
        self._votes: dict[int, Counter[int]] = {}

    def draw(self, index: int, frame: Frame, rows: Iterable[Row]) -> Frame:
        """A copy of the frame (H, W, 3) with the box, ID and trail of every row."""
        image = frame.copy()
        rows = list(rows)
        for row in rows:
            self._trails.setdefault(row.track_id, []).append((index, *row.values[:2].tolist()))
            votes = self._votes.setdefault(row.track_id, Counter())
            if self._classes and np.isfinite(row.values[-1]):
                votes[int(row.values[-1])] += 1
        for track_id, trail in list(self._trails.items()):
            recent = [point for point in trail if point[0] > index - TRAIL_FRAMES]
            if recent:
                self._trails[track_id] = recent
                _draw_trail(image, recent, index, self._colour(track_id))
            else:
                del self._trails[track_id], self._votes[track_id]
        for row in rows:
            _draw_box(image, row, self._colour(row.track_id))
        draw_labels(image, [(name, colour_of_class(k)) for k, name in enumerate(self._classes)])
        if self._units.um_per_px is not None:
            draw_scale_bar(image, self._units.um_per_px)
        return image

    def _colour(self, track_id: int) -> tuple[int, int, int]:
        """A track's own, or that of its class so far."""
        votes = self._votes[track_id].most_common(1)
        return colour_of_class(votes[0][0]) if votes else colour_of(track_id)


def draw_scale_bar(image: Frame, um_per_px: float) -> None:
    """Draw a scale bar with its length into the lower right corner of an image (H, W, 3)."""
    height, width = image.shape[:2]
    length, px = scale_bar(um_per_px, width)
    label = _text(f"{length:g} µm", (255, 255, 255))
    right, bottom = width - 10, height - 10
    left, top = max(right - px, 0), max(bottom - 4, 0)
    cv2.rectangle(image, (left - 2, top - 2), (right + 2, bottom + 2), (0, 0, 0), -1)
    cv2.rectangle(image, (left, top), (right, bottom), (255, 255, 255), -1)
    high, wide = label.shape[:2]
    y, x = top - 4 - high, (left + right - wide) // 2
    if y >= 0 and x >= 0 and x + wide <= width:
        image[y : y + high, x : x + wide] = label


def draw_boxes(frame: Frame, found: Detections, classes: Sequence[str] = ()) -> Frame:
    """A copy of a frame (H, W, 3) with the boxes of its droplets, and their number.

    Where there are `classes`, their names, in the colours of these, and with the number of each.
    """
    image = np.ascontiguousarray(frame).copy()
    thickness = 1 if max(image.shape) < MAX_SMALL_PX else 2
    corners = xyxy_from_boxes(found.boxes).round().astype(int).tolist()
    for (left, top, right, bottom), k in zip(corners, found.class_ids.tolist(), strict=True):
        colour = colour_of_class(k) if classes else BOX_COLOUR
        cv2.rectangle(image, (left, top), (right, bottom), colour, thickness)
    labels = [(str(len(found)), colour_of(len(found)))]
    if classes:
        numbers = np.bincount(found.class_ids, minlength=len(classes)).tolist()
        labels = [(f"{name} {numbers[k]}", colour_of_class(k)) for k, name in enumerate(classes)]
    draw_labels(image, labels)
    return image


def draw_labels(image: Frame, labels: Iterable[tuple[str, tuple[int, int, int]]]) -> None:
    """Draw texts on colours, one below the other, into the upper left corner of an image."""
    top = 0
    for text, colour in labels:
        label = _text(text, colour)
        height, width = (
            min(label.shape[0], image.shape[0] - top),
            min(label.shape[1], image.shape[1]),
        )
        image[top : top + height, :width] = label[:height, :width]
        top += height


def _draw_trail(
    image: Frame, trail: list[tuple[int, float, float]], now: int, colour: tuple[int, int, int]
) -> None:
    """Older pieces fade into a dark shade of the colour."""
    points = [(round(x * 16), round(y * 16)) for _, x, y in trail]
    for start, end, (frame, _, _) in zip(points, points[1:], trail[1:], strict=False):
        fade = 1 - (now - frame) / TRAIL_FRAMES
        shade = tuple(int(level * (0.2 + 0.8 * fade)) for level in colour)
        cv2.line(image, start, end, shade, 2, cv2.LINE_AA, shift=4)


def _draw_box(image: Frame, row: Row, colour: tuple[int, int, int]) -> None:
    cx, cy, w, h = row.values[2:6]
    corners = np.array([cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2]).round().astype(int)
    left, top, right, bottom = corners.tolist()
    cv2.rectangle(image, (left, top), (right, bottom), colour, 2 if row.observed else 1)
    label = _text(str(row.track_id), colour)
    height, width = label.shape[:2]
    frame_height, frame_width = image.shape[:2]
    x0 = min(max(left, 0), frame_width - width)
    y0 = top - height if top >= height else min(bottom, frame_height - height)
    if x0 >= 0 and y0 >= 0:
        image[y0 : y0 + height, x0 : x0 + width] = label


@lru_cache(maxsize=4096)
def _text(text: str, colour: tuple[int, int, int]) -> Frame:
    """Text in black on a BGR colour; Pillow sets type better than OpenCV."""
    font = ImageFont.load_default(TEXT_PX)
    left, top, right, bottom = font.getbbox(text)
    size = (int(right - left) + 6, int(bottom - top) + 5)
    blue, green, red = colour
    image = Image.new("RGB", size, (red, green, blue))
    ImageDraw.Draw(image).text((3 - left, 2 - top), text, (0, 0, 0), font)
    return np.asarray(image, np.uint8)[..., ::-1]
