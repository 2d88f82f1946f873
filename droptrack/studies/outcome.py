"""What came of a video."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Why a video failed, or nothing; frames that were done, and the seconds they took."""

    name: str
    reason: str = ""
    n_frames: int = 0
    seconds: float = 0.0
    disk_is_full: bool = False
