"""What a command found: a title, settings, a summary, one row a droplet -> text and JSON."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from rich.console import Console
from rich.table import Table

from droptrack.data.files import write_text
from droptrack.data.sources.opencv_names import printable

MAX_ROWS = 20  # of a printed table, where a file has all
Value: TypeAlias = str | int | float | bool | list[int] | list[str] | None


@dataclass(frozen=True)
class Report:
    """Results with the unit in every key, such as `mse_y_px2`. NaN stands for undefined."""

    title: str
    settings: Mapping[str, Value]
    summary: Mapping[str, Value]
    droplets: Sequence[Mapping[str, Value]]
    gaps: Sequence[Mapping[str, Value]] | None = None  # of tracks, where there may be any

    def print(self, without: Sequence[str] = (), all_in: Path | str = "") -> None:
        """Print the droplets as a table, `without` some columns, and the summary, on stdout.

        Of long tables only the first rows are printed if there is a file `all_in` which all are.
        """
        console = Console()
        if not console.is_terminal:
            console.width = 120  # a file or a pipe has no width of its own
        if self.droplets:
            _print_table(console, self.title, self.droplets, without, all_in)
        if self.gaps:
            _print_table(console, "Bridged gaps of more than 3 frames", self.gaps, (), all_in)
        width = max((len(key) for key in self.summary), default=0)
        for key, value in self.summary.items():
            console.print(f"{key.replace('_', ' '):{width}}  {_text(value)}", highlight=False)

    def write_json(self, path: Path) -> None:
        """Write everything; NaN becomes null."""
        content = {
            "title": self.title,
            "settings": dict(self.settings),
            "summary": dict(self.summary),
            "droplets": [dict(droplet) for droplet in self.droplets],
        }
        if self.gaps is not None:
            content["gaps"] = [dict(gap) for gap in self.gaps]
        write_text(path, json.dumps(_without_nan(content), indent=1) + "\n")


def _print_table(
    console: Console,
    title: str,
    rows: Sequence[Mapping[str, Value]],
    without: Sequence[str],
    all_in: Path | str,
) -> None:
    """Print rows, of many only the first ones, and say where all are."""
    shown = rows[:MAX_ROWS] if all_in else rows
    console.print(_table(title, shown, without))
    if len(shown) < len(rows):
        text = f"{len(shown)} of {len(rows)}: all are in {printable(str(all_in))}"
        console.print(text, highlight=False, markup=False, soft_wrap=True)


def _table(title: str, rows: Sequence[Mapping[str, Value]], without: Sequence[str]) -> Table:
    """Rows with the same keys, `without` some."""
    table = Table(title=title, title_justify="left")
    keys = [key for key in rows[0] if key not in without]
    for key in keys:
        table.add_column(key.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(_text(row[key]) for key in keys))
    return table


def _text(value: Value) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return " ".join(str(part) for part in value)
    return "" if value is None else str(value)


def _without_nan(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_nan(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_without_nan(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
