"""The table of a study: a row a video."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from droptrack.data.files import read_text, replacing
from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError
from droptrack.studies.analyses import numbers_of
from droptrack.studies.columns import COLUMNS, N_FIRST
from droptrack.studies.jobs import Job, read_kept
from droptrack.studies.tables import Types, pyarrow

Row = dict[str, Any]


def summarise(job: Job) -> Row:
    """The row of a video: COLUMNS, None where nothing is known; ``_free`` and ``_found``.

    ``_free`` are the user's columns, ``_found`` the numbers of analyses and of events.

    `diameter_px` and `speed_px_per_frame` are means over the droplets, each counted once;
    `polydispersity` is the standard deviation of their diameters over the mean; the frequency
    counts droplets that come after the first frame, over the frames from the first to the last.
    """
    kept = read_kept(job.folder)
    row: Row = dict.fromkeys(COLUMNS)
    row |= {"name": printable(job.name), "video": printable(job.video)}
    row |= {"state": "left", "reason": "not done yet"}
    row["weights_sha256"] = job.made_from.get("weights sha256")
    row |= {"_free": job.free, "_found": {}}
    if kept is None:
        return row
    row |= {"state": kept.state, "reason": kept.reason, "version": kept.version}
    row["warnings"] = printable(" | ".join(_warnings(kept.said, job.video)))
    if kept.state == "running":
        row |= {"state": "left", "reason": "was ended before it was done"}
    if kept.state != "done":
        return row
    try:
        report = json.loads(read_text(job.folder / "report.json"))
        row |= _numbers(report) | {key: kept.facts.get(key) for key in _EVENTS}
        events = job.config.events is not None
        row["_found"] = numbers_of(job.folder, kept.analysed, events=events)
    except (DroptrackError, ValueError, KeyError, TypeError) as error:
        return row | {"state": "failed", "reason": f"its results cannot be read: {error}"}
    return row | {"seconds": kept.seconds}


NO_WARNINGS = (  # what was chosen, and the like: said of videos of which nothing is doubtful
    *(" px, on ", "resumed after", "compiling loops", "um wide, as the file says", "as MPEG-4 "),
    *("the model for droplets as laboratories film them", "the network sees "),
    "droplets that it cuts are at_edge",
)
_EVENTS = ("n_coalescence", "n_break_up")


def _numbers(report: Mapping[str, Any]) -> Row:
    settings, summary = report["settings"], report["summary"]
    fps, um_per_px = settings.get("fps"), settings.get("um_per_px")
    diameters = _known(report["droplets"], "diameter_px")
    speeds = _known(report["droplets"], "speed_px_per_frame")
    mean = float(diameters.mean()) if len(diameters) else None
    speed = float(speeds.mean()) if len(speeds) else None
    n_steps = summary["n_frames"] + summary["n_frames_missing"] - 1
    frequency = summary["n_entered"] / n_steps if n_steps > 0 else None
    return {
        **{name: summary[name] for name in COLUMNS if name in summary and name != "seconds"},
        "diameter_px": mean,
        "diameter_um": _product(mean, um_per_px),
        "polydispersity": float(diameters.std()) / mean if mean else None,
        "frequency_per_frame": frequency,
        "frequency_per_s": _product(frequency, fps),
        "speed_px_per_frame": speed,
        "speed_um_per_s": _product(speed, um_per_px, fps),
        "fps": fps,
        "um_per_px": um_per_px,
        "backend": settings.get("backend"),
    }


def _known(droplets: Sequence[Mapping[str, Any]], key: str) -> "np.ndarray[Any, Any]":
    return np.array([one[key] for one in droplets if one.get(key) is not None], np.float64)


def _product(*factors: float | None) -> float | None:
    known = [factor for factor in factors if factor is not None]
    return float(np.prod(known)) if len(known) == len(factors) else None


def _warnings(said: Sequence[str], video: str) -> list[str]:
    """What a run said that its user should look at."""
    lines = [line.removeprefix(f"{video}: ") for line in said]
    return [line for line in lines if not any(text in line for text in NO_WARNINGS)]


def write_csv(path: Path, rows: Sequence[Row], types: Types) -> None:
    """Write rows, with the free columns after the video's name and state."""
    names, found = _names(types), _found(rows, types)
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, *found])
        for row in rows:
            cells = {**row, **dict(row["_free"])}
            numbers = [row["_found"].get(key) for key in found.values()]
            writer.writerow([_cell(value) for value in (*map(cells.get, names), *numbers)])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def write_parquet(path: Path, rows: Sequence[Row], types: Types) -> None:
    """Write rows with their types."""
    arrow = pyarrow()
    kinds = {int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    columns = {}
    for name in _names(types):
        if name in types:
            values = [_free(row, name, types) for row in rows]
        else:
            values = [row[name] for row in rows]
        columns[name] = arrow.array(values, kinds[types.get(name) or COLUMNS[name]])
    for name, key in _found(rows, types).items():
        values = [row["_found"].get(key) for row in rows]
        whole = all(isinstance(value, int) for value in values if value is not None)
        columns[name] = arrow.array(values, kinds[int if whole else float])
    with replacing(path) as partial:
        arrow.parquet.write_table(arrow.table(columns), partial)


def _free(row: Row, name: str, types: Types) -> Any:
    text = row["_free"].get(name, "")
    return types[name](text) if text else None


def _names(types: Types) -> list[str]:
    own = list(COLUMNS)
    return [*own[:N_FIRST], *types, *own[N_FIRST:]]


def _found(rows: Sequence[Row], types: Types) -> dict[str, str]:
    """The columns of what analyses and events found, and the key of each.

    They end in ``_found`` where the user has a column of the same name.
    """
    keys = dict.fromkeys(key for row in rows for key in row["_found"])
    return {f"{key}_found" if key in types else key: key for key in keys}
