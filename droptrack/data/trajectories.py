"""Trajectories: the one table of results and of ground truth, and its CSV file.

A file begins with ``# key: value`` lines that say what made it, then has the columns
``frame,track_id,x,y,w,h,score,observed`` and possibly more. Frames count from 0, tracks from 1.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from io import RawIOBase
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.files import reading
from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError, UnwritableError

if TYPE_CHECKING:
    import pandas

COLUMNS = ("frame", "track_id", "x", "y", "w", "h", "score", "observed")
BOX_CENTRE = ("box_x", "box_y")  # further columns of ours
MAX_WHOLE = 2**53  # above, whole numbers are not exact as fractions
TEXT, WHOLE = ("class_name",), ("class_id",)  # further columns of text, and of whole numbers


@dataclass(frozen=True, kw_only=True)
class Trajectories:
    """M positions of droplets, sorted by (frame, track_id), pairs unique.

    frame, track_id (M,) int64; x, y (M,) float64, the centre of mass in px, where pixel c covers
    [c, c + 1); boxes (M, 4) float64 [cx, cy, w, h] px; scores (M,) float64; observed (M,) bool,
    false where a gap was bridged; columns: further arrays (M,) by their names in the file. In
    ground truth, score 0 marks droplets that a tracker need not find, such as those cut off by the
    image's edge (as in MOT Challenge). Raises ValueError for other shapes, values that are not
    finite, or a pair given twice.

    >>> rows = Trajectories(
    ...     frame=np.array([0, 1]),
    ...     track_id=np.array([1, 1]),
    ...     x=np.array([4.5, 6.5]),
    ...     y=np.array([3.0, 3.0]),
    ...     boxes=np.array([[4.5, 3, 2, 2], [6.5, 3, 2, 2]]),
    ...     scores=np.ones(2),
    ...     observed=np.ones(2, bool),
    ... )
    >>> len(rows), rows[rows.frame == 1].x.tolist()
    (2, [6.5])
    """

    frame: Rows
    track_id: Rows
    x: Floats
    y: Floats
    boxes: Floats
    scores: Floats
    observed: Bools
    columns: Mapping[str, NDArray[Any]] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        m = len(self.frame)
        for name, array in (*self._arrays().items(), *self.columns.items()):
            shape = (m, 4) if name == "boxes" else (m,)
            if array.shape != shape:
                raise ValueError(f"{name} should have shape {shape}, not {array.shape}")
        for name, array in self._arrays().items():
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"{name} should be finite")
        step = np.diff(self.frame)
        if (step < 0).any() or (np.diff(self.track_id)[step == 0] <= 0).any():
            raise ValueError("rows should be sorted by (frame, track_id), each pair once")

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {name: getattr(self, name) for name in FIELDS}

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Bools | Rows | slice) -> "Trajectories":
        return Trajectories(
            **{name: array[rows] for name, array in self._arrays().items()},
            columns={name: array[rows] for name, array in self.columns.items()},
        )

    def to_pandas(self) -> "pandas.DataFrame":
        """A table with trackpy's columns ``frame, particle, x, y``, then all the others.

        `particle` is the track_id; ``box_x, box_y, w, h`` are the boxes. Needs pandas: raises
        DroptrackError where it is not installed.

        >>> table = Trajectories(
        ...     frame=np.array([0]),
        ...     track_id=np.array([7]),
        ...     x=np.array([4.5]),
        ...     y=np.array([3.0]),
        ...     boxes=np.array([[4.5, 3, 2, 2]]),
        ...     scores=np.ones(1),
        ...     observed=np.ones(1, bool),
        ... ).to_pandas()
        >>> table[["frame", "particle", "x", "y"]].values.tolist()
        [[0.0, 7.0, 4.5, 3.0]]
        """
        try:
            import pandas
        except ImportError:
            raise DroptrackError("tables need pandas: pip install 'droptrack[pandas]'") from None
        boxes = dict(zip((*BOX_CENTRE, "w", "h"), self.boxes.T, strict=True))
        fixed = {"frame": self.frame, "particle": self.track_id, "x": self.x, "y": self.y}
        rest = {"score": self.scores, "observed": self.observed}
        return pandas.DataFrame({**fixed, **boxes, **rest, **self.columns})


FIELDS = tuple(one.name for one in fields(Trajectories) if one.name != "columns")


def concatenate(parts: Sequence[Trajectories]) -> Trajectories:
    """Rows of later and later frames, one part after the other, which have the same columns."""
    names = parts[0].columns if parts else ()
    return Trajectories(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS},
        columns={name: np.concatenate([part.columns[name] for part in parts]) for name in names},
    )


def sorted_trajectories(
    frame: Rows,
    track_id: Rows,
    x: Floats,
    y: Floats,
    boxes: Floats,
    scores: Floats,
    observed: Bools,
    columns: Mapping[str, NDArray[Any]] = MappingProxyType({}),
) -> Trajectories:
    """Trajectories from rows in any order."""
    order = np.lexsort((track_id, frame))
    return Trajectories(
        frame=frame[order],
        track_id=track_id[order],
        x=x[order],
        y=y[order],
        boxes=boxes[order],
        scores=scores[order],
        observed=observed[order],
        columns={name: array[order] for name, array in columns.items()},
    )


class TrajectoryWriter:
    """Writes a trajectories file row by row, so that what was computed is kept whatever happens.

    `extra` names columns that follow the fixed ones. Raises DroptrackError where nothing can be
    written, as on a full disk; what was written until then stays, without half a row.
    """

    def __init__(self, path: Path, about: Mapping[str, object], extra: Iterable[str] = ()) -> None:
        self.path = path
        self._extra = tuple(extra)
        try:
            self._file: RawIOBase = path.open("wb", buffering=0)
        except OSError as error:
            raise DroptrackError(f"{path}: cannot be written: {error.strerror}") from None
        self._n_bytes = 0
        lines = [f"# {key}: {printable(str(value))}" for key, value in about.items()]
        try:
            self._append("".join(f"{line}\n" for line in (*lines, ",".join(COLUMNS + self._extra))))
        except DroptrackError:
            self._file.close()
            raise

    def write(self, rows: Trajectories, extra: Iterable[NDArray[Any]] = ()) -> None:
        """Append rows, with one array (M,) of numbers for each further column.

        Six decimals: a millionth of a pixel. Of columns of TEXT, arrays of text.
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
        line = ",".join(kind_of(column) for column in columns) + "\n"
        values = zip(*map(as_written, columns), strict=True)
        self._append("".join([line % row for row in values]))

    def _append(self, text: str) -> None:
        """Write whole lines, or none of them."""
        data = memoryview(text.encode())
        try:
            done = 0
            while done < len(data):
                done += self._file.write(data[done:]) or 0
        except OSError as error:
            with suppress(OSError):  # of what is no file
                self._file.truncate(self._n_bytes)
            raise UnwritableError(
                f"{self.path}: cannot be written: {error.strerror}", error.errno
            ) from None
        self._n_bytes += len(data)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> "TrajectoryWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def kind_of(column: NDArray[Any]) -> str:
    """How values of a column (M,) are written: six decimals, whole numbers, or text."""
    return {"f": "%.6f", "U": "%s"}.get(column.dtype.kind, "%d")


