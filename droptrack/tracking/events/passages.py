"""Trajectories -> droplets that pass a line, and how long they stay in a region.

Positions between frames are on straight lines. Rows `at_edge` are left out: their positions are
those of parts.
"""

from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.trajectories import Trajectories
from droptrack.errors import DroptrackError


@dataclass(frozen=True)
class Line:
    """A counting line from one place to another, px; forward is from its left to its right.

    Left and right are as one sees them in the image, looking from the first place to the second.
    """

    x1: float
    y1: float
    x2: float
    y2: float


@dataclass(frozen=True)
class Region:
    """A polygon: its corners (K, 2) px."""

    corners: Floats


@dataclass(frozen=True, kw_only=True)
class Passage:
    """One droplet passes a line: when, between frames; where, px; how fast, px a frame; its size.

    forward: 1 from left to right, else -1. diameter_px is that of the frames before and after, NaN
    where it was measured in neither.
    """

    track_id: int
    frame: float
    x: float
    y: float
    forward: int
    speed_px_per_frame: float
    diameter_px: float


@dataclass(frozen=True, kw_only=True)
class Stay:
    """One droplet in a region, from a frame to another, the last one in it.

    whole: it came in and went out while it was tracked.
    """

    track_id: int
    first_frame: int
    last_frame: int
    whole: bool


def parse_line(text: str, size: tuple[int, int]) -> Line:
    """A line X1,Y1,X2,Y2 in an image of a size, px; raises DroptrackError for what is none."""
    values = _numbers("--line", text, "X1,Y1,X2,Y2")
    if len(values) != 4:
        raise DroptrackError(f"--line {text}: should be X1,Y1,X2,Y2")
    line = Line(*values)
    if (line.x1, line.y1) == (line.x2, line.y2):
        raise DroptrackError(f"--line {text}: has no length")
    _check_inside("--line", text, np.reshape(values, (2, 2)), size)
    return line


def parse_region(text: str, size: tuple[int, int], option: str = "--region") -> Region:
    """A rectangle X1,Y1,X2,Y2 or a polygon X1,Y1,X2,Y2,X3,Y3,... in an image of a size, px.

    Raises DroptrackError for what is none, or lies outside.

    >>> parse_region("10,20,30,60", (640, 480)).corners.tolist()
    [[10.0, 20.0], [30.0, 20.0], [30.0, 60.0], [10.0, 60.0]]
    """
    values = _numbers(option, text, "X1,Y1,X2,Y2 or the corners of a polygon")
    if len(values) < 4 or len(values) % 2:
        raise DroptrackError(f"{option} {text}: should be X1,Y1,X2,Y2 or the corners of a polygon")
    if len(values) == 4:
        x1, y1, x2, y2 = values
        values = [x1, y1, x2, y1, x2, y2, x1, y2]
    corners = np.reshape(values, (-1, 2))
    x, y = corners.T
    if not x @ np.roll(y, -1) - y @ np.roll(x, -1):
        raise DroptrackError(f"{option} {text}: has no area")
    _check_inside(option, text, corners, size)
    return Region(corners)


