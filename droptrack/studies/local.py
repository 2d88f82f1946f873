"""Workers on this machine: processes, each with its share of the cores."""

import os
import pickle
import queue
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from droptrack.errors import DroptrackError
from droptrack.studies.jobs import Job
from droptrack.studies.outcome import Outcome
from droptrack.studies.workers import MAX_IN_VAIN, Advance, Deaths, Note, Told

MODULE = "droptrack.studies.local_process"
GRACE_S = 20.0  # seconds that a worker has to finish its files
BYTES_A_WORKER = 1_500_000_000  # of memory: a network, its frames, and what Python needs


class LocalWorkers:
    """Processes that do one video at a time, each on cores of its own.

    A process that dies is replaced, and its video goes on from where it was. `n`: 0 for as many as
    suit the machine.
    """

    def __init__(self, n: int = 0) -> None:
        self._cores = usable_cores()
        self.n = n or fitting_workers(len(self._cores), available_bytes())
        plural = "workers" if self.n > 1 else "worker"
        self.described = f"{self.n} {plural} on {len(self._cores)} cores"

    def work(self, jobs: Sequence[Job]) -> Generator[Told]:
        """Do jobs, and tell how far they are; ends when each has its outcome."""
        told: queue.Queue[Told | BaseException] = queue.Queue()
        waiting, deaths = deque(jobs), Deaths()
        shares = [self._cores[k :: self.n] or self._cores for k in range(min(self.n, len(jobs)))]
        workers = [
            _Worker(f"worker {k}", share, waiting, told, deaths)
            for k, share in enumerate(shares, 1)
        ]
        for worker in workers:
            worker.start()
        n_left = len(jobs)
        try:
            while n_left:
                item = told.get()
                if isinstance(item, BaseException):
                    raise item
                n_left -= isinstance(item, Outcome)
                yield item
        finally:
            waiting.clear()
            for worker in workers:
                worker.end()
            for worker in workers:
                worker.join()


class _Worker(threading.Thread):
    """Hands jobs to a process, one after the other, and replaces it when it dies."""

    def __init__(
        self,
        name: str,
        cores: list[int],
        waiting: deque[Job],
        told: "queue.Queue[Told | BaseException]",
        deaths: Deaths,
    ) -> None:
        super().__init__(name=name, daemon=True)
        self._cores, self._waiting, self._told, self._deaths = cores, waiting, told, deaths
        self._process: subprocess.Popen[bytes] | None = None
        self._ending = False

    def run(self) -> None:
        """Do jobs until none is left."""
        try:
            while not self._ending and self._waiting:
                try:
                    job = self._waiting.popleft()
                except IndexError:  # another one was faster
                    break
                self._do(job)
        except Exception as problem:  # noqa: BLE001  raised where the jobs are counted
            self._told.put(problem)
        finally:
            self._close()

    def end(self) -> None:
        """Have the process finish its files and go."""
        self._ending = True
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()

    def _do(self, job: Job) -> None:
        while not self._ending:
            process = self._process or self._start()
            assert process.stdin is not None
            try:
                pickle.dump(job, process.stdin)
                process.stdin.flush()
                while not isinstance(message := self._read(process), Outcome):
                    n_done, n_all = message
                    self._deaths.advanced(job.name, n_done)
                    advance = Advance(name=job.name, worker=self.name, n_done=n_done, n_all=n_all)
                    self._told.put(advance)
            except (EOFError, OSError, pickle.UnpicklingError):
                self._process = None
                ended = _ended_by(process)
                if self._ending:
                    return
                if not self._deaths.died(job.name):
                    reason = f"the worker that did it {ended}, again and again without getting on"
                    self._told.put(Outcome(name=job.name, reason=reason))
                    return
                self._told.put(Note(f"{self.name} {ended}; {job.name} goes on in a new one"))
                continue
            self._told.put(message)
            return

    def _start(self) -> "subprocess.Popen[bytes]":
        """A new process that is ready; raises DroptrackError where none can be.

        One that is killed while it starts is replaced, like those that are killed later.
        """
        ended = ""
        for _ in range(MAX_IN_VAIN):
            process = self._new_process()
            try:
                self._read(process)
            except (EOFError, OSError, pickle.UnpicklingError):
                self._process = None
                ended = _ended_by(process)
                if self._ending:
                    raise EOFError from None
                if process.returncode >= 0:  # it cannot start
                    break
                self._told.put(Note(f"{self.name} {ended} while it started; another one does"))
            else:
                return process
        raise DroptrackError(f"a worker {ended} while it started")

    def _new_process(self) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", MODULE, ",".join(map(str, self._cores))]
        paths = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )
        self._process = process
        return process

    @staticmethod
    def _read(process: "subprocess.Popen[bytes]") -> Any:
        assert process.stdout is not None
        return pickle.load(process.stdout)  # from a process of ours

    def _close(self) -> None:
        process = self._process
        if process is None:
            return
        assert process.stdin is not None
        with suppress(OSError):  # it is gone
            process.stdin.close()
        _ended_by(process)


def _ended_by(process: "subprocess.Popen[bytes]") -> str:
    """Wait for the end of a process; returns how it ended, in words."""
    try:
        code = process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return "did not answer"
    finally:
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what was not sent stays so
                    pipe.close()
    if code < 0:
        return f"was killed by signal {-code}{' (for want of memory?)' if code == -9 else ''}"
    return f"ended with {code}"


def usable_cores() -> list[int]:
    """The numbers of the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def available_bytes() -> int:
    """Memory that is free, or can be; 0 where nobody says."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:  # noqa: PTH123
            values = dict(line.split(":", 1) for line in file)
        return int(values["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return 0


def fitting_workers(n_cores: int, n_bytes: int) -> int:
    """How many workers suit cores and memory: one for two cores.

    A network keeps one core busy; decoding, tracking and drawing another.

    >>> fitting_workers(2, 8_000_000_000), fitting_workers(16, 64_000_000_000)
    (1, 8)
    >>> fitting_workers(16, 4_000_000_000)
    2
    """
    by_cores = max(1, n_cores // 2)
    return max(1, min(by_cores, n_bytes // BYTES_A_WORKER)) if n_bytes else by_cores
