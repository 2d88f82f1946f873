"""Names of files that OpenCV opens rightly, whatever the file is called."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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


def printable(text: str) -> str:
    r"""Text that can be written anywhere; bytes of a name that are no UTF-8 become ``\udcXX``."""
    return text.encode("utf-8", "backslashreplace").decode()