def as_written(column: NDArray[Any]) -> list[Any]:
    """The values of a column (M,) for `kind_of`; text in quotes where a CSV needs them."""
    values: list[Any] = column.tolist()
    if column.dtype.kind != "U":
        return values
    return [
        '"' + one.replace('"', '""') + '"' if {'"', ",", "\n", "#"} & set(one) else one
        for one in values
    ]


def write_trajectories(path: Path, rows: Trajectories, about: Mapping[str, object]) -> None:
    """Write a whole trajectories file: box centres, then the rows' further columns."""
    with TrajectoryWriter(path, about, (*BOX_CENTRE, *rows.columns)) as writer:
        writer.write(rows, (rows.boxes[:, 0], rows.boxes[:, 1], *rows.columns.values()))


def read_trajectories(path: Path) -> tuple[Trajectories, dict[str, str]]:
    """Read a trajectories file: the rows, sorted, and what its ``#`` lines say.

    Without columns box_x and box_y, the box is taken to be centred at (x, y). Columns are numbers
    but for those of TEXT. Raises DroptrackError naming the line that is wrong.
    """
    about, column = _read_table(path)
    _check(path, column)
    centre = [column.pop(name, column[name[-1]]) for name in BOX_CENTRE]
    try:
        rows = sorted_trajectories(
            frame=column["frame"].astype(np.int64),
            track_id=column["track_id"].astype(np.int64),
            x=column["x"],
            y=column["y"],
            boxes=np.column_stack([*centre, column["w"], column["h"]]),
            scores=column["score"],
            observed=column["observed"].astype(bool),
            columns={
                name: one.astype(np.int64) if name in WHOLE else one
                for name, one in column.items()
                if name not in COLUMNS
            },
        )
    except ValueError as error:
        raise DroptrackError(f"{path}: {error}") from None
    return rows, about


