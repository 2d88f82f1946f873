"""Micrometres and seconds: the one place that knows what a pixel and a frame are.

A column in px has its fellow in other units under the same stem with that unit: `diameter_px` and
`diameter_um`, `velocity_x` (px a frame) and `velocity_x_um_per_s`.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

UM_PER_PX, FPS = "um per px", "frames per s"  # keys of a table's `#` lines
LENGTHS = ("diameter_px", "major_px", "minor_px", "perimeter_px")
PLACES = ("x", "y", "smooth_x", "smooth_y", "box_x", "box_y", "w", "h")  # px, without saying so
VELOCITIES = ("velocity_x", "velocity_y")  # px a frame


@dataclass(frozen=True, kw_only=True)
class Units:
    """How many micrometres a pixel is, and how many frames a second has; None where not known.

    Raises DroptrackError for what cannot be.

    >>> units = Units(um_per_px=0.5, fps=200)
    >>> units.further({"frame": np.array([0, 10]), "diameter_px": np.array([20.0, 30.0])})
    {'time_s': array([0.  , 0.05]), 'diameter_um': array([10., 15.])}
    """

    um_per_px: float | None = None
    fps: float | None = None

    def __post_init__(self) -> None:
        for option, value in (("--um-per-px", self.um_per_px), ("--fps", self.fps)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise DroptrackError(f"{option} {value:g}: should be above 0")

    def about(self) -> dict[str, str]:
        """What is known, for the `#` lines of a table."""
        known = ((UM_PER_PX, self.um_per_px), (FPS, self.fps))
        return {key: f"{value:.10g}" for key, value in known if value is not None}

    def names(self, columns: Iterable[str]) -> tuple[str, ...]:
        """The names of the columns that `further` gives."""
        empty = np.zeros(0)
        return tuple(self.further(dict.fromkeys(columns, empty)))

    def further(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, Floats]:
        """Columns in seconds, micrometres and micrometres a second, of columns by their names."""
        found: dict[str, Floats] = {}
        if self.fps is not None and "frame" in columns:
            found["time_s"] = np.asarray(columns["frame"] / self.fps)
        um = self.um_per_px
        if um is None:
            return found
        for name, column in columns.items():
            if name in PLACES:
                found[f"{name}_um"] = np.asarray(column * um)
            elif name in LENGTHS:
                found[name.replace("_px", "_um")] = np.asarray(column * um)
            elif name == "area_px2":
                found["area_um2"] = np.asarray(column * um**2)
            elif name in VELOCITIES and self.fps is not None:
                found[f"{name}_um_per_s"] = np.asarray(column * (um * self.fps))
        return found


PIXELS = Units()  # where nothing else is known


def units_of(about: Mapping[str, str]) -> Units:
    """What a table's `#` lines say; the frames a second also from what they say of the video.

    Raises DroptrackError for a line that is no number.
    """
    values: dict[str, float | None] = {UM_PER_PX: None, FPS: None}
    for key in values:
        if key in about:
            try:
                values[key] = float(about[key])
            except ValueError:
                raise DroptrackError(f"# {key}: {about[key]}: should be a number") from None
    rate = re.search(r"(?<![\d.])(\d+(?:\.\d*)?|\.\d+) frames/s", about.get("video", ""))
    if values[FPS] is None and rate and float(rate[1]) > 0:
        values[FPS] = float(rate[1])
    return Units(um_per_px=values[UM_PER_PX], fps=values[FPS])


def parse_known_length(text: str) -> float:
    """Micrometres a pixel, from two places and what lies between: X1,Y1,X2,Y2,UM.

    Raises DroptrackError where the places are one, or the length is none.

    >>> parse_known_length("100,50,400,450,250")
    0.5
    """
    try:
        x1, y1, x2, y2, length_um = (float(part) for part in text.split(","))
    except ValueError:
        raise DroptrackError(f"--known-length {text}: should be X1,Y1,X2,Y2,UM") from None
    distance = math.hypot(x2 - x1, y2 - y1)
    if not (
        math.isfinite(distance) and distance > 0 and math.isfinite(length_um) and length_um > 0
    ):
        raise DroptrackError(f"--known-length {text}: the places and the length should be apart")
    return length_um / distance


def scale_bar(um_per_px: float, width_px: int) -> tuple[float, int]:
    """The length, um and px, of a scale bar for an image: 1, 2 or 5 times a power of ten.

    The longest that takes at most a quarter of the width.

    >>> scale_bar(0.65, 1200)
    (100.0, 154)
    """
    longest = um_per_px * width_px / 4
    power = 10.0 ** math.floor(math.log10(longest))
    length = power * max(step for step in (1, 2, 5) if step * power <= longest)
    return length, round(length / um_per_px)
