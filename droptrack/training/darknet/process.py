"""A running Darknet: its console as events, its stdin, and the means to end it."""

import contextlib
import os
import queue
import re
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import IO

from droptrack.training.darknet.console import ESCAPES, Console, Event

COMPLAINT = re.compile(r"error|couldn't|can't|cannot|invalid|abort|terminate", re.IGNORECASE)
STOP_SECONDS = 10.0  # that a Darknet has to end when asked to


class DarknetProcess:
    """A started Darknet in a process group of its own, so that Ctrl-C does not reach it.

    All that it prints is kept in ``darknet.log`` of the folder it runs in, at once.
    """

    def __init__(self, command: list[str], folder: Path) -> None:
        self.heard = time.monotonic()  # when it last printed something
        # when each came; None: it has ended
        self.events: queue.SimpleQueue[tuple[float, Event | None]] = queue.SimpleQueue()
        self._log = (folder / "darknet.log").open("ab", buffering=0)
        self._log.write(f"# {command}\n".encode())
        self.popen = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        streams = [stream for stream in (self.popen.stdout, self.popen.stderr) if stream]
        self._readers = [
            threading.Thread(target=self._read, args=(stream,), daemon=True) for stream in streams
        ]
        self._waiter = threading.Thread(target=self._wait, daemon=True)
        for thread in (*self._readers, self._waiter):
            thread.start()

    def _read(self, stream: IO[bytes]) -> None:
        console = Console()
        while chunk := os.read(stream.fileno(), 65536):
            self.heard = time.monotonic()
            self._log.write(chunk)
            for event in console.feed(chunk):
                self.events.put((self.heard, event))

    def _wait(self) -> None:
        for reader in self._readers:
            reader.join()
        self.popen.wait()
        self.events.put((time.monotonic(), None))

    def answer(self, text: str) -> None:
        """Write a line to its stdin."""
        if self.popen.stdin is not None:
            with contextlib.suppress(BrokenPipeError):  # it has ended in the meantime
                self.popen.stdin.write(text.encode() + b"\n")
                self.popen.stdin.flush()

    def stop(self) -> None:
        """End it and all it started, by force if it does not end when asked to."""
        for number in (signal.SIGINT, signal.SIGKILL):
            if self._waiter.is_alive():
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self.popen.pid, number)
                self._waiter.join(STOP_SECONDS)
        for stream in (self.popen.stdin, self.popen.stdout, self.popen.stderr, self._log):
            if stream is not None:
                stream.close()


def last_words(log: Path) -> str:
    """The last line of a darknet.log that speaks of an error, or its last line."""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - 8192))
        text = ESCAPES.sub("", file.read().decode("utf-8", errors="replace")).replace("\r", "\n")
    lines = [line.strip(" *\x07") for line in text.splitlines() if line.strip(" *\x07")]
    complaints = [line for line in lines if COMPLAINT.search(line)]
    return (complaints or lines or ["nothing"])[-1]
