"""Workers of a Dask cluster: one that is there, or jobs of SLURM or PBS that become one."""

import logging
import queue
import shutil
import uuid
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any

from droptrack.errors import DroptrackError
from droptrack.pipeline.notes import Say
from droptrack.studies.choice import WorkersConfig
from droptrack.studies.jobs import Job
from droptrack.studies.outcome import Outcome
from droptrack.studies.workers import Advance, Deaths, Note, Told
from droptrack.version import __version__

CONNECT_S = 20  # seconds in which a scheduler must answer
LOOK_S = 1.0  # seconds between two looks at which workers there are
TOPIC = "droptrack-"
SUBMITS = {"slurm": "sbatch", "pbs": "qsub"}  # what a cluster takes jobs by


def job_cluster(config: WorkersConfig) -> Any:
    """A cluster whose workers are jobs of SLURM or PBS; raises DroptrackError.

    What the options do not say is taken from Dask's own configuration (jobqueue.yaml).
    """
    command = SUBMITS[config.cluster or "slurm"]
    if shutil.which(command) is None:
        raise DroptrackError(
            f"--{config.cluster}: there is no {command} here: run it where jobs can be submitted"
        )
    try:
        from dask_jobqueue import PBSCluster, SLURMCluster
    except ImportError:
        raise DroptrackError(
            f"--{config.cluster} needs dask-jobqueue: pip install 'droptrack[batch]'"
        ) from None
    kind = {"slurm": SLURMCluster, "pbs": PBSCluster}[config.cluster or "slurm"]
    further: dict[str, Any] = {} if config.queue is None else {"queue": config.queue}
    try:
        return kind(
            cores=config.job_cores,
            processes=1,
            memory=config.job_memory,
            walltime=config.walltime,
            job_name="droptrack",
            worker_extra_args=["--nthreads", "1", "--no-nanny"],
            job_script_prologue=[f"export OMP_NUM_THREADS={config.job_cores}"],
            **further,
        )
    except (ValueError, RuntimeError, OSError) as error:
        raise DroptrackError(f"--{config.cluster}: {error}") from None


@contextmanager
def dask_workers(config: WorkersConfig, say: Say) -> Iterator["DaskWorkers"]:
    """The workers of a cluster by its address, or of jobs; raises DroptrackError."""
    try:
        from distributed import Client
    except ImportError:
        raise DroptrackError("--scheduler needs Dask: pip install 'droptrack[batch]'") from None
    if config.cluster is not None:
        cluster = job_cluster(config)
        try:
            with _refusals_of_jobs(f"--{config.cluster}") as refusals:
                # jobs that end before all is done are replaced
                cluster.adapt(minimum_jobs=config.jobs, maximum_jobs=config.jobs)
                with Client(cluster) as client:
                    if find_spec("bokeh") is not None:  # which draws the dashboard
                        _say_dashboard(client, say)
                    yield DaskWorkers(client, refusals)
        finally:
            _close(cluster)
        return
    address = config.scheduler or ""
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        why = str(error).splitlines()[0] if str(error) else "nobody answers"
        raise DroptrackError(f"--scheduler {address}: cannot be reached: {why}") from None
    with client:
        _refuse_other_versions(client, address)
        _say_dashboard(client, say)
        yield DaskWorkers(client)


def _close(cluster: Any) -> None:
    """Close a cluster, and one whose jobs were refused, too, at which Dask's own check fails."""
    try:
        cluster.close()
    except AssertionError:  # the last it does: all else is closed
        cluster.status = type(cluster.status).closed


def _say_dashboard(client: Any, say: Say) -> None:
    if client.dashboard_link:
        say(f"Dask's dashboard: {client.dashboard_link}")


