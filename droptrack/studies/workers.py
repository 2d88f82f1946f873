"""What workers tell, and when one that keeps dying is given up."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Protocol

from droptrack.studies.jobs import Job
from droptrack.studies.outcome import Outcome

MAX_DEATHS = 3  # of workers at the same frame of a video: it is the video that kills them


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
    """How often workers died at each video, and how far they had come."""

    def __init__(self) -> None:
        self._furthest: dict[str, int] = {}
        self._at_death: dict[str, tuple[int, int]] = {}  # how often, and the frame

    def advanced(self, name: str, n_done: int) -> None:
        """Note how far a video is."""
        self._furthest[name] = max(n_done, self._furthest.get(name, 0))

    def died(self, name: str) -> bool:
        """Note that a worker died; whether its video should be tried again."""
        frame = self._furthest.get(name, 0)
        n_deaths, before = self._at_death.get(name, (0, frame))
        n_deaths = n_deaths + 1 if frame <= before else 1
        self._at_death[name] = n_deaths, frame
        return n_deaths < MAX_DEATHS
