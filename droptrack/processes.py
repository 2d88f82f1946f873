"""Starts processes that do not hear of a Ctrl-C before they are ready for it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def signals_held(*numbers: signal.Signals) -> Iterator[None]:
    """Within, signals wait, and processes that are started hold them for good.

    A process that is spawned imports for seconds; a Ctrl-C, which comes to all processes of a
    terminal, would end it with a traceback. This process gets the signal when it leaves. Nothing
    where the system cannot hold signals (Windows).
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # else it lets the signals through when it is started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
