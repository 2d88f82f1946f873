"""Tables of numbers: Parquet, trackpy, napari, and TrackMate's CSV."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats
from droptrack.data.files import read_text, reading, replacing
from droptrack.data.formats.table import PIXEL_CENTRE, Table, table_of
from droptrack.data.trajectories import (
    BOX_CENTRE,
    TEXT,
    WHOLE,
    as_written,
    kind_of,
    read_trajectories,
    write_trajectories,
)
from droptrack.errors import DroptrackError

OURS = ("track_id", "frame", "x", "y", *BOX_CENTRE, "w", "h", "score", "observed")
ABOUT = b"droptrack"  # the key of a Parquet file's metadata
TRACKPY = ("frame", "particle", "x", "y")
NAPARI = ("track_id", "t", "y", "x")
# names, short names and dimensions of TrackMate's columns, as its own table of spots has them
TRACKMATE = (
    ("LABEL", "Label", "Label", ""),
    ("ID", "Spot ID", "Spot ID", ""),
    ("TRACK_ID", "Track ID", "Track ID", ""),
    ("QUALITY", "Quality", "Quality", "quality"),
    ("POSITION_X", "X", "X", "length"),
    ("POSITION_Y", "Y", "Y", "length"),
    ("POSITION_Z", "Z", "Z", "length"),
    ("POSITION_T", "T", "T", "time"),
    ("FRAME", "Frame", "Frame", ""),
    ("RADIUS", "Radius", "R", "length"),
    ("VISIBILITY", "Visibility", "Visibility", ""),
)

READ = ("TRACK_ID", "QUALITY", "POSITION_X", "POSITION_Y", "FRAME", "RADIUS")  # columns of spots


def write_csv(path: Path, table: Table) -> None:
    """Our own table."""
    with replacing(path) as partial:
        write_trajectories(partial, table.rows, table.about)


def read_csv(path: Path) -> Table:
    """Our own table."""
    rows, about = read_trajectories(path)
    return Table(rows=rows, about=about)


def columns_of(table: Table) -> dict[str, NDArray[Any]]:
    """All columns, by the names of our table."""
    rows = table.rows
    boxes = dict(zip((*BOX_CENTRE, "w", "h"), rows.boxes.T, strict=True))
    fixed = {"frame": rows.frame, "track_id": rows.track_id, "x": rows.x, "y": rows.y}
    return {**fixed, **boxes, "score": rows.scores, "observed": rows.observed, **rows.columns}


def table_of_columns(
    path: Path, found: dict[str, NDArray[Any]], about: dict[str, str], said: Sequence[str] = ()
) -> Table:
    """A table from columns by the names of ours; without boxes they are points.

    `said`: notes so far.
    """
    for name in ("frame", "track_id", "x", "y"):
        if name not in found:
            raise DroptrackError(f"{path}: has no column {name}")
    column: dict[str, NDArray[Any]] = {}
    notes = list(said)
    for name, values in found.items():
        if name in TEXT:
            column[name] = found[name] = np.asarray(values, np.str_)
            continue
        try:
            column[name] = np.asarray(values, np.float64)
        except (ValueError, TypeError):
            if name in OURS:
                raise DroptrackError(f"{path}: column {name} should be numbers") from None
            notes.append(f"column {name} is no numbers and is left out")
    x, y, zero = column["x"], column["y"], np.zeros(len(column["x"]))
    centre = [column.get(name, column[name[-1]]) for name in BOX_CENTRE]
    return table_of(
        path,
        frame=column["frame"],
        track_id=column["track_id"],
        boxes=np.column_stack([*centre, column.get("w", zero), column.get("h", zero)]),
        x=x,
        y=y,
        scores=column.get("score"),
        observed=column["observed"] != 0 if "observed" in column else None,
        columns={
            name: found[name].astype(np.int64) if name in WHOLE else found[name]
            for name in column
            if name not in OURS
        },
        about=about,
        notes=notes,
    )


def write_parquet(path: Path, table: Table) -> None:
    """Columns with their types; the `#` lines are in the file's metadata, as JSON."""
    pyarrow = parquet_library()
    written = pyarrow.table(columns_of(table))
    written = written.replace_schema_metadata({ABOUT: json.dumps(dict(table.about)).encode()})
    with replacing(path) as partial:
        pyarrow.parquet.write_table(written, partial)


