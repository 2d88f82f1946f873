"""What came of a video."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Why a video failed, or nothing; frames that were done, and the seconds they took.

    `disk_is_full`, `other_version` (of droptrack, on the worker): the next ones would fail, too.
    """

    name: str
    reason: str = ""
    n_frames: int = 0
    seconds: float = 0.0
    disk_is_full: bool = False
    other_version: bool = False
