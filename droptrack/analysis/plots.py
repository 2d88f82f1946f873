"""Draws the figures of an analysis."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from droptrack.analysis.records import Chart, Cloud, Curve, Snapshot, Style
from droptrack.analysis.records import Figure as FigureRecord
from droptrack.data.arrays import Rows
from droptrack.data.files import replacing
from droptrack.data.units import Units

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "savefig.dpi": 150,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
MAX_POINTS = 40_000  # of a cloud: more hide each other
MAX_LEGEND = 12


def draw(path: Path, figure: FigureRecord, units: Units) -> None:
    """Write one figure, whose values are in the units of its labels, as PNG."""
    with mpl.rc_context(STYLE):
        canvas = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = canvas.subplots()
        if isinstance(figure, Chart):
            _chart(axes, figure)
        elif isinstance(figure, Cloud):
            _cloud(axes, figure)
        else:
            width, height = figure.size
            canvas.set_size_inches(7.5, max(7.5 * height / width, 2.5) + 0.3)
            _snapshot(canvas, axes, figure, units)
        with replacing(path) as partial:
            canvas.savefig(partial)


def _chart(axes: Axes, chart: Chart) -> None:
    some = [one for one in chart.curves if _drawable(one, chart.log).any()]
    several = sum(one.style is Style.null for one in some) > 1  # each in the colour of its fellow
    for curve in some:
        _curve(
            axes, curve, chart.log, axes.lines[-1].get_color() if several and axes.lines else "grey"
        )
    for which, scale in (("x", axes.set_xscale), ("y", axes.set_yscale)):
        if which in chart.log and some:
            scale("log")
    axes.set(xlabel=chart.x.label, ylabel=chart.y.label)
    if not some:
        axes.set_title("not defined")
    elif 1 < len(some) <= MAX_LEGEND or any(one.style is Style.null for one in some):
        if len(some) > 3:
            axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))
        else:
            axes.legend(frameon=False, fontsize=8)


def _drawable(curve: Curve, log: str) -> Any:
    known = np.isfinite(curve.x) & np.isfinite(curve.y)
    if "x" in log:
        known &= curve.x > 0
    return known & (curve.y > 0) if "y" in log else known


def _curve(axes: Axes, curve: Curve, log: str, chance: Any) -> None:
    known = _drawable(curve, log)
    x, y = curve.x[known], curve.y[known]
    error = None if curve.error is None else np.nan_to_num(curve.error[known])
    if curve.style is Style.null:
        axes.plot(x, y, "--", color=chance, linewidth=1.2, label=curve.label)
    elif curve.style is Style.guide:
        axes.plot(x, y, color="tab:red", linewidth=1.0, label=curve.label)
    elif curve.style is Style.bars:
        width = np.diff(x).min() if len(x) > 1 else 1.0
        axes.bar(x, y, width, yerr=error, label=curve.label, alpha=0.7, ecolor="grey")
    elif curve.style is Style.steps:
        axes.step(x, y, ".-", where="post", linewidth=1.2, markersize=4, label=curve.label)
    elif curve.style is Style.points:
        axes.errorbar(x, y, error, fmt="o", markersize=3, linewidth=0.8, label=curve.label)
    else:
        gaps = np.where(known, curve.y, np.nan)  # no line across what is not known
        (line,) = axes.plot(curve.x, gaps, ".-", linewidth=1.2, markersize=4, label=curve.label)
        if error is not None:
            low = y - error
            if "y" in log:
                low = np.maximum(low, y / 10)
            axes.fill_between(x, low, y + error, color=line.get_color(), alpha=0.25, linewidth=0)


def _cloud(axes: Axes, cloud: Cloud) -> None:
    """As the paper's scatter: a colour a droplet, and a line along which both are equal."""
    x, y = cloud.values
    some: Rows = np.linspace(0, max(len(x) - 1, 0), min(len(x), MAX_POINTS)).astype(np.int64)
    axes.scatter(x[some], y[some], s=2, c=cloud.droplets[some] % 20, cmap="tab20", linewidths=0)
    axes.axline((0, 0), slope=1, color="tab:red", linewidth=1.5)
    for shift in (-cloud.band, cloud.band) if cloud.band else ():
        axes.axline((0, shift), slope=1, color="tab:red", linewidth=0.6, linestyle=":")
    axes.set(xlabel=cloud.x.label, ylabel=cloud.y.label, aspect="equal")
    axes.set(xlim=(-np.pi, np.pi), ylim=(-np.pi, np.pi))


def _snapshot(canvas: Figure, axes: Axes, shot: Snapshot, units: Units) -> None:
    """Droplets as circles in the image's frame, where y points down."""
    scale = units.um_per_px or 1.0
    widths = 2 * shot.radii * scale
    circles = EllipseCollection(
        widths, widths, np.zeros_like(widths), units="xy", offsets=shot.places * scale,
        offset_transform=axes.transData, edgecolors="black", linewidths=0.5, cmap="viridis",
        facecolors="lightsteelblue",
    )  # fmt: skip
    if shot.values is not None:
        circles.set_array(np.ma.masked_invalid(shot.values))
        circles.set_clim(*(shot.limits or (None, None)))
        canvas.colorbar(circles, ax=axes, label=shot.value_label, shrink=0.8)
    axes.add_collection(circles)
    if shot.lines is not None and len(shot.lines):
        axes.add_collection(LineCollection(list(shot.lines * scale), colors="grey", linewidths=0.6))
    if shot.arrows is not None:
        places, arrows = shot.places * scale, shot.arrows * scale
        axes.quiver(*places.T, *arrows.T, angles="xy", width=0.003, color="tab:blue")
    if shot.circle is not None:
        x, y, radius = (one * scale for one in shot.circle)
        axes.add_patch(Circle((x, y), radius, fill=False, color="tab:red", linewidth=1.5))
    _frame_axes(axes, units, shot.size)


def _frame_axes(axes: Axes, units: Units, size: tuple[int, int]) -> None:
    width, height = (side * (units.um_per_px or 1.0) for side in size)
    unit = "px" if units.um_per_px is None else "µm"
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set(xlabel=f"x / {unit}", ylabel=f"y / {unit}")