def _numbers(option: str, text: str, form: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = [float("nan")]
    if not np.isfinite(values).all():
        raise DroptrackError(f"{option} {text}: should be {form}")
    return values


def _check_inside(option: str, text: str, corners: Floats, size: tuple[int, int]) -> None:
    if (corners < 0).any() or (corners > size).any():
        raise DroptrackError(f"{option} {text}: lies outside the image, {size[0]} x {size[1]} px")


def passages(rows: Trajectories, line: Line) -> list[Passage]:
    """Every time a droplet passes a line, in the order of time.

    A droplet that stands on the line is not through; it passes when it leaves it on the far side.

    >>> from droptrack.data.trajectories import sorted_trajectories
    >>> n = 4
    >>> rows = sorted_trajectories(
    ...     np.arange(n), np.ones(n, np.int64), 3.0 * np.arange(n), np.full(n, 5.0),
    ...     np.full((n, 4), 6.0), np.ones(n), np.ones(n, bool),
    ... )
    >>> (one,) = passages(rows, Line(4, 10, 4, 0))
    >>> round(one.frame, 3), one.x, one.forward, one.speed_px_per_frame
    (1.333, 4.0, 1, 3.0)
    """
    diameters = rows.columns.get("diameter_px", np.sqrt(rows.boxes[:, 2] * rows.boxes[:, 3]))
    found: list[Passage] = []
    start, way = np.array([line.x1, line.y1]), np.array([line.x2 - line.x1, line.y2 - line.y1])
    for track_id, frames, places, some in _ways(rows):
        offset = places - start
        # above 0 on the right, as one sees it where y points down
        side = way[0] * offset[:, 1] - way[1] * offset[:, 0]
        along = offset @ way / (way @ way)
        there = np.flatnonzero(side != 0)
        for k, m in zip(there[:-1].tolist(), there[1:].tolist(), strict=True):
            if side[k] * side[m] > 0:
                continue
            share = side[k] / (side[k] - side[m])
            at = along[k] + share * (along[m] - along[k])
            if not 0 <= at <= 1:
                continue
            steps = frames[m] - frames[k]
            x, y = (places[k] + share * (places[m] - places[k])).tolist()
            sizes = diameters[some[[k, m]]]
            sizes = sizes[np.isfinite(sizes)]
            found.append(
                Passage(
                    track_id=track_id,
                    frame=float(frames[k] + share * steps),
                    x=x,
                    y=y,
                    forward=1 if side[k] < 0 else -1,
                    speed_px_per_frame=float(np.hypot(*(places[m] - places[k])) / steps),
                    diameter_px=float(sizes.mean()) if len(sizes) else float("nan"),
                )
            )
    return sorted(found, key=lambda one: (one.frame, one.track_id))


def stays(rows: Trajectories, region: Region) -> list[Stay]:
    """Every stay of a droplet's centre in a region, in the order of time."""
    found: list[Stay] = []
    for track_id, frames, places, _ in _ways(rows):
        inside = np.concatenate([[0], within(places, region).astype(np.int8), [0]])
        starts, stops = np.flatnonzero(np.diff(inside) > 0), np.flatnonzero(np.diff(inside) < 0)
        found += [
            Stay(
                track_id=track_id,
                first_frame=int(frames[start]),
                last_frame=int(frames[stop - 1]),
                whole=start > 0 and stop < len(frames),
            )
            for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)
        ]
    return sorted(found, key=lambda one: (one.first_frame, one.track_id))


def within(places: Floats, region: Region) -> Bools:
    """Whether places (N, 2) px lie in a region: whether a ray to the right passes an odd edge."""
    x, y = places.T
    inside = np.zeros(len(places), bool)
    corners = region.corners.tolist()
    for (x1, y1), (x2, y2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if y1 == y2:
            continue
        across = (y1 <= y) != (y2 <= y)
        inside ^= across & (x < x1 + (y - y1) / (y2 - y1) * (x2 - x1))
    return inside


def _ways(rows: Trajectories) -> list[tuple[int, Rows, Floats, Rows]]:
    """Each droplet's identity, frames (T,), places (T, 2), and rows (T,), without those at_edge."""
    kept = np.flatnonzero(rows.columns.get("at_edge", np.zeros(len(rows))) != 1)
    order: Rows = kept[np.lexsort((rows.frame[kept], rows.track_id[kept]))].astype(np.int64)
    ids, starts = np.unique(rows.track_id[order], return_index=True)
    places = np.column_stack([rows.x, rows.y])
    pieces = np.split(order, starts[1:])[: len(ids)]
    return [
        (one, rows.frame[some], places[some], some)
        for one, some in zip(ids.tolist(), pieces, strict=True)
    ]
