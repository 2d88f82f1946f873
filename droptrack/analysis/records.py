"""What an analysis finds: quantities, charts, tables; and what their units are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

from droptrack.data.arrays import Floats, Rows
from droptrack.data.report import Value
from droptrack.data.units import Units

Dimension: TypeAlias = tuple[int, int]  # powers of length and of time
NUMBER: Dimension = (0, 0)
LENGTH: Dimension = (1, 0)
AREA: Dimension = (2, 0)
TIME: Dimension = (0, 1)
RATE: Dimension = (0, -1)
SPEED: Dimension = (1, -1)

POWERS = {1: "", 2: "²", 3: "³", 4: "⁴"}


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number, in px and frames, with its error, its definition, and what chance would give.

    stem: its key without unit. value, error and null are NaN where not defined; `reason` says why.
    """

    stem: str
    label: str
    value: float
    definition: str
    error: float = float("nan")
    null: float = float("nan")
    null_model: str = ""
    dimension: Dimension = NUMBER
    reason: str = ""


class Style(StrEnum):
    """How a curve is drawn."""

    line = "line"
    points = "points"
    steps = "steps"  # a count, which stays until the next event
    bars = "bars"
    null = "null"  # what chance gives: dashed and grey
    guide = "guide"  # for the eye: red


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Points x, y (K,) in px and frames, with errors (K,) where they are known."""

    label: str
    x: Floats
    y: Floats
    error: Floats | None = None
    style: Style = Style.line


@dataclass(frozen=True, kw_only=True)
class Axis:
    """What is along an axis: for people, and, in the table's header, for programs."""

    label: str
    stem: str
    dimension: Dimension = NUMBER


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Curves over an axis. log: the axes that are logarithmic, of "xy"."""

    name: str
    caption: str
    x: Axis
    y: Axis
    curves: Sequence[Curve]
    log: str = ""


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """Points x, y (K,), coloured by the droplets (K,) that they are of; a guide along x = y."""

    name: str
    caption: str
    x: Axis
    y: Axis
    values: tuple[Floats, Floats]
    droplets: Rows
    band: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """Droplets of one frame: places (K, 2) and radii (K,) px, coloured by values (K,).

    arrows (K, 2): directions; lines (L, 2, 2): from a place to another, such as neighbours; circle:
    x, y and radius px.
    """

    name: str
    caption: str
    places: Floats
    radii: Floats
    size: tuple[int, int]
    values: Floats | None = None
    value_label: str = ""
    limits: tuple[float, float] | None = None  # of the colours
    arrows: Floats | None = None
    lines: Floats | None = None
    circle: tuple[float, float, float] | None = None


Figure: TypeAlias = Chart | Cloud | Snapshot


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """All that one analysis found; tables: rows by the name of their file."""

    title: str
    about: str
    settings: Mapping[str, Value]
    counts: Mapping[str, int]
    quantities: Sequence[Quantity]
    figures: Sequence[Figure] = ()
    tables: Mapping[str, Sequence[Mapping[str, Value]]] = field(default_factory=dict)
    notes: Sequence[str] = ()


def factor(dimension: Dimension, units: Units) -> float | None:
    """What a value in px and frames is to be multiplied with; None where units are not known.

    >>> factor(SPEED, Units(um_per_px=0.5, fps=100)), factor(SPEED, Units(um_per_px=0.5))
    (50.0, None)
    """
    length, time = dimension
    if dimension == NUMBER or (length and units.um_per_px is None) or (time and units.fps is None):
        return None
    return float((units.um_per_px or 1.0) ** length * (units.fps or 1.0) ** -time)


def unit_key(dimension: Dimension, *, physical: bool) -> str:
    """What ends a key: ``_px2_per_frame``, ``_um2_per_s``; nothing for a mere number."""
    return _unit(dimension, "um" if physical else "px", "s" if physical else "frame", key=True)


def unit_text(dimension: Dimension, *, physical: bool) -> str:
    """The unit for people: px²/frame, µm²/s."""
    return _unit(dimension, "µm" if physical else "px", "s" if physical else "frame", key=False)


def _unit(dimension: Dimension, length: str, time: str, *, key: bool) -> str:
    above: list[str] = []
    below: list[str] = []
    for name, power in ((length, dimension[0]), (time, dimension[1])):
        size = abs(power)
        text = name + ((str(size) if size > 1 else "") if key else POWERS.get(size, ""))
        if power:
            (above if power > 0 else below).append(text)
    if key:
        if dimension == TIME and time == "frame":
            return "_frames"
        return "".join(f"_{one}" for one in above) + "".join(f"_per_{one}" for one in below)
    if dimension == TIME and time == "frame":
        return "frames"
    top = "·".join(above) or ("1" if below else "")
    return top + (f"/{'·'.join(below)}" if below else "")
