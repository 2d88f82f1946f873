"""What a study leaves beside the videos' folders: tables, a data set, and a page."""

from collections.abc import Sequence
from pathlib import Path

from droptrack.pipeline.notes import Say
from droptrack.studies.data_set import write_data_set
from droptrack.studies.jobs import STATE, Job
from droptrack.studies.page import write_page
from droptrack.studies.summary import summarise, write_csv, write_parquet
from droptrack.studies.tables import free_types, has_pyarrow


def write_results(out: Path, jobs: Sequence[Job], say: Say) -> int:
    """Write ``summary.csv``, ``summary.parquet``, ``trajectories/`` and ``index.html``.

    Returns how many of the videos have no results.
    """
    others = {path.parent.name for path in out.glob(f"*/{STATE}")} - {job.name for job in jobs}
    if others:
        say(f"{len(others)} more folders in {out} are of other videos, and in none of the tables")
    rows = [summarise(job) for job in jobs]
    types = free_types(jobs)
    write_csv(out / "summary.csv", rows, types)
    write_page(out, jobs, rows)
    if has_pyarrow():
        write_parquet(out / "summary.parquet", rows, types)
        done = [job for job, row in zip(jobs, rows, strict=True) if row["state"] == "done"]
        write_data_set(out / "trajectories", done, types)
    else:
        say("no summary.parquet and no trajectories/: pip install 'droptrack[batch]'")
    return sum(row["state"] != "done" for row in rows)
