"""The figures of the analysis ``structure``."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.bootstrap import ratio_and_error
from droptrack.analysis.records import (
    LENGTH,
    RATE,
    TIME,
    Axis,
    Chart,
    Curve,
    Figure,
    Snapshot,
    Style,
)
from droptrack.analysis.structure.cells import cells_of
from droptrack.analysis.structure.frames import MOST_FRACTION, FrameSums
from droptrack.analysis.structure.order import hexatic_order
from droptrack.analysis.structure.window import Window
from droptrack.analysis.tables import diameters
from droptrack.data.arrays import Bools, Floats
from droptrack.data.formats.table import Table

RATE_BINS = 20


@dataclass(frozen=True, kw_only=True)
class Correlation:
    """g(r): values (B,) and errors (B,) at distances (B,) px."""

    middles: Floats
    values: Floats
    errors: Floats


def figures_of(
    table: Table,
    window: Window,
    reach: float,
    sums: FrameSums,
    correlation: Correlation,
    rng: np.random.Generator,
) -> list[Figure]:
    """All figures."""
    r = correlation.middles
    charts: list[Figure] = [
        Chart(
            name="pair_correlation",
            caption="Pair correlation function, corrected for the window's edge; dashed: places at "
            "random in it.",
            x=Axis(label="r", stem="r", dimension=LENGTH),
            y=Axis(label="g(r)", stem="g"),
            curves=[
                Curve(label="droplets", x=r, y=correlation.values, error=correlation.errors),
                Curve(label="at random", x=r, y=np.ones(len(r)), style=Style.null),
            ],
        ),
        _neighbours(sums, rng),
        _fractions(sums, rng),
        _order(sums),
        _rate_in_time(table, window, sums),
        _rate_along_x(table, window, sums),
    ]
    shot = _snapshot(table, window, reach, sums)
    return charts if shot is None else [shot, *charts]


def _neighbours(sums: FrameSums, rng: np.random.Generator) -> Chart:
    counts = sums.with_neighbours
    total = np.repeat(sums.inner[:, None], counts.shape[1], axis=1)
    share, error = ratio_and_error(counts, total, rng)
    x = np.arange(counts.shape[1], dtype=float)
    return Chart(
        name="neighbours",
        caption="Neighbours of inner droplets.",
        x=Axis(label="neighbours", stem="neighbours"),
        y=Axis(label="share of droplets", stem="share"),
        curves=[Curve(label="droplets", x=x, y=share, error=error, style=Style.points)],
    )


def _fractions(sums: FrameSums, rng: np.random.Generator) -> Chart:
    counts = sums.fractions
    width = MOST_FRACTION / counts.shape[1]
    total = np.repeat(sums.sized[:, None], counts.shape[1], axis=1)
    share, error = ratio_and_error(counts, total, rng)
    x = (np.arange(counts.shape[1]) + 0.5) * width
    return Chart(
        name="local_area_fraction",
        caption="Area of inner droplets over that of their cells. Above 1: the droplet is larger "
        "than its cell, being bent.",
        x=Axis(label="local area fraction", stem="area_fraction"),
        y=Axis(label="probability density", stem="density"),
        curves=[Curve(label="droplets", x=x, y=share / width, error=error / width)],
    )


def _order(sums: FrameSums) -> Chart:
    time = sums.frames.astype(float)
    return Chart(
        name="hexatic_order",
        caption="Hexatic order of the inner droplets of each frame.",
        x=Axis(label="time", stem="time", dimension=TIME),
        y=Axis(label="|psi_6|", stem="psi6"),
        curves=[
            Curve(label="mean of |psi_6|", x=time, y=sums.order_of_frame),
            Curve(label="|mean of psi_6|", x=time, y=sums.global_order),
        ],
    )


def _rate(places: Floats, of_rows: Floats) -> tuple[Floats, Floats, Floats]:
    """Middles (B,), events a row (B,), and their Poisson errors, in bins over all rows."""
    if not len(of_rows):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    edges = np.linspace(of_rows.min(), of_rows.max() + 1e-9, RATE_BINS + 1)
    n, rows = np.histogram(places, edges)[0], np.histogram(of_rows, edges)[0]
    enough = rows > 0
    rate, error = np.full((2, RATE_BINS), np.nan)
    rate[enough] = n[enough] / rows[enough]
    error[enough] = np.sqrt(n[enough]) / rows[enough]
    return (edges[1:] + edges[:-1]) / 2, rate, error


def _rate_in_time(table: Table, window: Window, sums: FrameSums) -> Chart:
    events = np.array([one.frame for one in sums.events], float)
    time = Axis(label="time", stem="time", dimension=TIME)
    frames = table.rows.frame[_inside(table, window)].astype(float)
    return _rate_chart("t1_in_time", "time", time, _rate(events, frames))


def _rate_along_x(table: Table, window: Window, sums: FrameSums) -> Chart:
    events = np.array([one.x for one in sums.events], float)
    return _rate_chart(
        "t1_along_x",
        "x",
        Axis(label="x", stem="x", dimension=LENGTH),
        _rate(events, table.rows.x[_inside(table, window)]),
    )


def _inside(table: Table, window: Window) -> Bools:
    return window.contains(np.column_stack([table.rows.x, table.rows.y]))


def _rate_chart(name: str, along: str, axis: Axis, of: tuple[Floats, Floats, Floats]) -> Chart:
    x, rate, error = of
    return Chart(
        name=name,
        caption=f"T1 events a droplet and time, against {along}; errors: square roots of counts.",
        x=axis,
        y=Axis(label="T1 events of a droplet", stem="t1_rate", dimension=RATE),
        curves=[Curve(label="T1 events", x=x, y=rate, error=error, style=Style.points)],
    )


def _snapshot(table: Table, window: Window, reach: float, sums: FrameSums) -> Snapshot | None:
    """The frame with the most inner droplets: psi_6, and lines between neighbours."""
    if not sums.inner_of_frame.any():
        return None
    frame = int(sums.frames[int(np.argmax(sums.inner_of_frame))])
    rows = np.flatnonzero(table.rows.frame == frame)
    places = np.column_stack([table.rows.x, table.rows.y])[rows]
    radii = diameters(table)[rows] / 2
    cells = cells_of(places, radii, window, reach)
    ends = np.stack([places[cells.first], places[cells.first] + cells.vectors], axis=1)
    known = radii[np.isfinite(radii)]
    drawn = float(np.median(known)) if len(known) else 3.0
    return Snapshot(
        name="frame",
        caption=f"Frame {frame}: |psi_6| of inner droplets, and who is whose neighbour.",
        places=places,
        radii=np.nan_to_num(radii, nan=drawn),
        size=table.size,
        values=np.where(cells.inner, np.abs(hexatic_order(cells)), np.nan),
        value_label="|psi_6|",
        limits=(0.0, 1.0),
        lines=ends,
    )
