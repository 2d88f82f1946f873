"""Find and follow droplets in videos of flowing emulsions."""

__version__ = "0.1.0"


class DroptrackError(Exception):
    """A problem the user can mend: names the file or setting, what was tried and the cure."""
