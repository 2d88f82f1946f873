"""The picture of all paths, drawn without a plotting library, whose start takes longer than a run.

Every run ends with one: of a short video, or of a thousand of them, the time counts.
"""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from droptrack.data.files import replacing
from droptrack.pipeline.drawing import colour_of

AXES_PX, MAX_HEIGHT_PX = 1200, 4000  # of the frame's picture
LEFT, RIGHT, TOP, BOTTOM = 80, 30, 44, 64  # margins, px
TICK, MAX_TICKS = 6, 8
TITLE_PX, TEXT_PX, ID_PX = 22, 18, 13
SHADE = 0.85  # of the tracks' colours, on white
BLACK, WHITE = (0, 0, 0), (255, 255, 255)


def draw_paths(
    path: Path, lines: Mapping[int, NDArray[np.float32]], width: int, height: int
) -> None:
    """The paths (K, 2) px of all droplets in the image's frame, as the paper's figures 8, 10."""
    scale = min(AXES_PX / width, MAX_HEIGHT_PX / height)
    wide, high = max(round(scale * width), 1), max(round(scale * height), 1)
    area = np.full((high, wide, 3), 255, np.uint8)
    for track_id, points in lines.items():
        colour = tuple(SHADE * level for level in colour_of(track_id)[::-1])
        corners = np.round(16 * scale * points).astype(np.int32)
        cv2.polylines(area, [corners], False, colour, 2, cv2.LINE_AA, shift=4)
        cv2.circle(area, corners[-1].tolist(), 4 * 16, colour, -1, cv2.LINE_AA, shift=4)
    picture = Image.new("RGB", (LEFT + wide + RIGHT, TOP + high + BOTTOM), WHITE)
    picture.paste(Image.fromarray(area), (LEFT, TOP))
    draw = ImageDraw.Draw(picture)
    small = ImageFont.load_default(ID_PX)
    for track_id, points in lines.items():
        x, y = (scale * points[-1]).tolist()
        if 0 <= x <= wide and 0 <= y <= high:
            draw.text((LEFT + x, TOP + y), str(track_id), BLACK, small, anchor="ls")
    draw.rectangle((LEFT, TOP, LEFT + wide, TOP + high), outline=BLACK)
    _label_axes(picture, draw, width, height, scale)
    title = ImageFont.load_default(TITLE_PX)
    middle = LEFT + wide / 2
    called = "droplet" if len(lines) == 1 else "droplets"
    draw.text((middle, TOP - 12), f"{len(lines)} {called}", BLACK, title, anchor="ms")
    with replacing(path) as partial:
        picture.save(partial, compress_level=3)


def _label_axes(
    picture: Image.Image, draw: ImageDraw.ImageDraw, width: int, height: int, scale: float
) -> None:
    """Ticks, their numbers, and what the axes are."""
    font = ImageFont.load_default(TEXT_PX)
    bottom = TOP + round(scale * height)
    for value in ticks(width):
        x = LEFT + scale * value
        draw.line((x, bottom, x, bottom + TICK), BLACK)
        draw.text((x, bottom + TICK + 3), str(value), BLACK, font, anchor="ma")
    for value in ticks(height):
        y = TOP + scale * value
        draw.line((LEFT - TICK, y, LEFT, y), BLACK)
        draw.text((LEFT - TICK - 4, y), str(value), BLACK, font, anchor="rm")
    draw.text((LEFT + scale * width / 2, bottom + 34), "x / px", BLACK, font, anchor="ma")
    box = font.getbbox("y / px")
    label = Image.new("RGB", (int(box[2]) + 2, int(box[3]) + 2), WHITE)
    ImageDraw.Draw(label).text((0, 0), "y / px", BLACK, font)
    turned = label.transpose(Image.Transpose.ROTATE_90)
    picture.paste(turned, (6, max(0, (TOP + bottom - turned.height) // 2)))


def ticks(length: int) -> range:
    """Round numbers from 0 to a length, not more than MAX_TICKS steps of them.

    >>> list(ticks(600)), list(ticks(35))
    ([0, 100, 200, 300, 400, 500, 600], [0, 5, 10, 15, 20, 25, 30, 35])
    """
    steps = (factor * 10**power for power in range(12) for factor in (1, 2, 5))
    step = next(step for step in steps if length <= MAX_TICKS * step)
    return range(0, length + 1, step)
