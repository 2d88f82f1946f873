"""Where the frames of an AVI file lie, as its index says.

FFmpeg looks for the next frame where one is damaged, and counts on as if none had been lost; by the
index, frames keep their numbers. Microsoft, "AVI RIFF File Reference": idx1.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

ENTRY = np.dtype([("kind", "S4"), ("flags", "<u4"), ("start", "<u4"), ("size", "<u4")])
HEADER = 8  # bytes of a chunk's kind and size
MAX_CHUNKS = 1000  # before the index


def avi_frames(path: Path, n_frames: int) -> NDArray[np.int64] | None:
    """Start and size (N, 2) of the first stream's frames; None where no index has all of them.

    So it is with files that are cut off, of several parts, or no AVI.
    """
    n_bytes = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        whole = int.from_bytes(head[4:8], "little") + HEADER
        if head[:4] != b"RIFF" or head[8:] != b"AVI " or whole + HEADER < n_bytes:
            return None
        movie, index = _find_index(file, n_bytes)
    if movie is None or index is None:
        return None
    entries = index[index["kind"] == b"00dc"]
    if len(entries) != n_frames or not n_frames or (entries["size"] == 0).any():
        return None
    starts, sizes = entries["start"].astype(np.int64), entries["size"].astype(np.int64)
    starts += HEADER + (movie if starts[0] < movie else 0)  # from the list's kind, or the file
    known = np.column_stack([starts, sizes])
    return known if (known.sum(axis=1) <= n_bytes).all() else None


def _find_index(file: BinaryIO, n_bytes: int) -> tuple[int | None, NDArray[np.void] | None]:
    """Where the list of frames is, and the index."""
    place, movie = 12, None
    for _ in range(MAX_CHUNKS):
        file.seek(place)
        kind, size = file.read(4), int.from_bytes(file.read(4), "little")
        if kind == b"LIST" and file.read(4) == b"movi":
            movie = place + HEADER
        if kind == b"idx1":
            data = file.read(min(size, n_bytes))
            return movie, np.frombuffer(data[: len(data) // ENTRY.itemsize * ENTRY.itemsize], ENTRY)
        place += HEADER + size + size % 2
        if place >= n_bytes:
            break
    return movie, None


def read_frames(path: Path, frames: NDArray[np.int64]) -> Iterator[NDArray[np.uint8]]:
    """The frames of an index, as they are in the file."""
    with path.open("rb") as file:
        for start, size in frames.tolist():
            file.seek(start)
            yield np.frombuffer(file.read(size), np.uint8)
