"""What is said of each droplet's path at the end, gathered without keeping every row."""

from array import array
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from math import hypot, nan

import numpy as np
from numpy.typing import NDArray

from droptrack.data.report import Value
from droptrack.data.trajectories import Trajectories
from droptrack.data.units import Units

DRAWN_STEP_PX = 2.0  # minimum distance between points of a drawn line
MAX_FRAMES = 2**62
BORDER = "border"  # of a region, or of a field stop, within the image
SIDES = ("left", "right", "top", "bottom", BORDER, "inside")
MAX_POINTS = 4000  # of a drawn line; of a longer one every other point is kept


@dataclass(kw_only=True)
class DropletPath:
    """One droplet's path; `points` are x, y of its line for drawing.

    Lengths and lines are those of the frames in which no edge cuts the droplet.
    """

    first_frame: int
    last_frame: int
    first_box: list[float]  # cx, cy, w, h
    last_box: list[float]
    first_cut: bool = False  # whether an edge, of whatever kind, cuts it in its first frame
    last_cut: bool = False
    first_whole: int | None = None
    last_whole: int = 0
    x: float = nan  # in the last frame in which it was whole
    y: float = nan
    n_observed: int = 0
    n_bridged: int = 0
    n_diameters: int = 0
    diameters_px: float = 0.0  # their sum
    length_px: float = 0.0
    step_px: float = DRAWN_STEP_PX
    points: "array[float]" = field(default_factory=lambda: array("f"))

    @property
    def start(self) -> tuple[float, float]:
        """Where it was first seen, x and y px."""
        return self.points[0], self.points[1]

    @property
    def diameter_px(self) -> float:
        """Its mean diameter, where that is known."""
        return self.diameters_px / self.n_diameters if self.n_diameters else nan

    def add(self, frames: list[int], xs: list[float], ys: list[float]) -> None:
        """Go on through later positions."""
        if not frames:
            return
        if self.first_whole is None:
            self.first_whole, self.x, self.y = frames[0], xs[0], ys[0]
        self.last_whole = frames[-1]
        for x, y in zip(xs, ys, strict=True):
            self.length_px += hypot(x - self.x, y - self.y)
            self.x, self.y = x, y
            if not self.points or hypot(x - self.points[-2], y - self.points[-1]) > self.step_px:
                self.points.extend((x, y))
        while len(self.points) > 2 * MAX_POINTS:
            pairs = np.frombuffer(self.points, np.float32).reshape(-1, 2)
            self.points = array("f", pairs[::2].tobytes())
            self.step_px *= 2


