"""What workers tell, and when one that keeps dying is given up."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Protocol

from droptrack.studies.jobs import Job
from droptrack.studies.outcome import Outcome

MAX_DEATHS = 3  # of workers at the same frame of a video: it is the video that kills them
SAME_FRAMES = 50  # between two words of how far a video is, which come twice a second
MAX_IN_VAIN = 10  # deaths, wherever, since a video got further than ever before


@dataclass(frozen=True, kw_only=True)
class Advance:
    """How far the video of a worker is; `n_all` is 0 where nobody knows."""

    name: str
    worker: str
    n_done: int
    n_all: int


@dataclass(frozen=True)
class Note:
    """Something that the user should know."""

    text: str


Told = Advance | Outcome | Note


class Workers(Protocol):
    """Do videos, several at a time; `described` says where, in a few words."""

    described: str

    def work(self, jobs: Sequence[Job]) -> Generator[Told]:
        """Do jobs, and tell how far they are; ends when each has its outcome.

        Closing the iterator ends what is going on.
        """


class Deaths:
    """How often workers died at each video, and how far they had come.

    What kills workers may be the video, or have nothing to do with it, as where nodes are taken
    away: those die at any frame, or before the first one.
    """

    def __init__(self) -> None:
        self._now: dict[str, int] = {}  # how far the worker of a video is, from its first word on
        self._furthest: dict[str, int] = {}
        self._alike: dict[str, tuple[int, int]] = {}  # deaths at the same frame, and the frame
        self._n_in_vain: dict[str, int] = {}

    def advanced(self, name: str, n_done: int) -> None:
        """Note how far a video is."""
        self._now[name] = n_done
        if n_done > self._furthest.get(name, 0):
            self._furthest[name] = n_done
            self._n_in_vain[name] = 0
            self._alike.pop(name, None)

    def died(self, name: str) -> bool:
        """Note that a worker died; whether its video should be tried again."""
        self._n_in_vain[name] = self._n_in_vain.get(name, 0) + 1
        frame = self._now.pop(name, None)
        n_alike = 0
        if frame is not None:
            n_before, before = self._alike.get(name, (0, frame))
            n_alike = n_before + 1 if abs(frame - before) <= SAME_FRAMES else 1
            self._alike[name] = n_alike, frame
        return n_alike < MAX_DEATHS and self._n_in_vain[name] < MAX_IN_VAIN
