"""The errors a user can mend."""


class DroptrackError(Exception):
    """A problem the user can mend: names the file or setting, what was tried and the cure."""


class InterruptedRunError(DroptrackError):
    """What was going on was ended from outside, and may be resumed."""


class UnwritableError(DroptrackError, OSError):
    """A file cannot be written; `errno` says why, as that of the system does."""

    def __init__(self, message: str, errno: int | None = None) -> None:
        super().__init__(message)
        self.errno = errno