def read_parquet(path: Path) -> Table:
    """Columns by the names of our table."""
    pyarrow = parquet_library()
    try:
        with reading(path, "Parquet"):
            stored = pyarrow.parquet.read_table(path)
    except pyarrow.ArrowException as error:
        raise DroptrackError(f"{path}: cannot be read as Parquet: {error}") from None
    try:
        about = dict(json.loads((stored.schema.metadata or {}).get(ABOUT, b"{}")))
    except (ValueError, TypeError) as error:
        raise DroptrackError(f"{path}: metadata {ABOUT.decode()}: {error}") from None
    columns = {name: stored[name].to_numpy() for name in stored.column_names}
    return table_of_columns(path, columns, about)


def parquet_library() -> Any:
    """Pyarrow; raises DroptrackError where it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise DroptrackError("Parquet needs pyarrow: pip install 'droptrack[formats]'") from None
    return pyarrow


def write_trackpy(path: Path, table: Table) -> None:
    """``frame,particle,x,y`` first, the rest after; pixel c covers [c, c + 1), as in our table."""
    columns = columns_of(table)
    names = {"frame": "frame", "track_id": "particle", "x": "x", "y": "y"}
    rest = {name: name for name in columns if name not in names}
    _write(path, {new: columns[name] for name, new in {**names, **rest}.items()})


def read_trackpy(path: Path) -> Table:
    """A table as trackpy's `link` gives it, with ``frame, particle, x, y``; `size` is a radius."""
    columns = _read(path)
    if "particle" not in columns:
        raise DroptrackError(f"{path}: has no column particle; link the features first")
    columns["track_id"] = columns.pop("particle")
    columns.pop("", None)  # the numbers of pandas' rows
    shift = min(0.0, columns["track_id"].min(initial=1) - 1)  # ours begin at 1
    columns["track_id"] = columns["track_id"] - shift
    if "w" not in columns and "size" in columns:
        columns["w"] = columns["h"] = 2 * columns["size"]
    return table_of_columns(path, columns, {})


def write_napari(path: Path, table: Table) -> None:
    """``track_id,t,y,x``, the data of napari's Tracks, sorted by them; then the properties."""
    rows = table.rows
    order = np.lexsort((rows.frame, rows.track_id))
    x, y = rows.x - PIXEL_CENTRE, rows.y - PIXEL_CENTRE
    data = dict(zip(NAPARI, (rows.track_id, rows.frame, y, x), strict=True))
    rest = {name: one for name, one in columns_of(table).items() if name not in {*NAPARI, "frame"}}
    _write(path, {name: column[order] for name, column in {**data, **rest}.items()})


def read_napari(path: Path) -> Table:
    """What `write_napari` wrote."""
    columns = _read(path)
    columns["frame"] = columns.pop("t")
    for name in ("x", "y"):
        columns[name] = columns[name] + PIXEL_CENTRE
    return table_of_columns(path, columns, {})


def write_trackmate_csv(path: Path, table: Table) -> None:
    """The table of spots as TrackMate exports it, under its four lines of names and units."""
    rows, units = table.rows, table.units
    um, fps = units.um_per_px or 1.0, units.fps
    names = {"length": "pixel" if units.um_per_px is None else "micron", "quality": "quality"}
    names["time"] = "frame" if fps is None else "sec"
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for k in range(3):
            writer.writerow([column[k] for column in TRACKMATE])
        writer.writerow([f"({names[one[3]]})" if one[3] else "" for one in TRACKMATE])
        x, y = (rows.x - PIXEL_CENTRE) * um, (rows.y - PIXEL_CENTRE) * um
        radii, times = table.diameters() / 2 * um, rows.frame / (fps or 1.0)
        for i in range(len(rows)):
            place = [rows.scores[i], x[i], y[i], 0.0, times[i]]
            numbers = [repr(float(value)) for value in place]
            last = [int(rows.frame[i]), repr(float(radii[i])), 1]
            writer.writerow([f"ID{i}", i, int(rows.track_id[i]) - 1, *numbers, *last])


