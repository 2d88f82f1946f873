"""What is converted: rows, what is known of them, and what every format shares."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.trajectories import Trajectories, sorted_trajectories
from droptrack.data.units import Units, units_of
from droptrack.errors import DroptrackError

# programs in which whole numbers are the centres of pixels, not their corners
PIXEL_CENTRE = 0.5


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows, what a file said of them, and what was said while it was read: `notes`."""

    rows: Trajectories
    about: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def units(self) -> Units:
        """What a pixel and a frame are."""
        return units_of(self.about)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image, px: what is said of the video, else what boxes need."""
        if found := re.search(r"(\d+) x (\d+) px", self.about.get("video", "")):
            return int(found[1]), int(found[2])
        boxes = self.rows.boxes
        high = np.ceil((boxes[:, :2] + boxes[:, 2:] / 2).max(axis=0, initial=1)).astype(int)
        return int(high[0]), int(high[1])

    @property
    def n_frames(self) -> int:
        """Frames from 0 to the last with a row."""
        return int(self.rows.frame.max(initial=-1)) + 1

    def column(self, name: str) -> Floats | None:
        """A further column as numbers, or None."""
        found = self.rows.columns.get(name)
        return None if found is None else np.asarray(found, np.float64)

    def classes(self) -> tuple[Rows, dict[int, str]]:
        """The class of each row (M,), and the names of classes: of droplets without, 0, droplet.

        In bridged gaps the class that the droplet has most often.
        """
        ids, names = self.rows.columns.get("class_id"), self.rows.columns.get("class_name")
        if ids is None:
            return np.zeros(len(self.rows), np.int64), {0: "droplet"}
        whole = np.array(ids, np.int64)
        for _, some in tracks(self.rows):
            known = whole[some][whole[some] >= 0]
            most = np.bincount(known, minlength=1).argmax()
            whole[some] = np.where(whole[some] < 0, most, whole[some])
        found = {k: str(k) for k in np.unique(whole).tolist()}
        if names is not None:
            pairs = zip(np.asarray(ids, np.int64).tolist(), names.tolist(), strict=True)
            found |= {k: name for k, name in pairs if k >= 0}
        return whole, found

    def diameters(self) -> Floats:
        """Diameters (M,) px: measured where they were, else sqrt(w h) of the boxes."""
        of_boxes = np.sqrt(self.rows.boxes[:, 2] * self.rows.boxes[:, 3])
        measured = self.column("diameter_px")
        if measured is None:
            return np.asarray(of_boxes)
        return np.where(np.isfinite(measured), measured, of_boxes)


def described(table: Table, units: Units, size: str | None) -> Table:
    """A table with what its user says of it: units, and the image's size as WxH.

    Raises DroptrackError for a size that is none.
    """
    about = {**table.about, **units.about()}
    if size is not None:
        found = re.fullmatch(r"(\d+)x(\d+)", size)
        if not found or not int(found[1]) or not int(found[2]):
            raise DroptrackError(f"--size {size}: should be WxH, such as 1280x720")
        rate = re.search(r", [\d.]+ frames/s", about.get("video", ""))
        about["video"] = f"video, {found[1]} x {found[2]} px{rate[0] if rate else ''}"
    return Table(rows=table.rows, about=about, notes=table.notes)


def table_of(
    path: Path,
    *,
    frame: NDArray[Any],
    track_id: NDArray[Any],
    boxes: Floats,
    x: Floats | None = None,
    y: Floats | None = None,
    scores: Floats | None = None,
    observed: Bools | None = None,
    columns: Mapping[str, NDArray[Any]] | None = None,
    about: Mapping[str, str] | None = None,
    notes: Iterable[str] = (),
) -> Table:
    """A table from what a file had; positions are the boxes' (M, 4) centres where it had none.

    Raises DroptrackError naming the file for rows that cannot be trajectories.
    """
    m = len(frame)
    try:
        rows = sorted_trajectories(
            frame=whole_numbers(frame, "frames"),
            track_id=whole_numbers(track_id, "track ids"),
            x=boxes[:, 0] if x is None else x,
            y=boxes[:, 1] if y is None else y,
            boxes=boxes,
            scores=np.ones(m) if scores is None else scores,
            observed=np.ones(m, bool) if observed is None else observed,
            columns=columns or {},
        )
    except ValueError as error:
        raise DroptrackError(f"{path}: {error}") from None
    return Table(rows=rows, about=about or {}, notes=tuple(notes))


def whole_numbers(values: NDArray[Any], what: str) -> Rows:
    """Values (M,) as whole numbers; raises ValueError where they are none."""
    numbers = np.asarray(values, np.float64)
    if not np.isfinite(numbers).all() or (numbers != np.round(numbers)).any():
        raise ValueError(f"{what} should be whole numbers")
    return numbers.astype(np.int64)


def tracks(rows: Trajectories) -> list[tuple[int, Rows]]:
    """Each track's identity and its rows, in the order of their frames."""
    order = np.lexsort((rows.frame, rows.track_id))
    ids, starts = np.unique(rows.track_id[order], return_index=True)
    return list(zip(ids.tolist(), np.split(order, starts[1:]), strict=True)) if len(ids) else []
