"""Names of files that OpenCV opens rightly, whatever the file is called, and without a word."""

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2

# FFmpeg prints what it finds damaged, line by line; what of it matters is said by droptrack
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

SILENT = 0  # OpenCV's LOG_LEVEL_SILENT
CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # a new line, for one


@contextmanager
def opencv_name(path: Path) -> Iterator[str]:
    """A name for OpenCV and FFmpeg, good within the block only; the file need not exist yet.

    It is absolute, since FFmpeg takes what is before a colon for a protocol. OpenCV crashes at
    names that are no UTF-8: these get a link with another name.
    """
    absolute = os.path.abspath(path)  # noqa: PTH100  of links, not of what they lead to
    try:
        absolute.encode()
    except UnicodeEncodeError:
        with tempfile.TemporaryDirectory() as folder:
            link = Path(folder) / "folder"
            link.symlink_to(Path(absolute).parent, target_is_directory=True)
            try:
                path.name.encode()
            except UnicodeEncodeError:
                link = Path(folder) / f"file{path.suffix if path.suffix.isascii() else ''}"
                link.symlink_to(absolute)
                yield str(link)
            else:
                yield str(link / path.name)
    else:
        yield absolute


@contextmanager
def without_log() -> Iterator[None]:
    """Let OpenCV print nothing on stderr; what failed is said by errors."""
    log: Any = getattr(cv2.utils, "logging", cv2)  # where OpenCV 4.10 has it
    level = log.getLogLevel()
    log.setLogLevel(SILENT)
    try:
        yield
    finally:
        log.setLogLevel(level)


def printable(text: str) -> str:
    r"""Text that can be written anywhere, in one line.

    Bytes of a name that are no UTF-8 become ``\udcXX``, a new line ``\n``.

    >>> print(printable("a\nb"))
    a\nb
    """
    shown = CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)
    return shown.encode("utf-8", "backslashreplace").decode()
