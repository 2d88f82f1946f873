"""The detections of each frame, kept while a run goes on, so that it can be resumed.

Whatever ends a run, what its network found is here; a resumed run takes it from here, tracks it
anew, and goes on with the frames that are missing: its rows are those of a run that never stopped.
A file has one line that says how detections were made, then one line a frame: its number, how many
boxes there are, and cx, cy, w, h, score, class of each, as exact as they are.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from droptrack.data.detections import Detections
from droptrack.data.report import Value
from droptrack.errors import DroptrackError, UnwritableError

NAME = "detections.part"
N_VALUES = 6  # of a box


class DetectionLog:
    """Detections by the frames' numbers: those of an earlier run, and those of this one.

    `made`: everything that detections depend on. Raises DroptrackError where the earlier run's were
    made in another way.
    """

    def __init__(self, folder: Path, made: Mapping[str, Value], *, resume: bool) -> None:
        self.path = folder / NAME
        self._places: dict[int, int] = {}  # of the lines of frames
        end = self._read(made) if resume and self.path.exists() else 0
        try:
            self._file: BinaryIO = self.path.open("r+b" if end else "w+b")
        except OSError as error:
            raise UnwritableError(
                f"{self.path}: cannot be written: {error.strerror}", error.errno
            ) from None
        try:
            if end:
                self._file.truncate(end)  # half a line, maybe
                self._file.seek(end)
            else:
                self._write(json.dumps(dict(made)))
        except DroptrackError:
            self.close()
            raise

    @property
    def n_frames(self) -> int:
        """Frames whose detections are known."""
        return len(self._places)

    def find(self, numbers: Sequence[int]) -> list[Detections] | None:
        """The detections of frames; None unless all of them are known."""
        if not all(number in self._places for number in numbers):
            return None
        found = []
        for number in numbers:
            self._file.seek(self._places[number])
            parsed = _parse(self._file.readline())
            assert parsed is not None
            found.append(parsed[1])
        self._file.seek(0, 2)
        return found

    def add(self, number: int, found: Detections) -> None:
        """Keep the detections of a frame, unless they are known."""
        if number in self._places:
            return
        rows = np.column_stack([found.boxes, found.scores, found.class_ids]).ravel().tolist()
        self._places[number] = self._file.tell()
        line = " ".join([str(number), str(len(found)), *map(repr, rows)])
        self._write(line)

    def _write(self, line: str) -> None:
        """Append a line, at once."""
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise UnwritableError(
                f"{self.path}: cannot be written: {error.strerror}", error.errno
            ) from None

    def close(self) -> None:
        """Close it, and keep it."""
        with suppress(OSError):  # said when it came
            self._file.close()

    def remove(self) -> None:
        """Delete it, since the run is complete."""
        self._file.close()
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self, made: Mapping[str, Value]) -> int:
        """Find the lines of an earlier run; returns where the last whole one ends."""
        with self.path.open("rb") as file:
            head = file.readline()
            if not head.endswith(b"\n"):
                return 0
            try:
                before = json.loads(head)
            except ValueError:
                before = {}
            other = [key for key, value in made.items() if before.get(key) != value]
            if other:
                raise DroptrackError(
                    f"{self.path}: cannot be resumed: {other[0]} was {before.get(other[0])}, and "
                    f"is {made[other[0]]} now; --overwrite begins anew"
                )
            end = file.tell()
            while (line := file.readline()) and (parsed := _parse(line)) is not None:
                self._places[parsed[0]] = end
                end = file.tell()
        return end


def _parse(line: bytes) -> tuple[int, Detections] | None:
    """A frame's number and detections; None of a line that is not whole."""
    if not line.endswith(b"\n"):
        return None
    try:
        number, n, *values = line.split()
        table = np.array(values, np.float64).reshape(int(n), N_VALUES)
        boxes, scores, class_ids = table[:, :4], table[:, 4], table[:, 5].astype(np.int64)
        return int(number), Detections(boxes, scores, class_ids)
    except ValueError:
        return None


def size_of(path: Path) -> int:
    """Bytes of a file, or the number of entries of a folder; 0 of what is neither."""
    if path.is_dir():
        return len(list(path.iterdir()))
    return path.stat().st_size if path.exists() else 0
