"""Trajectories of a file -> tables of events, passages and stays, and a report of them."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from droptrack.data.files import replacing
from droptrack.data.formats.table import Table
from droptrack.data.report import Report, Value
from droptrack.data.trajectories import Trajectories, write_trajectories
from droptrack.data.units import Units
from droptrack.errors import DroptrackError
from droptrack.tracking.events.lineage import Event, Kind, find_events
from droptrack.tracking.events.passages import (
    Line,
    Passage,
    Region,
    Stay,
    parse_line,
    parse_region,
    passages,
    stays,
)
from droptrack.tracking.events.plot_names import parse_plots


@dataclass(frozen=True, kw_only=True)
class EventsConfig:
    """What to look for: lines and regions as they are given, see `events.passages`; plots' names.

    Of plots, see `events.plots.parse_plots`; none where it is empty. `region_option`: what regions
    were given with.
    """

    lines: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()
    plots: str = ""
    region_option: str = "--region"


def wanted_events(lines: Sequence[str], stays: Sequence[str], plots: str) -> EventsConfig | None:
    """What to look for in a run, as its options --line, --stays and --plots say; None: nothing.

    Raises DroptrackError for a plot of another name; lines and regions need the frames' size.
    """
    if not (lines or stays or plots):
        return None
    if plots:
        parse_plots(plots)
    return EventsConfig(
        lines=tuple(lines), regions=tuple(stays), plots=plots, region_option="--stays"
    )


def parsed(
    config: EventsConfig, size: tuple[int, int]
) -> tuple[list[Line], list[Region], Callable[[Path, Trajectories, Sequence[Event], Table], None]]:
    """Lines, regions, and what draws the plots, in images of a size, px.

    Raises DroptrackError for a line or region that is none, and for a plot of another name.
    """
    lines = [parse_line(text, size) for text in config.lines]
    regions = [parse_region(text, size, config.region_option) for text in config.regions]
    return lines, regions, _plots_of(config.plots)


def write_events(
    out: Path, table: Table, config: EventsConfig, *, overwrite: bool = False
) -> Report:
    """Write events.csv, passages.csv, stays.csv and trajectories.csv, with lineage, to a folder.

    Raises DroptrackError as `parsed` does, and where there is such a table, unless it is to be
    overwritten.
    """
    lines, regions, draw = parsed(config, table.size)
    if (out / "trajectories.csv").exists() and not overwrite:
        raise DroptrackError(f"{out}: has a trajectories.csv already; choose another --out")
    events, rows = find_events(table.rows, table.size)
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / "trajectories.csv") as partial:
        write_trajectories(partial, rows, table.about)
    _write(out / "events.csv", [_event_row(event, table.units) for event in events], Event)
    summary: dict[str, Value] = {
        f"n_{kind.replace('-', '_')}": sum(event.kind == kind for event in events) for kind in Kind
    }
    rows_of_passages: list[dict[str, Any]] = []
    n_frames = table.n_frames - int(table.rows.frame.min(initial=0))
    for k, line in enumerate(lines, 1):
        found = passages(rows, line)
        rows_of_passages += _passage_rows(k, found, table.units)
        summary |= _of_line(f"line_{k}", found, n_frames, table.units)
    if lines:
        _write(out / "passages.csv", rows_of_passages, Passage)
    rows_of_stays: list[dict[str, Any]] = []
    for k, region in enumerate(regions, 1):
        found_stays = stays(rows, region)
        rows_of_stays += [{"region": k, **_stay_row(one, table.units)} for one in found_stays]
        summary |= _of_region(f"region_{k}", found_stays, n_frames, table.units)
    if regions:
        _write(out / "stays.csv", rows_of_stays, Stay)
    settings: dict[str, Value] = {
        **table.about,
        "lines": list(config.lines),
        "regions": list(config.regions),
    }
    draw(out, rows, events, table)
    report = Report("Events", settings, summary, [])
    report.write_json(out / "report.json")
    return report


def _plots_of(
    names: str,
) -> Callable[[Path, Trajectories, Sequence[Event], Table], None]:
    """What draws the plots of these names; refuses other names before anything is written."""
    if not names:
        return lambda *_: None
    from droptrack.tracking.events.plots import draw_plots

    plots = parse_plots(names)
    return lambda out, rows, events, table: draw_plots(
        out, plots, rows, events, table.units, table.size
    )


def _event_row(event: Event, units: Units) -> dict[str, Any]:
    row = asdict(event)
    row["parents"], row["children"] = (
        " ".join(map(str, one)) for one in (event.parents, event.children)
    )
    return {**row, **_times(event.frame, units)}


def _times(frame: float, units: Units) -> dict[str, float]:
    return {} if units.fps is None else {"time_s": frame / units.fps}


def _passage_rows(line: int, found: Sequence[Passage], units: Units) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    before = float("nan")
    for one in found:
        row = {"line": line, **asdict(one), "frames_since_last": one.frame - before}
        if units.um_per_px is not None:
            row["diameter_um"] = one.diameter_px * units.um_per_px
            if units.fps is not None:
                row["speed_um_per_s"] = one.speed_px_per_frame * units.um_per_px * units.fps
        rows.append({**row, **_times(one.frame, units)})
        before = one.frame
    return rows


def _of_line(name: str, found: Sequence[Passage], n_frames: int, units: Units) -> dict[str, Value]:
    """What is said of a line: counts, frequency, spacing, speed and size."""
    forward = sum(one.forward == 1 for one in found)
    gaps = np.diff([one.frame for one in found])
    sizes = np.array([one.diameter_px for one in found])
    sizes = sizes[np.isfinite(sizes)]
    speeds = np.array([one.speed_px_per_frame for one in found])
    spacing = gaps * speeds[1:]
    summary: dict[str, Value] = {
        f"{name}_n_forward": forward,
        f"{name}_n_backward": len(found) - forward,
        f"{name}_passages_per_frame": len(found) / n_frames if n_frames else float("nan"),
        f"{name}_mean_spacing_px": _mean(spacing),
        f"{name}_mean_speed_px_per_frame": _mean(speeds),
        f"{name}_mean_diameter_px": _mean(sizes),
    }
    if units.fps is not None and n_frames:
        summary[f"{name}_frequency_hz"] = len(found) * units.fps / n_frames
    if units.um_per_px is not None:
        summary[f"{name}_mean_spacing_um"] = units.um_per_px * _mean(spacing)
        summary[f"{name}_mean_diameter_um"] = units.um_per_px * _mean(sizes)
    return summary


def _stay_row(one: Stay, units: Units) -> dict[str, Any]:
    n_frames = one.last_frame - one.first_frame + 1
    row = {**asdict(one), "whole": int(one.whole), "n_frames": n_frames}
    return row if units.fps is None else {**row, "duration_s": n_frames / units.fps}


def _of_region(name: str, found: Sequence[Stay], n_frames: int, units: Units) -> dict[str, Value]:
    """What is said of a region: stays, how long the whole ones are, droplets in it on average."""
    lengths = np.array([one.last_frame - one.first_frame + 1 for one in found], float)
    whole = lengths[[one.whole for one in found]] if found else lengths
    summary: dict[str, Value] = {
        f"{name}_n_stays": len(found),
        f"{name}_n_whole_stays": len(whole),
        f"{name}_mean_whole_stay_frames": _mean(whole),
        f"{name}_mean_n_droplets": float(lengths.sum() / n_frames) if n_frames else float("nan"),
    }
    if units.fps is not None:
        summary[f"{name}_mean_whole_stay_s"] = _mean(whole) / units.fps
    return summary


def _mean(values: "np.ndarray[Any, np.dtype[np.float64]]") -> float:
    return float(values.mean()) if len(values) else float("nan")


def _write(path: Path, rows: Sequence[dict[str, Any]], kind: type[Any]) -> None:
    """A CSV; where there is nothing to say, the names of what would have been."""
    header = list(rows[0]) if rows else [field.name for field in fields(kind)]
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, header, lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {
                name: f"{value:.6f}" if isinstance(value, float) else value
                for name, value in row.items()
            }
            for row in rows
        )
