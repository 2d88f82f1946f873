"""Detections as text, in the format of the MOT Challenge.

One row a box: ``frame,-1,left,top,width,height,score``, frames from 1, more columns are ignored.
Files may be larger than the memory: they are read block by block, twice, once to check every row
before anything is tracked, once to track. Rows that are not in the order of their frames are sorted
in a temporary file as large as they are, by merging blocks (Knuth, vol. 3, section 5.4).
"""

import heapq
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import IO

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import Detections, labels
from droptrack.data.files import read_text, reading, write_text
from droptrack.errors import DroptrackError

N_COLUMNS = 7
FORMAT = "frame,-1,left,top,width,height,score"
MAX_FRAMES = 10_000_000
BLOCK = 20_000  # rows that are read, and sorted, at once
MERGE_BLOCK = 500  # rows of each sorted block that are held while blocks are merged


def write_detections(path: Path, frames: Sequence[Detections]) -> None:
    """Write the detections of each frame."""
    rows = [
        f"{number},-1," + ",".join(f"{v:.6f}" for v in (*(box[:2] - box[2:] / 2), *box[2:], score))
        for number, frame in enumerate(frames, 1)
        for box, score in zip(frame.boxes, frame.scores, strict=True)
    ]
    write_text(path, "".join(row + "\n" for row in rows))


@dataclass(frozen=True)
class FrameList:
    """Which frames exist, as a file says: `exists[number]`, numbers from 1, for F - 1 of them."""

    path: Path
    exists: Bools  # (F,)

    def __contains__(self, number: int) -> bool:
        return number < len(self.exists) and bool(self.exists[number])

    @property
    def last(self) -> int:
        """The last frame that exists."""
        return len(self.exists) - 1


def read_frame_list(path: Path) -> FrameList:
    """Read the numbers of frames that exist, from 1, with blanks or lines between.

    A range is written ``12-80``. Raises DroptrackError naming what is neither.
    """
    words = read_text(path).split()
    ranges = []
    for word in words:
        ends = word.split("-")
        whole = len(ends) <= 2 and all(end.isdecimal() and end.isascii() for end in ends)
        first, last = (int(ends[0]), int(ends[-1])) if whole else (0, 0)
        if not 1 <= first <= last <= MAX_FRAMES:
            raise DroptrackError(
                f"{path}: should be numbers of frames from 1 to {MAX_FRAMES}, or ranges such as "
                f"12-80, not {word[:40]}"
            )
        ranges.append((first, last))
    if not ranges:
        raise DroptrackError(f"{path}: lists no frame")
    exists = np.zeros(max(last for _, last in ranges) + 1, bool)
    for first, last in ranges:
        exists[first : last + 1] = True
    return FrameList(path, exists)


@dataclass(frozen=True, kw_only=True)
class DetectionFile:
    """A file all of whose rows are detections; iterate over it for the frames, one by one.

    Each frame from `first_frame` on, also one without detections, gives its `Detections` and the
    rows (M,) of the file, from 0, that they come from, in the file's order. `right` and `bottom`,
    in px: where the last box ends, 0 without any. `out_of_order`: the first row, from 1, of a frame
    before that of the row above it, and 0 where there is none.
    """

    path: Path
    first_frame: int  # from 1, as in the file; 1 without any
    n_frames: int
    n_rows: int
    right: float
    bottom: float
    out_of_order: int

    def __iter__(self) -> Iterator[tuple[Detections, Rows]]:
        if not self.out_of_order:
            yield from _frames(_parts(_blocks(self.path)), self.first_frame)
            return
        try:
            with tempfile.TemporaryFile() as file:
                runs = _sorted_blocks(self.path, file)
                parts = heapq.merge(*map(_parts, runs), key=_frame_of)
                yield from _frames(parts, self.first_frame)
        except OSError as error:
            raise DroptrackError(
                f"{self.path}: rows are not in the order of their frames, and sorting them in "
                f"{tempfile.gettempdir()} fails: {error.strerror}"
            ) from None


def open_detections(path: Path, frames_that_exist: FrameList | None = None) -> DetectionFile:
    """Check all rows of a file, which takes no memory.

    Raises DroptrackError naming the frame and the row, from 1, of what cannot be a box, or is in a
    frame that does not exist.
    """
    if path.exists() and not path.is_file():
        raise DroptrackError(f"{path}: should be a file, which can be read twice")
    n_rows = last = n_frames = out_of_order = 0
    first_frame = MAX_FRAMES
    corner = np.zeros(2)
    for table in _blocks(path):
        frames = np.append(last, table[:, 0])
        back = np.flatnonzero(np.diff(frames) < 0)
        if len(back) and not out_of_order:
            out_of_order = n_rows + int(back[0]) + 1
        if frames_that_exist is not None:
            _check_frames(path, table, n_rows, frames_that_exist)
        n_rows, last = n_rows + len(table), int(frames[-1])
        n_frames = max(n_frames, int(frames.max()))
        first_frame = min(first_frame, int(table[:, 0].min()))
        corner = np.maximum(corner, (table[:, 2:4] + table[:, 4:6]).max(axis=0))
    return DetectionFile(
        path=path,
        first_frame=first_frame if n_rows else 1,
        n_frames=n_frames,
        n_rows=n_rows,
        right=float(corner[0]),
        bottom=float(corner[1]),
        out_of_order=out_of_order,
    )


