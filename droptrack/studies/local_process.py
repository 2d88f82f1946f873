"""The process of a worker: jobs come in, outcomes go out, pickled.

Started by `local`, with the numbers of the cores that it may use. What it and its libraries print
goes into the log of the video that is being done.
"""

import os
import pickle
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def main() -> None:
    """Do jobs until no more come."""
    cores = {int(core) for core in sys.argv[1].split(",")}
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)  # before libraries count them
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, str(len(cores)))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends us
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)

    from droptrack.interrupts import ended_as_by_ctrl_c
    from droptrack.studies.jobs import LOG
    from droptrack.studies.work import do_video

    def answer(message: Any) -> None:
        try:
            pickle.dump(message, answers)
            answers.flush()
        except OSError:  # nobody is there any more
            raise KeyboardInterrupt from None

    try:
        with ended_as_by_ctrl_c():
            answer("ready")
            while True:
                job = pickle.load(sys.stdin.buffer)
                with _printing_to(job.folder / LOG):
                    outcome = do_video(job, lambda n_done, n_all: answer((n_done, n_all)))
                answer(outcome)
    except (EOFError, KeyboardInterrupt):
        pass


@contextmanager
def _printing_to(log: Any) -> Iterator[None]:
    """Have all that is printed go to a file, where it can be written."""
    before = os.dup(2)
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        target = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    except OSError:
        target = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(target, stream)
    os.close(target)
    try:
        yield
    finally:
        sys.stderr.flush()
        for stream in (1, 2):
            os.dup2(before, stream)
        os.close(before)


if __name__ == "__main__":
    main()
