"""What a run tells its user beside the results."""

import sys
from collections.abc import Callable

Say = Callable[[str], object]


def to_stderr(text: str) -> None:
    """Tell it on stderr."""
    print(text, file=sys.stderr)
