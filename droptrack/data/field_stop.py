"""A round field stop: the dark surroundings of the disc that a microscope or an endoscope shows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from droptrack.data.arrays import Bools, Floats, Pixels
from droptrack.data.frames import Frame
from droptrack.data.region import Region

CORNER_PX = 5
MIN_CORNERS = 2  # that are dark alike,
MAX_SPREAD = 8  # within so many grey levels,
MIN_DARKER = 40  # and darker than the middle by so many
MIN_DIAMETER = 0.8  # of the disc, in units of the image's shorter side: a droplet is smaller,
MAX_RADIUS = 0.75  # and a straight wall has a larger radius, in units of its diagonal
N_TRIED = 16  # places on the border; each three of them tell a circle
MAX_OFF, MAX_OFF_PX = 0.005, 0.7  # of the border from its circle, in radii and px
MIN_ON = 0.6  # share of the border that is on its circle, and of the circle that is border,
N_REFINED = 4  # times a circle is drawn through the places near it where it is half as bright,
N_ANGLES, MIN_PLACES = 720, 40  # on so many rays, at least on so many,
NEAR, NEAR_PX = 0.08, (8.0, 40.0)  # within so many radii, but not less and not more px of it;
OFF_PX, MAX_OFF_SPREAD = 0.5, 4.0  # without those that are off by more, and by so many medians
BESIDE_PX = 4  # so far from which it is bright inside and dark outside: walls are dark, too
MAX_WRONG = 0.005  # share of the image that is bright outside of the disc


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
    typical = np.median([frame.max(axis=2) for frame in frames], axis=0)
    found = (_stop_of(dark, typical) for dark in _dark_corners(brightest))
    return next((stop for stop in found if stop is not None), None)


def _stop_of(dark: Bools, levels: Floats) -> FieldStop | None:
    """The field stop whose surroundings are dark (H, W), in levels (H, W); None: it is not one."""
    places, (height, width) = _border(dark), dark.shape
    if len(places) < 4 * CORNER_PX:
        return None
    radii = MIN_DIAMETER * min(height, width) / 2, MAX_RADIUS * float(np.hypot(height, width))
    rough = refined = _circle(places, radii)
    if not radii[0] < rough[2] < radii[1]:
        return None
    for _ in range(N_REFINED):
        refined = _refined(levels, float(levels[dark].min()), *refined)
    for x, y, radius in (refined, rough):
        disc = np.hypot(*(np.ogrid[:height, :width][k] + 0.5 - (y, x)[k] for k in (0, 1))) < radius
        if (
            radii[0] < radius < radii[1]
            and _on(places, x, y, radius).mean() >= MIN_ON
            and (~disc & ~dark).mean() <= MAX_WRONG
            and _share_of_edge(dark, x, y, radius) >= MIN_ON
        ):
            return FieldStop(x, y, radius, Region(np.asarray(disc)))
    return None


def _dark_corners(brightest: Pixels) -> Iterator[Bools]:
    """What is dark (H, W) and hangs together with a dark corner; nothing where too few corners are.

    Dark is what is less than half as bright as what is near; then, as the middle of the image: the
    edge of a stop is soft, and any one level of it lies further out where it is brighter inside.
    """
    height, width = brightest.shape
    middle = brightest[height // 4 : -(height // 4), width // 4 : -(width // 4)]
    places = [(y, x) for y in (0, height - CORNER_PX) for x in (0, width - CORNER_PX)]
    levels = np.array(
        [np.median(brightest[y : y + CORNER_PX, x : x + CORNER_PX]) for y, x in places]
    )
    darkest, bright = float(levels.min()), float(np.median(middle))
    alike = levels <= darkest + MAX_SPREAD
    if alike.sum() < MIN_CORNERS or bright < darkest + MIN_DARKER:
        return
    side = 2 * int(np.clip(NEAR * min(height, width), *NEAR_PX)) + 1
    around = cv2.dilate(cv2.medianBlur(brightest, CORNER_PX), np.ones((side, side), np.uint8))
    near = np.where(around > darkest + MIN_DARKER, around.astype(float), bright)
    for lit in (near, bright):
        dark = (brightest < (darkest + lit) / 2).astype(np.uint8)
        _, parts = cv2.connectedComponents(dark, connectivity=4)
        of_corners = [int(parts[place]) for place, one in zip(places, alike, strict=True) if one]
        yield np.asarray(np.isin(parts, [one for one in of_corners if one]))


def _border(dark: Bools) -> Floats:
    """Places (K, 2) px where the dark (H, W) ends, from each side of the image inwards."""
    places = []
    for turned, flipped in ((False, False), (False, True), (True, False), (True, True)):
        lines = dark.T if turned else dark
        lines = lines[:, ::-1] if flipped else lines
        some = np.flatnonzero(lines[:, 0] & ~lines.all(axis=1))
        depth = (~lines[some]).argmax(axis=1).astype(float)
        depth = lines.shape[1] - depth if flipped else depth
        both = (some + 0.5, depth) if turned else (depth, some + 0.5)
        places.append(np.column_stack(both))
    return np.concatenate(places)


def _circle(places: Floats, limits: tuple[float, float]) -> tuple[float, float, float]:
    """Centre and radius px of the circle that most of some places (K, 2) are on; zeros: none.

    Of those through each three of N_TRIED of them, with a radius within limits, the one with the
    most places; then by least squares (Kasa 1976) through the places on it.
    """
    tried = places[np.linspace(0, len(places) - 1, N_TRIED).astype(int)]
    three = tried[np.array(list(combinations(range(N_TRIED), 3)))]  # (T, 3, 2)
    first, sides = three[:, 0], three[:, 1:] - three[:, :1]
    area = 2 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    first, sides = (one[np.abs(area) > 1] for one in (first, sides))
    if not len(first):
        return 0.0, 0.0, 0.0
    offsets = np.linalg.solve(2 * sides, (sides**2).sum(axis=2, keepdims=True))[..., 0]
    found = np.column_stack([first + offsets, np.hypot(*offsets.T)])
    found = found[(found[:, 2] > limits[0]) & (found[:, 2] < limits[1])]
    if not len(found):
        return 0.0, 0.0, 0.0
    some = places[:: max(1, len(places) // 500)]
    n_on = [_on(some, *circle).sum() for circle in found.tolist()]
    x, y, radius = found[int(np.argmax(n_on))].tolist()
    for _ in range(2):
        x, y, radius = _fitted(places[_on(places, x, y, radius)])
    return x, y, radius


def _fitted(places: Floats) -> tuple[float, float, float]:
    """Centre and radius px of the circle with the least squares (Kasa 1976) through places."""
    middle = places.mean(axis=0)
    u, v = (places - middle).T
    table = np.column_stack([2 * u, 2 * v, np.ones(len(u))])
    (a, b, c), *_ = np.linalg.lstsq(table, u * u + v * v, rcond=None)
    radius = float(np.sqrt(max(c + a * a + b * b, 0)))
    return float(middle[0] + a), float(middle[1] + b), radius


def _refined(
    levels: Floats, dark: float, x: float, y: float, radius: float
) -> tuple[float, float, float]:
    """A circle through the places near it where levels (H, W) fall to half of those inside.

    Places that are off the circle through most of them do not count.
    """
    reach = float(np.clip(NEAR * radius, *NEAR_PX))
    off = np.arange(-reach, reach, 0.5)
    angles = np.linspace(0, 2 * np.pi, N_ANGLES, endpoint=False)[:, None]
    columns, rows = x + (radius + off) * np.cos(angles), y + (radius + off) * np.sin(angles)
    height, width = levels.shape
    there = (columns > 0) & (columns < width) & (rows > 0) & (rows < height)
    x_map, y_map = (np.asarray(one - 0.5, np.float32) for one in (columns, rows))
    seen = cv2.remap(levels.astype(np.float32), x_map, y_map, cv2.INTER_LINEAR)
    inside = np.median(seen[:, off < -reach / 2], axis=1)
    half = (dark + inside) / 2
    bright = there & (seen >= half[:, None])
    last = bright.shape[1] - 1 - bright[:, ::-1].argmax(axis=1)
    some = np.flatnonzero(
        bright.any(axis=1)
        & there[:, off < -reach / 2].all(axis=1)
        & (inside > dark + MIN_DARKER / 2)
        & (last < bright.shape[1] - 1)
    )
    some = some[there[some, last[some] + 1]]
    if len(some) < MIN_PLACES:
        return x, y, radius
    here, after = seen[some, last[some]], seen[some, last[some] + 1]
    edge = radius + off[last[some]] + 0.5 * (here - half[some]) / (here - after)
    places = np.column_stack(
        [x + edge * np.cos(angles[some, 0]), y + edge * np.sin(angles[some, 0])]
    )
    kept = np.ones(len(places), bool)
    for _ in range(N_REFINED):
        circle = _fitted(places[kept])
        away = np.abs(np.hypot(*(places - circle[:2]).T) - circle[2])
        kept = away <= max(OFF_PX, MAX_OFF_SPREAD * float(np.median(away)))
    return circle


def _on(places: Floats, x: float, y: float, radius: float) -> Bools:
    """Which places (K, 2) are on a circle."""
    off = np.abs(np.hypot(*(places - [x, y]).T) - radius)
    return np.asarray(off <= MAX_OFF * radius + MAX_OFF_PX)


def _share_of_edge(dark: Bools, x: float, y: float, radius: float) -> float:
    """The share of a circle, as far as it is in the image, that is bright inside, dark outside."""
    angles = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    inner, outer = (
        np.floor([y + r * np.sin(angles), x + r * np.cos(angles)]).astype(int)
        for r in (radius - BESIDE_PX, radius + BESIDE_PX)
    )
    limits = np.array(dark.shape)[:, None]
    there = ((outer >= 0) & (outer < limits) & (inner >= 0) & (inner < limits)).all(axis=0)
    if not there.any():
        return 0.0
    return float((dark[tuple(outer[:, there])] & ~dark[tuple(inner[:, there])]).mean())
