"""Tracks in the MOT Challenge's two forms: results, and ground truth. Frames count from 1."""

from pathlib import Path

import numpy as np

from droptrack.data.files import read_text, write_text
from droptrack.data.formats.table import Table, table_of
from droptrack.errors import DroptrackError


def write_mot(path: Path, table: Table) -> None:
    """Results: ``frame,id,left,top,width,height,score,-1,-1,-1``."""
    _write(path, table, "-1,-1,-1", table.rows.scores.tolist())


def write_mot_truth(path: Path, table: Table) -> None:
    """Ground truth: ``frame,id,left,top,width,height,counts,class,visible``.

    Rows with score 0 do not count, as droplets that the image's edge cuts. The one class is 1, and
    visible is what is seen of the outline, 1 where that was not measured.
    """
    rows = table.rows
    seen = table.column("outline_seen")
    visible = np.ones(len(rows)) if seen is None else np.where(np.isfinite(seen), seen, 1)
    ends = [f"1,{one:.6g}" for one in visible.tolist()]
    _write(path, table, ends, [int(score > 0) for score in rows.scores.tolist()])


def _write(path: Path, table: Table, ends: str | list[str], scores: list[float]) -> None:
    rows = table.rows
    corners = rows.boxes[:, :2] - rows.boxes[:, 2:] / 2
    values = np.column_stack([corners, rows.boxes[:, 2:]]).tolist()
    lines = []
    for i, (left, top, width, height) in enumerate(values):
        end = ends if isinstance(ends, str) else ends[i]
        box = f"{left:.6f},{top:.6f},{width:.6f},{height:.6f}"
        lines.append(f"{rows.frame[i] + 1},{rows.track_id[i]},{box},{scores[i]:.6g},{end}\n")
    write_text(path, "".join(lines))


def read_mot(path: Path) -> Table:
    """Either form; detections without an identity (-1) are refused."""
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    parts = [line.split(",") for line in lines]
    try:
        table = np.array([[float(part) for part in line[:7]] for line in parts], float)
        table = table.reshape(-1, 7)
    except ValueError as error:
        raise DroptrackError(
            f"{path}: rows should be frame,id,left,top,width,height,score: {error}"
        ) from None
    if (table[:, 1] < 0).any():
        raise DroptrackError(
            f"{path}: has detections without identities; droptrack track --detections tracks them"
        )
    boxes = np.column_stack([table[:, 2:4] + table[:, 4:6] / 2, table[:, 4:6]])
    shift = min(0.0, table[:, 1].min(initial=1) - 1)  # our identities begin at 1
    return table_of(
        path,
        frame=table[:, 0] - 1,
        track_id=table[:, 1] - shift,
        boxes=boxes,
        scores=table[:, 6],
        notes=["left out: classes and what is visible"] if _says_more(parts) else [],
    )


def _says_more(rows: list[list[str]]) -> bool:
    """Whether the columns after the score say anything: -1 is nothing, and 1 the one class."""
    return any(part.strip() not in {"", "-1", "1"} for row in rows for part in row[7:])