def _check(path: Path, column: Mapping[str, NDArray[Any]]) -> None:
    """Raise DroptrackError where numbers cannot be what their columns are."""
    sides = np.minimum(column["w"], column["h"])
    for problem, bad in (
        ("frame should be a whole number from 0", ~_whole(column["frame"], 0)),
        ("track_id should be a whole number", ~_whole(column["track_id"], -MAX_WHOLE)),
        ("observed should be 0 or 1", ~np.isin(column["observed"], (0, 1))),
        ("w and h should not be below 0", sides < 0),
    ):
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise DroptrackError(f"{path}: row {row + 1} after the columns' names: {problem}")


def _whole(values: NDArray[Any], lowest: int) -> Bools:
    """Which of the values (M,) are whole numbers from the lowest on, small enough to be exact."""
    return np.asarray((values >= lowest) & (values <= MAX_WHOLE) & (values == np.floor(values)))


def _read_table(path: Path) -> tuple[dict[str, str], dict[str, NDArray[Any]]]:
    """What ``#`` lines say, and the columns (M,) by their names.

    Line by line: a file may have millions of them.
    """
    about: dict[str, str] = {}
    with reading(path), path.open(encoding="utf-8-sig") as file:
        start = 1
        line = file.readline()
        while line.startswith("#"):
            key, colon, value = line[1:].partition(":")
            if colon:
                about[key.strip()] = value.strip()
            line, start = file.readline(), start + 1
        header = tuple(line.rstrip("\n").split(","))
        if header[: len(COLUMNS)] != COLUMNS:
            raise DroptrackError(f"{path}: should have the columns {','.join(COLUMNS)}")
        if len(set(header)) < len(header):
            raise DroptrackError(f"{path}: has two columns of one name")
        try:
            return about, _columns(path, header, file)
        except UnicodeDecodeError:
            raise
        except ValueError as error:
            raise DroptrackError(f"{path}: after line {start}: {error}") from None


def _columns(path: Path, header: tuple[str, ...], rows: Iterable[str]) -> dict[str, NDArray[Any]]:
    """The columns of a table by their names; raises ValueError where there are others."""
    kinds = ["U1" if name in TEXT else "f8" for name in header]
    lines = iter(rows)
    no_row = ("#",) if "U1" not in kinds else ()  # as np.loadtxt has it below
    first = next((one for one in lines if one.strip() and not one.strip().startswith(no_row)), "")
    if not first:
        return {name: np.zeros(0, kind) for name, kind in zip(header, kinds, strict=True)}
    lines = itertools.chain([first], lines)
    if "U1" not in kinds:
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
        if table.shape[1] != len(header):
            raise DroptrackError(
                f"{path}: rows should have {len(header)} columns as the first line"
            )
        return dict(zip(header, table.T, strict=True))
    every = list(lines)
    quoted: dict[str, Any] = {"delimiter": ",", "quotechar": '"', "comments": None, "ndmin": 1}
    for k in [k for k, kind in enumerate(kinds) if kind == "U1"]:
        kinds[k] = np.loadtxt(every, np.str_, usecols=k, **quoted).dtype.str  # as long as needed
    whole = np.loadtxt(every, list(zip(header, kinds, strict=True)), **quoted)
    return {name: np.ascontiguousarray(whole[name]) for name in header}
