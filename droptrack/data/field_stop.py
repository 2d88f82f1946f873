"""A round field stop: the dark surroundings of the disc that a microscope or an endoscope shows."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from droptrack.data.arrays import Bools, Floats, Pixels
from droptrack.data.frames import Frame
from droptrack.data.region import Region

CORNER_PX = 5
MIN_CORNERS = 3  # that are dark alike,
MAX_SPREAD = 8  # within so many grey levels,
MIN_DARKER = 40  # and darker than the middle by so many
MIN_DIAMETER = 0.8  # of the disc, in units of the image's shorter side: a droplet is smaller,
MAX_RADIUS = 0.75  # and a straight wall has a larger radius, in units of its diagonal
MAX_OFF, MAX_OFF_PX = 0.005, 0.7  # of the border from its circle, rms, in radii and px
MAX_WRONG = 0.005  # share of the image that is dark in the disc, or bright outside


@dataclass(frozen=True)
class FieldStop:
    """The disc that is to be seen: its centre and radius, px, and its pixels."""

    x: float
    y: float
    radius: float
    region: Region

    def __str__(self) -> str:
        return f"a round field stop, {2 * self.radius:.0f} px wide at {self.x:.0f}, {self.y:.0f}"


def find_field_stop(frames: Sequence[Frame]) -> FieldStop | None:
    """The field stop in frames (H, W, 3) of one size, by what is dark in all of them; None: none.

    >>> from droptrack.data.frames import grey_frame
    >>> y, x = np.mgrid[:200, :300] + 0.5
    >>> disc = 90 * (np.hypot(x - 150, y - 100) < 95)
    >>> stop = find_field_stop([grey_frame((disc + 10).astype(np.uint8))])
    >>> round(stop.x), round(stop.y), round(stop.radius)
    (150, 100, 95)
    """
    brightest = np.max([frame.max(axis=2) for frame in frames], axis=0)
    height, width = brightest.shape
    if min(height, width) < 10 * CORNER_PX:
        return None
    dark = _dark_corners(brightest)
    if dark is None:
        return None
    border = cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    border[[0, -1]] = border[:, [0, -1]] = 0
    rows, columns = np.nonzero(border)
    if len(rows) < 4 * CORNER_PX:
        return None
    x, y, radius, off = _circle(columns.astype(np.float64) + 0.5, rows.astype(np.float64) + 0.5)
    if not (MIN_DIAMETER * min(height, width) / 2 < radius < MAX_RADIUS * np.hypot(height, width)):
        return None
    disc = np.hypot(*(np.ogrid[:height, :width][k] + 0.5 - (y, x)[k] for k in (0, 1))) < radius
    if off > MAX_OFF * radius + MAX_OFF_PX or (disc == dark).mean() > MAX_WRONG:
        return None
    return FieldStop(x, y, radius, Region(np.asarray(disc)))


def _dark_corners(brightest: Pixels) -> Bools | None:
    """What is dark (H, W) and hangs together with a dark corner; None where too few corners are."""
    height, width = brightest.shape
    middle = brightest[height // 4 : -(height // 4), width // 4 : -(width // 4)]
    places = [(y, x) for y in (0, height - CORNER_PX) for x in (0, width - CORNER_PX)]
    levels = np.array(
        [np.median(brightest[y : y + CORNER_PX, x : x + CORNER_PX]) for y, x in places]
    )
    darkest, bright = float(levels.min()), float(np.median(middle))
    alike = levels <= darkest + MAX_SPREAD
    if alike.sum() < MIN_CORNERS or bright < darkest + MIN_DARKER:
        return None
    dark = (brightest < (darkest + bright) / 2).astype(np.uint8)
    _, parts = cv2.connectedComponents(dark, connectivity=4)
    of_corners = [int(parts[place]) for place, one in zip(places, alike, strict=True) if one]
    return np.asarray(np.isin(parts, [one for one in of_corners if one]))


def _circle(x: Floats, y: Floats) -> tuple[float, float, float, float]:
    """Centre and radius of the circle through points (K,) (Kasa 1976), and how far they are off."""
    middle = np.array([x.mean(), y.mean()])
    u, v = x - middle[0], y - middle[1]
    table = np.column_stack([2 * u, 2 * v, np.ones(len(u))])
    (a, b, c), *_ = np.linalg.lstsq(table, u * u + v * v, rcond=None)
    radius = float(np.sqrt(max(c + a * a + b * b, 0)))
    off = np.hypot(u - a, v - b) - radius
    return float(middle[0] + a), float(middle[1] + b), radius, float(np.sqrt((off**2).mean()))
