"""What is said of each droplet's path at the end, gathered without keeping every row."""

from array import array
from dataclasses import dataclass, field
from math import hypot, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from droptrack.report import Value
from droptrack.trajectories import Trajectories

DRAWN_STEP_PX = 2.0  # least distance between points of a drawn line,
MOST_POINTS = 4000  # which are no more than these: of a longer line every other one is kept


@dataclass
class Path:
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

    def add(self, frame: int, x: float, y: float, diameter_px: float, *, observed: bool) -> None:
        """Go on to a later frame."""
        self.length_px += hypot(x - self.x, y - self.y)
        self.last_frame, self.x, self.y = frame, x, y
        self.n_observed += observed
        self.n_bridged += not observed
        self.diameters_px += diameter_px
        if not self.points or hypot(x - self.points[-2], y - self.points[-1]) > self.step_px:
            self.points.extend((x, y))
            if len(self.points) > 2 * MOST_POINTS:
                pairs = np.frombuffer(self.points, np.float32).reshape(-1, 2)
                self.points = array("f", pairs[::2].tobytes())
                self.step_px *= 2


class Paths:
    """The paths of all droplets."""

    def __init__(self) -> None:
        self._paths: dict[int, Path] = {}

    def add(self, rows: Trajectories) -> None:
        """Take rows that follow on those before."""
        for frame, track_id, x, y, (_, _, w, h), observed in zip(
            rows.frame.tolist(),
            rows.track_id.tolist(),
            rows.x.tolist(),
            rows.y.tolist(),
            rows.boxes.tolist(),
            rows.observed.tolist(),
            strict=True,
        ):
            path = self._paths.setdefault(track_id, Path(frame, frame, x, y))
            path.add(frame, x, y, sqrt(w * h), observed=observed)

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
                    "diameter_px": path.diameters_px / (path.n_observed + path.n_bridged),
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
