"""LIST.csv: a row a video, with options of its own and columns that are carried to the end."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from droptrack.data.files import read_text
from droptrack.errors import DroptrackError
from droptrack.studies.columns import COLUMNS, OF_TRAJECTORIES
from droptrack.studies.options import Given, VideoOptions

VIDEO, NAME = "video", "name"
WHOLE = re.compile(r"-?(0|[1-9]\d{0,17})", re.ASCII)
NUMBER = re.compile(
    r"[+-]?((0|[1-9]\d{0,17})(\.\d*)?|\.\d+)(e[+-]?\d{1,3})?", re.IGNORECASE | re.ASCII
)
PATHS = ("weights", "cfg", "region", "appearance", "appearance_weights")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A video that was asked for, and where: a file, folder or address.

    `name`: of its folder, where the list says one; `options`: its own; `free`: the user's columns.
    """

    video: str
    where: str
    name: str = ""
    options: Mapping[str, Given] = field(default_factory=dict)
    free: Mapping[str, str] = field(default_factory=dict)


def read_list(path: Path, options: VideoOptions) -> list[Entry]:
    """The videos of a list, separated by commas, semicolons or tabs.

    The first line has the columns' names, ``video`` among them. Empty cells say nothing. Paths are
    sought in the list's folder, then in the current one. Where semicolons separate, numbers may
    have decimal commas. Raises DroptrackError that names the line.
    """
    lines = read_text(path).splitlines()
    head = next((line for line in lines if line.strip()), "")
    separator = max(",;\t", key=head.count)
    try:
        rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=separator, strict=True))
    except csv.Error as error:
        raise DroptrackError(
            f"{path}: cannot be read as a table: {error}; is a quote left open?"
        ) from None
    numbered = [(n, [cell.strip() for cell in row]) for n, row in enumerate(rows, 1) if any(row)]
    if not numbered:
        raise DroptrackError(f"{path}: is empty")
    columns = numbered[0][1]
    while columns and not columns[-1]:
        columns.pop()  # some spreadsheets end every line with separators
    option_of = _options_of(path, columns, options)
    entries = []
    for n, row in numbered[1:]:
        if any(row[len(columns) :]):
            raise DroptrackError(
                f"{path}: line {n} has {len(row)} cells, the first one {len(columns)}; a cell with "
                f"a {separator!r} in it needs quotes"
            )
        cells = dict(zip(columns, [*row, *[""] * len(columns)], strict=False))
        entries.append(_entry(path, n, cells, option_of, options, decimal_comma=separator == ";"))
    if not entries:
        raise DroptrackError(f"{path}: names no video, only columns")
    return entries


def _options_of(path: Path, columns: Sequence[str], options: VideoOptions) -> dict[str, str | None]:
    """The option of each column, None of the user's own; raises DroptrackError."""
    twice = next((name for name in columns if columns.count(name) > 1), None)
    if twice is not None:
        raise DroptrackError(f"{path}: has two columns {twice!r}")
    if VIDEO not in columns:
        raise DroptrackError(f"{path}: has no column {VIDEO!r}, only {', '.join(columns)}")
    option_of: dict[str, str | None] = {}
    for column in columns:
        if column in (VIDEO, NAME):
            continue
        try:
            option_of[column] = options.name_of(column)
        except DroptrackError as error:
            raise DroptrackError(f"{path}: {error}") from None
        is_ours = column.lower() in (*COLUMNS, *OF_TRAJECTORIES)
        if option_of[column] is None and (is_ours or not column):
            raise DroptrackError(
                f"{path}: column {column!r}: the results have one of this name; rename it"
            )
    return option_of


def _entry(
    path: Path,
    n: int,
    cells: Mapping[str, str],
    option_of: Mapping[str, str | None],
    options: VideoOptions,
    *,
    decimal_comma: bool,
) -> Entry:
    where = f"{path}: line {n}"
    if not cells[VIDEO]:
        raise DroptrackError(f"{where}: names no video")
    own: dict[str, Given] = {}
    for column, option in option_of.items():
        if option is None or not cells[column]:
            continue
        text = _sought(path, cells[column]) if option in PATHS else cells[column]
        try:
            own[option] = options.of_cell(option, text, decimal_comma=decimal_comma)
        except DroptrackError as error:
            raise DroptrackError(f"{where}: {error}") from None
    free = {column: cells[column] for column, option in option_of.items() if option is None}
    if decimal_comma:
        free = _with_points(free)
    return Entry(
        video=_sought(path, cells[VIDEO]),
        where=where,
        name=cells.get(NAME, ""),
        options=own,
        free=free,
    )


def _sought(path: Path, name: str) -> str:
    """A file as the list means it: beside the list, else as it stands there."""
    if "://" in name:
        return name
    beside = path.parent / name
    try:
        return str(beside) if beside.exists() and not Path(name).is_absolute() else name
    except OSError:  # too long a name: a region's polygon, for one
        return name


def _with_points(free: Mapping[str, str]) -> dict[str, str]:
    """Numbers with decimal commas as Python writes them."""
    pointed = {}
    for column, text in free.items():
        number = text.replace(",", ".")
        pointed[column] = number if is_number(number) else text
    return pointed


def is_number(text: str, kind: type = float) -> bool:
    """Whether a text is a number of a kind, int or float, and nothing else: 007 is a name.

    >>> is_number("0.65"), is_number("1e-3"), is_number("12", int), is_number("007")
    (True, True, True, False)
    """
    return bool((WHOLE if kind is int else NUMBER).fullmatch(text))
