"""The folder of a run's results: its name, and that no other results in it are lost."""

import os
import re
from itertools import islice
from pathlib import Path

from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError
from droptrack.pipeline.detection_log import NAME as DETECTION_LOG

SOURCES = ("# video: ", "# detections: ")  # lines of a table that say what it was made from
MAX_ABOUT = 100  # lines before a table
RESULTS = ("trajectories.csv", "report.json", "tracked.mp4")
SUFFIX = re.compile(r"(\.ome)?\.[A-Za-z][A-Za-z0-9]{0,5}$")  # .5mm is none


def results_name(source: str) -> str:
    """A name for results: that of the file without its suffix, of the folder, or of the stream.

    >>> results_name("runs/exp_1.5mm.avi"), results_name("exp_1.5mm"), results_name("0")
    ('exp_1.5mm', 'exp_1.5mm', '0')
    """
    if "://" in source and not Path(source).exists():
        return re.sub(r"[^\w.-]+", "_", source.partition("://")[2]).strip("_.") or "stream"
    path = Path(os.path.abspath(source))  # noqa: PTH100  of links, not of what they lead to
    name = path.name if path.is_dir() else SUFFIX.sub("", path.name)
    name = re.sub(r"[*?]+", "_", name).strip()
    return name if name.strip(".") else "video"


def whole_name(source: str) -> str:
    """A source's name that means the same from every folder, as the results keep it."""
    is_live = not Path(source).exists() and ("://" in source or source.isdecimal())
    return printable(source if is_live else os.path.abspath(source))  # noqa: PTH100


def prepare_folder(folder: Path, source: str, *, overwrite: bool, resume: bool = False) -> None:
    """Make the folder for the results of a source.

    Raises DroptrackError where it has results already. Those of the same source may be overwritten
    where that is wanted, and those of a run that was ended resumed; those of another one never.
    """
    resumable = resume and (folder / DETECTION_LOG).exists()  # which says what it is of
    if not resumable and any(has_content(folder / name) for name in RESULTS):
        before = _made_from(folder / RESULTS[0])
        if not before.startswith(f"{whole_name(source)}, "):
            of = f" of {before}" if before else ""
            raise DroptrackError(
                f"{folder}: would be overwritten; it has results{of}; choose another --out"
            )
        if resume and not overwrite:
            raise DroptrackError(f"{folder}: its results are complete: nothing is to be resumed")
        if not overwrite:
            goes_on = "--resume goes on with them, " if (folder / DETECTION_LOG).exists() else ""
            raise DroptrackError(
                f"{folder}: has results of {printable(source)} already; {goes_on}--overwrite "
                "replaces them, --out puts the new ones elsewhere"
            )
    folder.mkdir(parents=True, exist_ok=True)


def has_content(path: Path) -> bool:
    """Whether a file is there and not empty."""
    return path.is_file() and path.stat().st_size > 0


def _made_from(table: Path) -> str:
    """What a table of results says that it was made from; empty where it says nothing."""
    try:
        with table.open(encoding="utf-8", errors="replace") as file:
            for line in islice(file, MAX_ABOUT):
                for start in SOURCES:
                    if line.startswith(start):
                        return line.removeprefix(start).strip()
    except OSError:
        pass
    return ""