def _blocks(path: Path) -> Iterator[Floats]:
    """Rows (B, 7) of a file, block by block, checked; its number, from 0, is each row's second."""
    n_rows, delimiter = 0, None
    with reading(path), path.open(encoding="utf-8-sig") as file:
        rows = (line for line in file if line.strip())
        while lines := list(islice(rows, BLOCK)):
            if n_rows == 0:
                delimiter = "," if "," in lines[0] else None
            table = _numbers(path, lines, n_rows, delimiter)
            _check(path, table, n_rows)
            table[:, 1] = np.arange(n_rows, n_rows + len(table))
            n_rows += len(table)
            yield table


def _numbers(path: Path, lines: list[str], n_before: int, delimiter: str | None) -> Floats:
    def parse(some: list[str]) -> Floats:
        return np.loadtxt(
            some, delimiter=delimiter, ndmin=2, comments=None, usecols=range(N_COLUMNS)
        )

    try:
        return parse(lines)
    except ValueError:
        for number, line in enumerate(lines, n_before + 1):
            try:
                parse([line])
            except ValueError:
                raise DroptrackError(
                    f"{path}: row {number} should be the numbers {FORMAT}, not {line.strip()[:80]}"
                ) from None
        raise


def _check(path: Path, table: Floats, n_before: int) -> None:
    """Refuse rows (B, 7) that cannot be boxes; `n_before` rows come before them."""
    number, size = table[:, 0], table[:, 4:6]
    for problem, bad in (
        ("a frame should be a whole number from 1", ~(np.isfinite(number) & (number >= 1))),
        ("a frame should be a whole number from 1", number != np.round(number)),
        (f"a frame should be {MAX_FRAMES} or less", number > MAX_FRAMES),
        ("boxes and scores should be finite", ~np.isfinite(table[:, 2:]).all(axis=1)),
        ("boxes need a width and height above 0", ~(size > 0).all(axis=1)),
    ):
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise DroptrackError(
                f"{path}: frame {number[row]:g}, row {n_before + row + 1}: {problem}: "
                f"{table[row, 2:]}"
            )


def _check_frames(path: Path, table: Floats, n_before: int, frames: FrameList) -> None:
    """Refuse rows (B, 7) in frames that do not exist; `n_before` rows come before them."""
    numbers = table[:, 0].astype(np.int64)
    there = frames.exists[np.minimum(numbers, frames.last)] & (numbers <= frames.last)
    if not there.all():
        row = int(np.flatnonzero(~there)[0])
        raise DroptrackError(
            f"{path}: frame {numbers[row]}, row {n_before + row + 1}: has a box, but {frames.path} "
            "does not list the frame"
        )


def _sorted_blocks(path: Path, file: IO[bytes]) -> list[Iterator[Floats]]:
    """Write blocks, each sorted by frame, to a file; returns what reads each of them."""
    ends = [0]
    for table in _blocks(path):
        file.write(table[np.argsort(table[:, 0], kind="stable")].tobytes())
        ends.append(ends[-1] + len(table))

    def read(start: int, end: int) -> Iterator[Floats]:
        row_bytes = 8 * N_COLUMNS
        for row in range(start, end, MERGE_BLOCK):
            file.seek(row * row_bytes)
            some = file.read(min(MERGE_BLOCK, end - row) * row_bytes)
            yield np.frombuffer(some).reshape(-1, N_COLUMNS)

    return [read(start, end) for start, end in pairwise(ends)]


def _parts(blocks: Iterable[Floats]) -> Iterator[Floats]:
    """Sorted rows (B, 7), block by block -> rows of one frame, a frame in one part or more."""
    for table in blocks:
        yield from np.split(table, np.flatnonzero(np.diff(table[:, 0])) + 1)


def _frame_of(part: Floats) -> int:
    return int(part[0, 0])


def _frames(parts: Iterable[Floats], first: int) -> Iterator[tuple[Detections, Rows]]:
    """Rows of one frame after the other -> every frame from the first on."""
    done = first - 1
    for number, same in groupby(parts, _frame_of):
        for _ in range(done + 1, number):
            yield labels(np.zeros((0, 4))), np.zeros(0, np.int64)
        table, done = np.concatenate(list(same)), number
        size = table[:, 4:6]
        boxes = np.hstack([table[:, 2:4] + size / 2, size])
        found = Detections(boxes, table[:, 6].copy(), np.zeros(len(table), np.int64))
        yield found, table[:, 1].astype(np.int64)
