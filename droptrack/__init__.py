"""Find and track droplets in videos of flowing emulsions."""

from droptrack.errors import DroptrackError
from droptrack.version import __version__

__all__ = ["DroptrackError", "__version__"]
