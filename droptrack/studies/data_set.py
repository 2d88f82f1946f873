"""All trajectories of a study as one Parquet data set, a partition a video."""

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from droptrack.data.files import replacing
from droptrack.data.sources.opencv_names import printable
from droptrack.studies.jobs import Job
from droptrack.studies.tables import FLAGS, Types, free_values, kind_of, pyarrow, read_rows

FILE = "rows.parquet"
STAMP = b"droptrack batch"  # the key of a partition's metadata: what it was made of
KEY = "video"


def write_data_set(folder: Path, jobs: Sequence[Job], types: Types) -> None:
    """Write a data set with the partitions ``video=NAME`` of jobs that are done, and no others.

    All partitions have the columns of all videos, so that each reader finds them: those that a
    video lacks are empty. Partitions that are up to date are left. Raises DroptrackError for a
    table that cannot be read.
    """
    columns = _columns_of_all(jobs)
    places = {f"{KEY}={quote(printable(job.name), safe=' ')}": job for job in jobs}
    folder.mkdir(parents=True, exist_ok=True)
    for other in folder.glob(f"{KEY}=*"):
        if other.name not in places:
            shutil.rmtree(other)
    for place, job in places.items():
        _write_partition(folder / place / FILE, job, columns, types)


def _columns_of_all(jobs: Sequence[Job]) -> list[str]:
    """The columns of the videos' tables, each once."""
    columns: dict[str, None] = {}
    for job in jobs:
        path = job.folder / "trajectories.csv"
        with path.open(encoding="utf-8") as file:
            header = next((line for line in file if not line.startswith("#")), "")
        columns |= dict.fromkeys(header.strip().split(","))
    return list(columns)


def _write_partition(path: Path, job: Job, columns: Sequence[str], types: Types) -> None:
    arrow = pyarrow()
    table_file = job.folder / "trajectories.csv"
    stat = table_file.stat()
    values = free_values(job, types)
    stamp = json.dumps(
        [
            stat.st_size,
            stat.st_mtime_ns,
            list(columns),
            values,
            [k.__name__ for k in types.values()],
        ]
    ).encode()
    if _stamp_of(path, arrow) == stamp:
        return
    rows = read_rows(table_file)[0]
    kinds = {int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    found = {}
    for name in columns:
        kind = kind_of(name)
        column = rows[name] if name in rows.column_names else arrow.nulls(len(rows), kind)
        found[name] = column.cast(arrow.int64()).cast(kind) if name in FLAGS else column.cast(kind)
    for name, value in values.items():
        found[name] = arrow.array([value] * len(rows), kinds[types[name]])
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        written = arrow.table(found).replace_schema_metadata({STAMP: stamp})
        arrow.parquet.write_table(written, partial)


def _stamp_of(path: Path, arrow: Any) -> bytes | None:
    try:
        metadata: Mapping[bytes, bytes] | None = arrow.parquet.read_schema(path).metadata
    except (OSError, arrow.ArrowException):
        return None
    return (metadata or {}).get(STAMP)