class _Refusals(logging.Filter):
    """Keeps why jobs could not be submitted, which Dask only logs, out of the terminal."""

    def __init__(self, option: str) -> None:
        super().__init__()
        self._option = option
        self._last = ""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is of anything else."""
        error = record.exc_info[1] if record.exc_info else None
        if not isinstance(error, OSError | RuntimeError):
            return True
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        self._last = lines[-1] if lines else type(error).__name__  # what the command said itself
        return False

    def take(self) -> str:
        """Why the last job could not be submitted, once; empty where all could."""
        last, self._last = self._last, ""
        return last and f"{self._option}: no job could be submitted: {last}"


@contextmanager
def _refusals_of_jobs(option: str) -> Iterator[_Refusals]:
    """What Dask logs of jobs that cannot be submitted, for those who wait for these."""
    refusals, log = _Refusals(option), logging.getLogger("tornado.application")
    log.addFilter(refusals)
    try:
        yield refusals
    finally:
        log.removeFilter(refusals)


def _refuse_other_versions(client: Any, address: str) -> None:
    """Raise DroptrackError where workers have another droptrack, or none."""
    found = client.run(_version, on_error="return")
    for worker, version in found.items():
        if isinstance(version, Exception):
            raise DroptrackError(
                f"--scheduler {address}: the worker {worker} has no droptrack that can be used: "
                f"{type(version).__name__}: {' '.join(str(version).split())[:200]}"
            )
        if version != __version__:
            raise DroptrackError(
                f"--scheduler {address}: the worker {worker} has droptrack {version}, this is "
                f"{__version__}: install one version everywhere"
            )


def _version() -> str:
    from droptrack.version import __version__ as version

    return version


class DaskWorkers:
    """Gives each worker of a cluster one video at a time, as long as there are any.

    Workers may come and go: Dask gives the video of one that is gone to another, and it goes on
    from where it was.
    """

    def __init__(self, client: Any, refusals: _Refusals | None = None) -> None:
        self._client, self._refusals = client, refusals
        self.described = f"the Dask cluster at {client.scheduler.address}"

    def work(self, jobs: Sequence[Job]) -> Generator[Told]:
        """Do jobs, and tell how far they are; ends when each has its outcome."""
        told: queue.Queue[Any] = queue.Queue()
        topic = TOPIC + uuid.uuid4().hex
        waiting, running, deaths = deque(jobs), dict[Any, Job](), Deaths()
        self._client.subscribe_topic(topic, lambda event: told.put(event[1]))
        n_left, alone = len(jobs), False
        try:
            while n_left:
                n_workers = self._n_workers()
                if refusal := self._refusals and self._refusals.take():
                    if not n_workers:
                        raise DroptrackError(f"{refusal}; what was done stays")
                    yield Note(refusal)
                while waiting and len(running) < n_workers:
                    job = waiting.popleft()
                    future = self._client.submit(
                        do_on_worker, job, topic, pure=False, key=f"{job.name}-{uuid.uuid4().hex}"
                    )
                    running[future] = job
                    future.add_done_callback(told.put)
                if not n_workers and not alone:
                    yield Note("no worker is there: waiting for one")
                alone = not n_workers
                try:
                    item = told.get(timeout=LOOK_S)
                except queue.Empty:
                    continue
                if isinstance(item, dict):
                    deaths.advanced(item["name"], item["n_done"])
                    yield Advance(**item)
                    continue
                job = running.pop(item)
                result = self._outcome(item, job, deaths)
                if result is None:
                    waiting.appendleft(job)
                    yield Note(f"workers died at {job.name}; it goes on in another one")
                    continue
                n_left -= 1
                yield result
        finally:
            self._client.cancel(list(running))
            self._client.unsubscribe_topic(topic)

    def _n_workers(self) -> int:
        """How many workers there are now; raises DroptrackError where the scheduler is gone."""
        try:
            if self._client.status == "running":
                return len(self._client.nthreads())
        except OSError:  # as Dask has it for a connection that breaks
            pass
        raise DroptrackError(
            f"{self.described} is gone; what was done stays: the same command goes on"
        )

    def _outcome(self, future: Any, job: Job, deaths: Deaths) -> Outcome | None:
        """What came of a video; None where it is to be tried again."""
        from distributed import KilledWorker

        if future.status == "finished":
            found: Outcome = future.result()
            return found
        if future.status != "error":  # cancelled, or lost with the scheduler's memory
            return None if deaths.died(job.name) else _given_up(job, "Dask lost it")
        error = future.exception()
        if isinstance(error, KilledWorker):
            return None if deaths.died(job.name) else _given_up(job, "workers died at it")
        return _given_up(job, f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")


def _given_up(job: Job, why: str) -> Outcome:
    return Outcome(name=job.name, reason=f"{why}; see {job.place}")


def do_on_worker(job: Job, topic: str) -> Outcome:
    """Do a job, in a worker; how far it is goes to those who listen to a topic."""
    from distributed import get_worker

    from droptrack.studies.work import do_video

    worker = get_worker()

    def tell(send: Any, n_done: int, n_all: int) -> None:
        send(
            topic,
            {"name": job.name, "worker": worker.address, "n_done": n_done, "n_all": n_all},
        )

    try:
        return do_video(job, partial(tell, worker.log_event))
    except KeyboardInterrupt:
        return Outcome(name=job.name, reason="the worker was ended")
