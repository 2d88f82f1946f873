"""What ends a command from outside, so that nothing is half done when it does."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker

# Ctrl-C; what a cluster sends; what a terminal sends that closes
ENDINGS = ("SIGINT", "SIGTERM", "SIGHUP")


class _State:
    """Of the process: how many blocks may not be left now, and whether an end came meanwhile."""

    blocks = 0
    ended = False


@contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """Have every one of the ENDINGS raise KeyboardInterrupt, once a `whole` block is done.

    SIGTERM and SIGHUP only once: what is being finished is not interrupted again. What nohup has
    ignored stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    known = (signal.SIG_DFL, signal.default_int_handler)
    numbers = [getattr(signal, name) for name in ENDINGS if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    ours = [number for number in numbers if before[number] in known]
    others = [number for number in ours if number != signal.SIGINT]

    def end(number: int, _: object) -> None:
        if number != signal.SIGINT:
            for other in others:
                signal.signal(other, signal.SIG_IGN)
        if signal.Signals(number).name == "SIGHUP":
            _print_nowhere()
        if _State.blocks:
            _State.ended = True
        else:
            raise KeyboardInterrupt

    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, before[number])


@contextmanager
def whole() -> Iterator[None]:
    """A block that is done as a whole or not at all: what ends the command waits for it."""
    _State.blocks += 1
    try:
        yield
    finally:
        _State.blocks -= 1
        if _State.ended and not _State.blocks:
            _State.ended = False
            raise KeyboardInterrupt


def _print_nowhere() -> None:
    """Let nothing fail because there is no terminal any more."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # some streams are no files
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


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
