"""The user's own columns, as numbers where all of a column are."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from droptrack.data.formats.table import Table
from droptrack.data.formats.tables import read_csv, table_of_columns
from droptrack.data.trajectories import TEXT
from droptrack.data.trajectories import WHOLE as WHOLE_FURTHER
from droptrack.errors import DroptrackError
from droptrack.studies.lists import is_number

if TYPE_CHECKING:
    from droptrack.studies.jobs import Job

WHOLE = ("frame", "track_id", *WHOLE_FURTHER)  # columns of whole numbers
FLAGS = ("observed", "centre_of_mass", "at_edge")  # columns of yes and no
Types = Mapping[str, type]  # of the free columns: int, float or str


def free_types(jobs: "Sequence[Job]") -> dict[str, type]:
    """The free columns of all videos, and what each holds: whole numbers, numbers, or text.

    Empty cells say nothing of it.
    """
    columns = dict.fromkeys(name for job in jobs for name in job.free)
    types: dict[str, type] = {}
    for name in columns:
        texts = [job.free[name] for job in jobs if job.free.get(name)]
        kinds = (kind for kind in (int, float) if all(is_number(text, kind) for text in texts))
        types[name] = next(kinds, str) if texts else str
    return types


def free_values(job: "Job", types: Types) -> dict[str, Any]:
    """The values of a video's free columns; None where a cell is empty."""
    return {
        name: kind(text) if (text := job.free.get(name, "")) else None
        for name, kind in types.items()
    }


def has_pyarrow() -> bool:
    """Whether Parquet can be written."""
    return find_spec("pyarrow") is not None


def pyarrow() -> Any:
    """The package; raises DroptrackError where it is not installed."""
    try:
        import pyarrow
        import pyarrow.csv
        import pyarrow.parquet
    except ImportError:
        raise DroptrackError("Parquet needs pyarrow: pip install 'droptrack[batch]'") from None
    return pyarrow


def read_rows(path: Path) -> tuple[Any, dict[str, str]]:
    """A table of trajectories as pyarrow's, and what its `#` lines say; raises DroptrackError."""
    arrow = pyarrow()
    about, header, n_about = {}, "", 0
    with path.open(encoding="utf-8") as file:
        for n_about, header in enumerate(file):  # noqa: B007
            if not header.startswith("#"):
                break
            key, _, value = header[1:].partition(":")
            about[key.strip()] = value.strip()
    names = header.strip().split(",")
    flags = {name: arrow.int64() for name in names if name in FLAGS}
    try:
        rows = arrow.csv.read_csv(
            path,
            read_options=arrow.csv.ReadOptions(skip_rows=n_about),
            convert_options=arrow.csv.ConvertOptions(
                column_types={**{name: kind_of(name) for name in names}, **flags}
            ),
        )
    except arrow.ArrowException as error:
        raise DroptrackError(f"{path}: cannot be read: {error}") from None
    return rows, about


def kind_of(column: str) -> Any:
    """The type of a column of trajectories."""
    arrow = pyarrow()
    if column in FLAGS:
        return arrow.bool_()
    if column in TEXT:
        return arrow.string()
    return arrow.int64() if column in WHOLE else arrow.float64()


def read_table(path: Path) -> Table:
    """A table of trajectories, ten times as fast where pyarrow is installed.

    Raises DroptrackError for a file that cannot be read.
    """
    if not has_pyarrow():
        return read_csv(path)
    rows, about = read_rows(path)
    columns = {name: rows[name].to_numpy() for name in rows.column_names}
    return table_of_columns(path, columns, about)
