"""Trajectories: the one table of results and of truth, and its CSV file.

A file begins with ``# key: value`` lines that say what made it, then has the columns
``frame,track_id,x,y,w,h,score,observed`` and possibly more. Frames count from 0, tracks from 1.
"""

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from droptrack.data.files import read_text
from droptrack.errors import DroptrackError

COLUMNS = ("frame", "track_id", "x", "y", "w", "h", "score", "observed")
BOX_CENTRE = ("box_x", "box_y")  # further columns of ours


@dataclass(frozen=True)
class Trajectories:
    """M positions of droplets, sorted by (frame, track_id), pairs unique.

    frame, track_id (M,) int64; x, y (M,) float64, the centre of mass in px, where pixel c covers
    [c, c + 1); boxes (M, 4) float64 [cx, cy, w, h] px; scores (M,) float64; observed (M,) bool,
    false where a gap was bridged. In a truth, score 0 marks droplets that a tracker need not find,
    such as those cut off by the picture's edge (as in MOT Challenge). Raises ValueError for other
    shapes, values that are not finite, or a pair given twice.
    """

    frame: NDArray[np.int64]
    track_id: NDArray[np.int64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    boxes: NDArray[np.float64]
    scores: NDArray[np.float64]
    observed: NDArray[np.bool_]

    def __post_init__(self) -> None:
        m = len(self.frame)
        for field in fields(self):
            array = getattr(self, field.name)
            shape = (m, 4) if field.name == "boxes" else (m,)
            if array.shape != shape:
                raise ValueError(f"{field.name} should have shape {shape}, not {array.shape}")
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"{field.name} should be finite")
        step = np.diff(self.frame)
        if (step < 0).any() or (np.diff(self.track_id)[step == 0] <= 0).any():
            raise ValueError("rows should be sorted by (frame, track_id), each pair once")

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: NDArray[np.bool_] | slice) -> "Trajectories":
        return Trajectories(*(getattr(self, field.name)[rows] for field in fields(self)))


def joined_trajectories(parts: Sequence[Trajectories]) -> Trajectories:
    """Rows of later and later frames, one part after the other."""
    names = [field.name for field in fields(Trajectories)]
    return Trajectories(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in names)
    )


def sorted_trajectories(
    frame: NDArray[np.int64],
    track_id: NDArray[np.int64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    boxes: NDArray[np.float64],
    scores: NDArray[np.float64],
    observed: NDArray[np.bool_],
) -> Trajectories:
    """Trajectories from rows in any order."""
    order = np.lexsort((track_id, frame))
    return Trajectories(
        frame[order],
        track_id[order],
        x[order],
        y[order],
        boxes[order],
        scores[order],
        observed[order],
    )


class TrajectoryWriter:
    """Writes a trajectories file row by row, so that what was computed is kept whatever happens.

    `extra` names columns that follow the fixed ones.
    """

    def __init__(self, path: Path, about: Mapping[str, object], extra: Iterable[str] = ()) -> None:
        self.path = path
        self._extra = tuple(extra)
        try:
            self._file: TextIO = path.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise DroptrackError(f"{path}: cannot be written: {error.strerror}") from None
        for key, value in about.items():
            self._file.write(f"# {key}: {value}\n")
        self._file.write(",".join(COLUMNS + self._extra) + "\n")

    def write(self, rows: Trajectories, extra: Iterable[NDArray[Any]] = ()) -> None:
        """Append rows, with one array (M,) of numbers for each further column.

        Six decimals: a millionth of a pixel.
        """
        columns = [
            rows.frame,
            rows.track_id,
            rows.x,
            rows.y,
            *rows.boxes.T[2:],
            rows.scores,
            rows.observed,
            *extra,
        ]
        kinds = ["%.6f" if column.dtype.kind == "f" else "%d" for column in columns]
        line = ",".join(kinds) + "\n"
        values = zip(*(column.tolist() for column in columns), strict=True)
        self._file.writelines([line % row for row in values])
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> "TrajectoryWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def write_trajectories(path: Path, rows: Trajectories, about: Mapping[str, object]) -> None:
    """Write a whole trajectories file, box centres as further columns."""
    with TrajectoryWriter(path, about, BOX_CENTRE) as writer:
        writer.write(rows, (rows.boxes[:, 0], rows.boxes[:, 1]))


def read_trajectories(path: Path) -> tuple[Trajectories, dict[str, str]]:
    """Read a trajectories file: the rows, sorted, and what its ``#`` lines say.

    Without columns box_x and box_y, the box is taken to be centred at (x, y). Raises DroptrackError
    naming the line that is wrong.
    """
    lines = read_text(path).splitlines()
    about = {}
    start = 0
    for start, line in enumerate(lines):  # noqa: B007
        if not line.startswith("#"):
            break
        key, colon, value = line[1:].partition(":")
        if colon:
            about[key.strip()] = value.strip()
    header = tuple(lines[start].split(",")) if start < len(lines) else ()
    if header[: len(COLUMNS)] != COLUMNS:
        raise DroptrackError(f"{path}: should have the columns {','.join(COLUMNS)}")
    table = np.empty((0, len(header)))
    if lines[start + 1 :]:
        try:
            table = np.loadtxt(io.StringIO("\n".join(lines[start + 1 :])), delimiter=",", ndmin=2)
        except ValueError as error:
            raise DroptrackError(f"{path}: after line {start + 1}: {error}") from None
    if table.shape[1] != len(header):
        raise DroptrackError(f"{path}: rows should have {len(header)} columns as the first line")
    column = dict(zip(header, table.T, strict=True))
    centre = [column.get(name, column[name[-1]]) for name in BOX_CENTRE]
    try:
        rows = sorted_trajectories(
            column["frame"].astype(np.int64),
            column["track_id"].astype(np.int64),
            column["x"],
            column["y"],
            np.column_stack([*centre, column["w"], column["h"]]),
            column["score"],
            column["observed"].astype(bool),
        )
    except ValueError as error:
        raise DroptrackError(f"{path}: {error}") from None
    return rows, about
