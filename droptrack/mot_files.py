"""Detections as text, in the format of the MOT Challenge.

One row a box: ``frame,-1,left,top,width,height,score``, frames from 1, more columns are ignored.
"""

import io
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack import DroptrackError
from droptrack.detections import Detections, labels

N_COLUMNS = 7
MOST_FRAMES = 10_000_000


def write_detections(path: Path, frames: Sequence[Detections]) -> None:
    """Write the detections of each frame."""
    rows = [
        f"{number},-1," + ",".join(f"{v:.6f}" for v in (*(box[:2] - box[2:] / 2), *box[2:], score))
        for number, frame in enumerate(frames, 1)
        for box, score in zip(frame.boxes, frame.scores, strict=True)
    ]
    path.write_text("".join(row + "\n" for row in rows), encoding="utf-8")


def read_detections(path: Path) -> tuple[list[Detections], list[NDArray[np.int64]]]:
    """Read the detections of each frame, frames without any included.

    Also returns the rows of the file, from 0, that each frame's detections come from. Raises
    DroptrackError naming the frame and the row, from 1, of what cannot be a box.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise DroptrackError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DroptrackError(f"{path}: cannot be read as text: {error}") from None
    text = "\n".join(lines)
    if not text.strip():
        return [], []
    delimiter = "," if "," in text else None
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=delimiter, ndmin=2, comments=None)
    except ValueError as error:
        raise DroptrackError(f"{path}: {error}") from None
    if table.shape[1] < N_COLUMNS:
        raise DroptrackError(
            f"{path}: rows should be frame,-1,left,top,width,height,score, "
            f"not {table.shape[1]} numbers"
        )
    number, score, size = table[:, 0], table[:, 6], table[:, 4:6]
    boxes = np.hstack([table[:, 2:4] + size / 2, size])
    for problem, bad in (
        ("a frame should be a whole number from 1", ~(np.isfinite(number) & (number >= 1))),
        ("a frame should be a whole number from 1", number != np.round(number)),
        (f"a frame should be {MOST_FRAMES} or less", number > MOST_FRAMES),
        ("boxes and scores should be finite", ~np.isfinite(np.c_[boxes, score]).all(axis=1)),
        ("boxes need a width and height above 0", ~(size > 0).all(axis=1)),
    ):
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise DroptrackError(
                f"{path}: frame {number[row]:g}, row {row + 1}: {problem}: {table[row, 2:7]}"
            )
    frames = number.astype(np.int64)
    order = np.argsort(frames, kind="stable")
    starts = np.searchsorted(frames[order], np.arange(1, frames.max() + 2))
    rows = [order[a:b] for a, b in pairwise(starts)]
    none = labels(np.zeros((0, 4)))
    return [
        Detections(boxes[r], score[r], np.zeros(len(r), np.int64)) if len(r) else none for r in rows
    ], rows