class Paths:
    """The paths of all droplets."""

    def __init__(self) -> None:
        self._paths: dict[int, DropletPath] = {}
        self._first_frame, self._last_frame = MAX_FRAMES, 0

    def add(self, rows: Trajectories) -> None:
        """Take rows that follow on those before."""
        order = np.argsort(rows.track_id, kind="stable")
        boxes = rows.boxes[order]
        self._first_frame = min(self._first_frame, int(rows.frame.min(initial=MAX_FRAMES)))
        self._last_frame = max(self._last_frame, int(rows.frame.max(initial=0)))
        ids, starts = np.unique(rows.track_id[order], return_index=True)
        frames = rows.frame[order].tolist()
        whole = rows.columns.get("at_edge", np.zeros(len(rows)))[order] != 1
        diameter = rows.columns.get("diameter_px", np.sqrt(rows.boxes[:, 2:].prod(axis=1)))[order]
        known = np.isfinite(diameter)
        diameters = np.add.reduceat(np.where(known, diameter, 0), starts).tolist()
        n_known = np.add.reduceat(known, starts, dtype=np.int64).tolist()
        observed = np.add.reduceat(rows.observed[order], starts, dtype=np.int64)
        ends = [*starts[1:].tolist(), len(rows)]
        for k, (track_id, start, end) in enumerate(
            zip(ids.tolist(), starts.tolist(), ends, strict=True)
        ):
            if track_id not in self._paths:
                self._paths[track_id] = DropletPath(
                    first_frame=frames[start],
                    last_frame=frames[start],
                    first_box=boxes[start].tolist(),
                    last_box=boxes[start].tolist(),
                    first_cut=not whole[start],
                )
            path = self._paths[track_id]
            path.last_cut = not whole[end - 1]
            path.last_frame = frames[end - 1]
            path.last_box = boxes[end - 1].tolist()
            some = order[start:end][whole[start:end]]
            path.add(*(column[some].tolist() for column in (rows.frame, rows.x, rows.y)))
            path.n_observed += int(observed[k])
            path.n_bridged += end - start - int(observed[k])
            path.n_diameters += n_known[k]
            path.diameters_px += diameters[k]

    def each(self) -> Collection[DropletPath]:
        """The path of each droplet."""
        return self._paths.values()

    def table(self, units: Units | None = None) -> list[dict[str, Value]]:
        """One row a droplet: when and how far it went."""
        units = units or Units()
        table: list[dict[str, Value]] = []
        for track_id, path in sorted(self._paths.items()):
            n_steps = path.last_whole - (path.first_whole or 0)
            diameter = path.diameter_px
            speed = path.length_px / n_steps if n_steps else nan
            table.append(
                {
                    "track_id": track_id,
                    "first_frame": path.first_frame,
                    "last_frame": path.last_frame,
                    "n_observed": path.n_observed,
                    "n_bridged": path.n_bridged,
                    "diameter_px": diameter,
                    "path_px": path.length_px,
                    "speed_px_per_frame": speed,
                }
            )
            if units.um_per_px is not None:
                table[-1]["diameter_um"] = units.um_per_px * diameter
                if units.fps is not None:
                    table[-1]["speed_um_per_s"] = units.um_per_px * units.fps * speed
        return table

    def passages(self, width: float, height: float) -> tuple[list[str], list[str]]:
        """Where droplets entered after the first frame, and left before the last one.

        For each of them the side of an image of some px, or inside: see `side_of`; or the BORDER of
        what counts of the image, where that cuts it.
        """
        entered, left = [], []
        for path in self._paths.values():
            n_steps = path.last_frame - path.first_frame
            step = path.length_px / n_steps if n_steps else 0.0
            dx, dy = (b - a for a, b in zip(path.first_box[:2], path.last_box[:2], strict=True))
            if path.first_frame > self._first_frame:
                side = side_of(path.first_box, width, height, (-dx, -dy), step)
                entered.append(BORDER if side == "inside" and path.first_cut else side)
            if path.last_frame < self._last_frame:
                side = side_of(path.last_box, width, height, (dx, dy), step)
                left.append(BORDER if side == "inside" and path.last_cut else side)
        return entered, left

    def lines(self) -> dict[int, NDArray[np.float32]]:
        """Of each droplet, points (K, 2) px along its path, the last one included."""
        return {
            track_id: np.array([*path.points, path.x, path.y], np.float32).reshape(-1, 2)
            for track_id, path in sorted(self._paths.items())
            if path.first_whole is not None
        }


def side_of(
    box: Sequence[float], width: float, height: float, heading: tuple[float, float], step: float
) -> str:
    """The side of an image that a box cx, cy, w, h is at, or "inside"; all in px.

    `heading`: the way out, any length: of sides in its direction, the one it meets first. The box
    is at it if there is no room for another droplet between them, or for a `step` that it goes in a
    frame.

    >>> side_of((25, 50, 20, 20), 640, 480, (-1, 0), 12)
    'left'
    >>> side_of((300, 200, 20, 20), 640, 480, (-1, 0), 12)
    'inside'
    """
    cx, cy, w, h = box
    dx, dy = heading
    sides = (
        ("left", -dx, cx - w / 2, w),
        ("right", dx, width - cx - w / 2, w),
        ("top", -dy, cy - h / 2, h),
        ("bottom", dy, height - cy - h / 2, h),
    )
    ahead = [
        (max(room, 0) / speed, side, room, size) for side, speed, room, size in sides if speed > 0
    ]
    if not ahead:  # it does not move, as far as anyone knows
        ahead = [(room, side, room, size) for side, _, room, size in sides]
    _, side, room, size = min(ahead)
    return side if room < max(size, step) else "inside"


def counted(sides: list[str]) -> list[str]:
    """How many there are of each.

    >>> counted(["left", "inside", "left"])
    ['left 2', 'inside 1']
    """
    return [f"{side} {sides.count(side)}" for side in SIDES if side in sides]
