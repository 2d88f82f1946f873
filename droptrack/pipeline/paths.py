"""What is said of each droplet's path at the end, gathered without keeping every row."""

from array import array
from collections.abc import Collection
from dataclasses import dataclass, field
from math import hypot, nan

import numpy as np
from numpy.typing import NDArray

from droptrack.data.report import Value
from droptrack.data.trajectories import Trajectories

DRAWN_STEP_PX = 2.0  # minimum distance between points of a drawn line
MAX_POINTS = 4000  # of a drawn line; of a longer one every other point is kept


@dataclass(kw_only=True)
class DropletPath:
    """One droplet's path; `points` are x, y of its line for drawing."""

    first_frame: int
    last_frame: int
    x: float
    y: float
    n_observed: int = 0
    n_bridged: int = 0
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
        """Its mean diameter sqrt(w h)."""
        return self.diameters_px / (self.n_observed + self.n_bridged)

    def add(self, last_frame: int, xs: list[float], ys: list[float]) -> None:
        """Go on through later positions to a later frame."""
        self.last_frame = last_frame
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

    def add(self, rows: Trajectories) -> None:
        """Take rows that follow on those before."""
        order = np.argsort(rows.track_id, kind="stable")
        frames, xs, ys = (column[order].tolist() for column in (rows.frame, rows.x, rows.y))
        ids, starts = np.unique(rows.track_id[order], return_index=True)
        diameters = np.add.reduceat(np.sqrt(rows.boxes[order, 2] * rows.boxes[order, 3]), starts)
        observed = np.add.reduceat(rows.observed[order], starts, dtype=np.int64)
        ends = [*starts[1:].tolist(), len(rows)]
        for track_id, start, end, n_observed, diameters_px in zip(
            ids.tolist(), starts.tolist(), ends, observed.tolist(), diameters.tolist(), strict=True
        ):
            one = slice(start, end)
            born = DropletPath(
                first_frame=frames[start], last_frame=frames[start], x=xs[start], y=ys[start]
            )
            path = self._paths.setdefault(track_id, born)
            path.add(frames[end - 1], xs[one], ys[one])
            path.n_observed += n_observed
            path.n_bridged += end - start - n_observed
            path.diameters_px += diameters_px

    def each(self) -> Collection[DropletPath]:
        """The path of each droplet."""
        return self._paths.values()

    def table(self) -> list[dict[str, Value]]:
        """One row a droplet: when and how far it went."""
        table: list[dict[str, Value]] = []
        for track_id, path in sorted(self._paths.items()):
            n_steps = path.last_frame - path.first_frame
            table.append(
                {
                    "track_id": track_id,
                    "first_frame": path.first_frame,
                    "last_frame": path.last_frame,
                    "n_observed": path.n_observed,
                    "n_bridged": path.n_bridged,
                    "diameter_px": path.diameter_px,
                    "path_px": path.length_px,
                    "speed_px_per_frame": path.length_px / n_steps if n_steps else nan,
                }
            )
        return table

    def lines(self) -> dict[int, NDArray[np.float32]]:
        """Of each droplet, points (K, 2) px along its path, the last one included."""
        return {
            track_id: np.array([*path.points, path.x, path.y], np.float32).reshape(-1, 2)
            for track_id, path in sorted(self._paths.items())
        }
