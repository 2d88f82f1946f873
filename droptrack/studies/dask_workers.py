"""Workers of a Dask cluster: one that is there, or jobs of SLURM or PBS that become one."""

import queue
import uuid
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
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


def job_cluster(config: WorkersConfig) -> Any:
    """A cluster whose workers are jobs of SLURM or PBS; raises DroptrackError.

    What the options do not say is taken from Dask's own configuration (jobqueue.yaml).
    """
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
            # jobs that end before all is done are replaced
            cluster.adapt(minimum_jobs=config.jobs, maximum_jobs=config.jobs)
            with Client(cluster) as client:
                yield DaskWorkers(client, say)
        finally:
            cluster.close()
        return
    address = config.scheduler or ""
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        why = str(error).splitlines()[0] if str(error) else "nobody answers"
        raise DroptrackError(f"--scheduler {address}: cannot be reached: {why}") from None
    with client:
        _refuse_other_versions(client, address)
        yield DaskWorkers(client, say)


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

    def __init__(self, client: Any, say: Say) -> None:
        self._client = client
        self.described = f"the Dask cluster at {client.scheduler.address}"
        if client.dashboard_link:
            say(f"Dask's dashboard: {client.dashboard_link}")

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
