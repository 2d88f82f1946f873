"""Which workers do a study: processes here, or those of a cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from droptrack.errors import DroptrackError
from droptrack.pipeline.notes import Say
from droptrack.studies.local import LocalWorkers
from droptrack.studies.workers import Workers


@dataclass(frozen=True, kw_only=True)
class WorkersConfig:
    """Who does the work.

    `n`: videos at a time on this machine, 0 for as many as suit it; or `scheduler`: the address of
    a Dask cluster; or `cluster`: whose `jobs` are started, of `job_cores` and `job_memory` each,
    for a `walltime`, in a `queue`.
    """

    n: int = 0
    scheduler: str | None = None
    cluster: Literal["slurm", "pbs"] | None = None
    jobs: int = 4
    job_cores: int = 4
    job_memory: str = "4GB"
    walltime: str = "04:00:00"
    queue: str | None = None

    def __post_init__(self) -> None:
        ways = [bool(self.n), self.scheduler is not None, self.cluster is not None]
        if sum(ways) > 1:
            raise DroptrackError("--workers, --scheduler, --slurm, --pbs: give one of them")


@contextmanager
def choose_workers(config: WorkersConfig, say: Say) -> Iterator[Workers]:
    """The workers that are asked for; raises DroptrackError where there are none."""
    if config.scheduler is None and config.cluster is None:
        yield LocalWorkers(config.n)
        return
    from droptrack.studies.dask_workers import dask_workers

    with dask_workers(config, say) as workers:
        yield workers