def read_trackmate_csv(path: Path, um_per_px: float | None) -> Table:
    """TrackMate's table of spots; spots without a track are left out, which is said.

    Lengths in other units than px need `um_per_px`; raises DroptrackError without.
    """
    lines = list(csv.reader(read_text(path).splitlines()))
    if len(lines) < 4 or lines[0][:3] != ["LABEL", "ID", "TRACK_ID"]:
        raise DroptrackError(f"{path}: should begin with TrackMate's four lines of names")
    column = {name: k for k, name in enumerate(lines[0])}
    for name in ("TRACK_ID", "FRAME", "POSITION_X", "POSITION_Y"):
        if name not in column:
            raise DroptrackError(f"{path}: has no column {name}")
    start = 4 if lines[3][column["POSITION_X"]].startswith("(") else 1
    unit = lines[3][column["POSITION_X"]].strip("()") if start == 4 else "pixel"
    um = px_of_unit(path, unit, um_per_px)
    spots = [line for line in lines[start:] if line]
    linked = [line for line in spots if line[column["TRACK_ID"]] not in {"", "None"}]
    try:
        found = {
            name: np.array([float(line[k]) if line[k] else np.nan for line in linked])
            for name, k in column.items()
            if name in READ
        }
    except (ValueError, IndexError) as error:
        raise DroptrackError(f"{path}: {error}") from None
    notes = [f"{len(spots) - len(linked)} spots in no track left out"] if spots != linked else []
    if others := [name for name in column if name not in {one[0] for one in TRACKMATE}]:
        notes.append(f"columns left out: {', '.join(others)}")
    return spots_table(path, found, um, notes)


def spots_table(path: Path, found: dict[str, Floats], um: float, notes: list[str]) -> Table:
    """A table from the features (M,) of TrackMate's spots, whose lengths are in `um` a px."""
    x, y = (found[f"POSITION_{axis}"] / um + PIXEL_CENTRE for axis in "XY")
    diameter = 2 * found["RADIUS"] / um if "RADIUS" in found else np.zeros(len(x))
    about = {"um per px": f"{um:.10g}"} if um != 1 else {}
    return table_of(
        path,
        frame=found["FRAME"],
        track_id=found["TRACK_ID"] + 1,
        boxes=np.column_stack([x, y, diameter, diameter]),
        scores=found.get("QUALITY"),
        about=about,
        notes=notes,
    )


def px_of_unit(path: Path, unit: str, um_per_px: float | None) -> float:
    """How many of a length's unit a pixel is; raises DroptrackError where nobody says."""
    if unit in {"pixel", "pixels", "px", ""}:
        return 1.0
    if unit not in {"micron", "microns", "um", "µm", "μm", "micrometer"}:
        raise DroptrackError(f"{path}: lengths in {unit} are not understood; px or micrometres are")
    if um_per_px is None:
        raise DroptrackError(f"{path}: lengths are in micrometres; give --um-per-px")
    return um_per_px


def _write(path: Path, columns: dict[str, NDArray[Any]]) -> None:
    """A CSV with six decimals, as our table has."""
    line = ",".join(kind_of(one) for one in columns.values()) + "\n"
    values = zip(*map(as_written, columns.values()), strict=True)
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        file.writelines(line % row for row in values)


def _read(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of a CSV of numbers, but for those of TEXT; an empty field is NaN."""
    lines = [line for line in csv.reader(read_text(path).splitlines()) if line]
    header = lines[0] if lines else []
    flags = {"True": "1", "False": "0", "": "nan"}
    columns: dict[str, NDArray[Any]] = {}
    try:
        fields = list(zip(*lines[1:], strict=True)) or [()] * len(header)
        for name, column in zip(header, fields, strict=True):
            if name in TEXT:
                columns[name] = np.array(column, np.str_)
            else:
                columns[name] = np.array([float(flags.get(one, one)) for one in column], float)
    except ValueError as error:
        raise DroptrackError(f"{path}: {error}") from None
    return columns
