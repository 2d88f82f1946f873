"""The user's own columns, as numbers where all of a column are."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from droptrack.errors import DroptrackError
from droptrack.studies.jobs import Job
from droptrack.studies.lists import is_number

Types = Mapping[str, type]  # of the free columns: int, float or str


def free_types(jobs: Sequence[Job]) -> dict[str, type]:
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


def free_values(job: Job, types: Types) -> dict[str, Any]:
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
