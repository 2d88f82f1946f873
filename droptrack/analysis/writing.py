"""What an analysis found -> JSON, CSV, PNG and one page, in a folder."""

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from droptrack.analysis.page import error_text, page_of
from droptrack.analysis.records import (
    Analysis,
    Axis,
    Chart,
    Cloud,
    Curve,
    Figure,
    Quantity,
    Snapshot,
    factor,
    unit_key,
    unit_text,
)
from droptrack.data.files import replacing, write_text
from droptrack.data.report import Report, Value
from droptrack.data.units import Units
from droptrack.errors import DroptrackError
from droptrack.version import __version__

MAX_CLOUD = 20_000  # points of a cloud in its table


def check_free(out: Path, name: str, *, overwrite: bool) -> None:
    """Raise DroptrackError where a folder has results of this analysis that are to be kept."""
    if (out / f"{name}.json").exists() and not overwrite:
        raise DroptrackError(f"{out}: has a {name}.json already; --overwrite replaces it")


def write_analysis(out: Path, name: str, found: Analysis, units: Units) -> Report:
    """Write NAME.json, NAME.html, a PNG and a CSV for each figure, and the tables, to a folder.

    Returns what is to be printed.
    """
    from droptrack.analysis.plots import draw

    out.mkdir(parents=True, exist_ok=True)
    for figure in found.figures:
        shown = in_units(figure, units)
        with replacing(out / f"{name}_{figure.name}.png") as partial:
            draw(partial, shown, units)
        if not isinstance(shown, Snapshot):
            _write_csv(out / f"{name}_{figure.name}.csv", *_table_of(shown))
    for table, rows in found.tables.items():
        header = list(rows[0]) if rows else ["none"]
        _write_csv(out / f"{name}_{table}.csv", header, [list(row.values()) for row in rows])
    write_text(out / f"{name}.html", page_of(name, found, units))
    content = json.dumps(_without_nan(_content(found, units)), indent=1)
    write_text(out / f"{name}.json", content + "\n")  # the last: then all is there
    return Report(found.title, {}, {**found.counts, **_printed(found, units)}, [])


def keys_of(one: Quantity, units: Units) -> dict[str, float]:
    """A quantity's value by its key, in px and frames, and in um and s where they are known.

    >>> one = Quantity(stem="speed", label="", value=2.0, definition="", dimension=(1, -1))
    >>> keys_of(one, Units(um_per_px=0.5, fps=100))
    {'speed_px_per_frame': 2.0, 'speed_um_per_s': 100.0}
    """
    keys = {one.stem + unit_key(one.dimension, physical=False): 1.0}
    scale = factor(one.dimension, units)
    if scale is not None:
        keys[one.stem + unit_key(one.dimension, physical=True)] = scale
    return {key: one.value * by for key, by in keys.items()}


def _content(found: Analysis, units: Units) -> dict[str, Any]:
    """Every value at the top, by its key; then each quantity in full."""
    content: dict[str, Any] = {"title": found.title, "made_by": f"droptrack {__version__}"}
    content |= {"settings": dict(found.settings), **found.counts}
    for one in found.quantities:
        content |= keys_of(one, units)
        if math.isfinite(one.error):
            spread = replace(one, value=one.error)
            content |= {f"{key}_error": value for key, value in keys_of(spread, units).items()}
    content["not_defined"] = {
        one.stem: one.reason for one in found.quantities if not math.isfinite(one.value)
    }
    content["quantities"] = [
        {
            "key": one.stem + unit_key(one.dimension, physical=False),
            "label": one.label,
            "unit": unit_text(one.dimension, physical=False),
            "value": one.value,
            "error": one.error,
            "null": one.null,
            "null_model": one.null_model,
            "definition": one.definition,
            "reason": one.reason,
        }
        for one in found.quantities
    ]
    content["notes"] = list(found.notes)
    return content


def _printed(found: Analysis, units: Units) -> dict[str, Value]:
    """Each quantity as text, in one unit, with its error and its null model."""
    lines: dict[str, Value] = {}
    for one in found.quantities:
        scale = factor(one.dimension, units)
        key = one.stem + unit_key(one.dimension, physical=scale is not None)
        lines[key] = text_of(one, scale or 1.0)
    return lines


def text_of(one: Quantity, scale: float = 1.0) -> str:
    """The value, its error, and what chance gives, or why it is not defined."""
    if not math.isfinite(one.value):
        return f"not defined: {one.reason}"
    text = f"{one.value * scale:.4g}"
    if math.isfinite(one.error):
        text += f" ± {error_text(one.error * scale)}"
    if math.isfinite(one.null):
        text += f"   (null model: {one.null * scale:.4g})"
    return text


def in_units(figure: Figure, units: Units) -> Figure:
    """A chart or cloud in um and s where they are known, with the units in its labels."""
    if isinstance(figure, Snapshot):
        return figure
    axes, scales = [], []
    for axis in (figure.x, figure.y):
        scale = factor(axis.dimension, units)
        unit = unit_text(axis.dimension, physical=scale is not None)
        stem = axis.stem + unit_key(axis.dimension, physical=scale is not None)
        axes.append(Axis(label=f"{axis.label} / {unit}" if unit else axis.label, stem=stem))
        scales.append(scale or 1.0)
    by_x, by_y = scales
    if isinstance(figure, Cloud):
        x, y = figure.values
        return replace(figure, x=axes[0], y=axes[1], values=(x * by_x, y * by_y))
    curves = [
        replace(
            one,
            x=one.x * by_x,
            y=one.y * by_y,
            error=None if one.error is None else one.error * by_y,
        )
        for one in figure.curves
    ]
    return replace(figure, x=axes[0], y=axes[1], curves=curves)


def _table_of(figure: Chart | Cloud) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of a figure's table."""
    x, y = figure.x.stem, figure.y.stem
    if isinstance(figure, Cloud):
        some = _evenly(len(figure.droplets), MAX_CLOUD)
        columns = (figure.droplets[some], figure.values[0][some], figure.values[1][some])
        rows = zip(*(one.tolist() for one in columns), strict=True)
        return ["track_id", x, y], [list(row) for row in rows]
    return ["curve", x, y, f"{y}_error"], [
        [curve.label, *values]
        for curve in figure.curves
        for values in zip(curve.x.tolist(), curve.y.tolist(), _errors(curve).tolist(), strict=True)
    ]


def _errors(curve: Curve) -> Any:
    return np.full(len(curve.x), np.nan) if curve.error is None else curve.error


def _evenly(n: int, most: int) -> Any:
    """At most so many of n, evenly over all."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int)) if n else np.zeros(0, int)


def _write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(
            [f"{one:.8g}" if isinstance(one, float) else one for one in row] for row in rows
        )


def _without_nan(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
