"""Plots of droplets' sizes, shapes, speeds and events, for a paper: PDF and PNG, with units."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.files import replacing
from droptrack.data.trajectories import TEXT, Trajectories
from droptrack.data.units import Units
from droptrack.tracking.events.lineage import Event, Kind
from droptrack.tracking.events.plot_names import Plot

BINS = 30  # along the channel, and in time
MIN_IN_BIN = 3  # values for which a bin's median is drawn
# not arrows: droplets enter and leave on any side
MARKERS = {Kind.coalescence: "o", Kind.break_up: "x", Kind.entering: "+", Kind.leaving: "s"}
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


@dataclass(frozen=True, kw_only=True)
class _Data:
    """Rows in the units of the plots: M of each; lengths in `length`, times in `time`."""

    rows: Trajectories
    events: Sequence[Event]
    times: Floats
    x: Floats
    y: Floats
    diameters: Floats
    deformation: Floats
    speed: Floats
    whole: Bools
    scale: float
    rate: float
    size: tuple[int, int]
    length: str
    time: str


def draw_plots(
    folder: Path,
    plots: Sequence[Plot],
    rows: Trajectories,
    events: Sequence[Event],
    units: Units,
    size: tuple[int, int],
) -> None:
    """Write the plots, such as ``sizes.pdf`` and ``sizes.png``, to a folder."""
    data = _data(rows, events, units, size)
    drawers: dict[Plot, Callable[[Figure, _Data], None]] = {
        Plot.sizes: _sizes,
        Plot.deformation: _deformation,
        Plot.speed: _speed,
        Plot.kymograph: _kymograph,
        Plot.paths: _paths,
    }
    for plot in plots:
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(6.4, 3.2), layout="constrained")
            drawers[plot](figure, data)
            for suffix in (".pdf", ".png"):
                with replacing(folder / f"{plot}{suffix}") as partial:
                    figure.savefig(partial)


def _data(
    rows: Trajectories, events: Sequence[Event], units: Units, size: tuple[int, int]
) -> _Data:
    nothing = np.full(len(rows), np.nan)
    column = {
        name: np.asarray(rows.columns[name], float) for name in rows.columns if name not in TEXT
    }
    scale, rate = units.um_per_px or 1.0, units.fps or 1.0
    speed = np.hypot(column.get("velocity_x", nothing), column.get("velocity_y", nothing))
    of_boxes = np.sqrt(rows.boxes[:, 2] * rows.boxes[:, 3])
    return _Data(
        rows=rows,
        events=events,
        times=rows.frame / rate,
        x=rows.x * scale,
        y=rows.y * scale,
        diameters=column.get("diameter_px", of_boxes) * scale,
        deformation=column.get("deformation", nothing),
        speed=speed * scale * rate,
        whole=column.get("at_edge", np.zeros(len(rows))) != 1,
        scale=scale,
        rate=rate,
        size=size,
        length="px" if units.um_per_px is None else "µm",
        time="frame" if units.fps is None else "s",
    )


def _sizes(figure: Figure, data: _Data) -> None:
    """One value a droplet, its median; polydispersity is their deviation over their mean."""
    ids = data.rows.track_id
    known = np.isfinite(data.diameters)
    sizes = np.array([np.median(data.diameters[known & (ids == k)]) for k in np.unique(ids[known])])
    axes = figure.subplots()
    axes.set(xlabel=f"diameter / {data.length}", ylabel="droplets")
    if not len(sizes):
        axes.set_title("no sizes were measured")
        return
    axes.hist(sizes, bins="auto" if np.ptp(sizes) > 1e-9 else 1, color="tab:blue")
    mean, deviation = sizes.mean(), sizes.std()
    axes.set_title(
        f"{len(sizes)} droplets, {mean:.4g} ± {deviation:.2g} {data.length}, "
        f"polydispersity {deviation / mean:.1%}"
    )


def _deformation(figure: Figure, data: _Data) -> None:
    _against_time_and_place(figure, data, data.deformation, "deformation")


def _speed(figure: Figure, data: _Data) -> None:
    unit = f"{data.length}/{data.time}"
    _against_time_and_place(figure, data, data.speed, f"speed / ({unit})")


def _against_time_and_place(figure: Figure, data: _Data, values: Floats, label: str) -> None:
    """Medians of all droplets, and the range of the middle 80 %."""
    for axes, along, name in zip(
        figure.subplots(1, 2, sharey=True),
        (data.times, data.x),
        (f"time / {data.time}", f"x / {data.length}"),
        strict=True,
    ):
        _draw_bins(axes, along[data.whole], values[data.whole])
        axes.set_xlabel(name)
    figure.axes[0].set_ylabel(label)


def _draw_bins(axes: Axes, along: Floats, values: Floats) -> None:
    known = np.isfinite(values)
    along, values = along[known], values[known]
    if not len(along):
        axes.set_title("was not measured")
        axes.set(xticks=[], yticks=[])
        return
    edges = np.linspace(along.min(), along.max() + 1e-9, BINS + 1)
    bins: Rows = np.clip(np.digitize(along, edges) - 1, 0, BINS - 1)
    middle = (edges[:-1] + edges[1:]) / 2
    spread = np.full((3, BINS), np.nan)  # of bins with too few values: a gap in the lines
    for k in range(BINS):
        some = values[bins == k]
        if len(some) >= MIN_IN_BIN:
            spread[:, k] = np.quantile(some, (0.1, 0.5, 0.9))
    low, median, high = spread
    if np.isnan(median).all():
        axes.set_title("too few values")
        axes.set(xticks=[], yticks=[])
        return
    axes.fill_between(middle, low, high, color="tab:blue", alpha=0.25, linewidth=0)
    axes.plot(middle, median, ".-", color="tab:blue", markersize=3)


def _kymograph(figure: Figure, data: _Data) -> None:
    """Where along x each droplet is when: lines as steep as droplets are slow."""
    axes = figure.subplots()
    for track_id in np.unique(data.rows.track_id):
        mine = (data.rows.track_id == track_id) & data.whole
        axes.plot(data.x[mine], data.times[mine], color="tab:blue", linewidth=0.6)
    _mark_events(axes, data, lambda event: event.frame / data.rate)
    axes.set(xlabel=f"x / {data.length}", ylabel=f"time / {data.time}")
    axes.invert_yaxis()


def _paths(figure: Figure, data: _Data) -> None:
    """The paths in the image's frame; dotted where the image cuts the droplet."""
    width, height = (side * data.scale for side in data.size)
    axes = figure.subplots()
    for track_id in np.unique(data.rows.track_id):
        mine = np.flatnonzero(data.rows.track_id == track_id)
        axes.plot(data.x[mine], data.y[mine], ":", color="grey", linewidth=0.6)
        whole = np.where(data.whole[mine], data.x[mine], np.nan)
        axes.plot(whole, data.y[mine], color="tab:blue", linewidth=0.8)
    _mark_events(axes, data, lambda event: event.y * data.scale)
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.spines[:].set_visible(True)
    axes.set(xlabel=f"x / {data.length}", ylabel=f"y / {data.length}")


def _mark_events(axes: Axes, data: _Data, ordinate: Callable[[Event], float]) -> None:
    for kind, marker in MARKERS.items():
        some = [event for event in data.events if event.kind == kind]
        if some:
            x, y = [event.x * data.scale for event in some], [ordinate(event) for event in some]
            axes.plot(x, y, marker, color="tab:red", markersize=4, label=kind.value)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
