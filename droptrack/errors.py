"""The errors a user can mend."""


class DroptrackError(Exception):
    """A problem the user can mend: names the file or setting, what was tried and the cure."""


class InterruptedRunError(DroptrackError):
    """What was going on was ended from outside, and may be resumed."""
