"""A table of three droplets, and the command that converts it."""

from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.trajectories import (
    Trajectories,
    read_trajectories,
    sorted_trajectories,
)

ABOUT = {"video": "video.avi, 640 x 480 px, 25 frames/s", "um per px": "0.5"}


def three_droplets() -> Trajectories:
    """Tracks 1, 2 and 4: ten frames on a line, frames 2 to 6 with a bridged gap, and one frame."""
    rows = []
    for t in range(10):
        rows.append([t, 1, 100.25 + 5 * t, 50.5, 101 + 5 * t, 50.0, 20, 22, 0.9, 1, 19.5])
        if 2 <= t <= 6:
            rows.append([t, 2, 300.0, 60 + t * t, 300, 60 + t * t, 30, 30, 0.8, t != 4, np.nan])
    rows.append([9, 4, 10.0, 400, 10, 400, 12, 12, 0.7, 1, 11.5])
    table = np.array(rows, float)
    return sorted_trajectories(
        frame=table[:, 0].astype(np.int64),
        track_id=table[:, 1].astype(np.int64),
        x=table[:, 2],
        y=table[:, 3],
        boxes=table[:, 4:8],
        scores=table[:, 8],
        observed=table[:, 9].astype(bool),
        columns={"diameter_px": table[:, 10], "area_px2": np.pi / 4 * table[:, 10] ** 2},
    )


def convert(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["convert", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["convert", *map(str, arguments)])
    assert result.exit_code == 1
    assert result.output.count("\n") == 1, result.output
    return result.output


def back(path: Path, *options: object) -> tuple[Trajectories, dict[str, str]]:
    home = path.parent / "home.csv"
    convert(path, home, *options)
    return read_trajectories(home)


def with_columns(**columns: np.ndarray) -> Trajectories:
    rows = three_droplets()
    whole = (rows.frame, rows.track_id, rows.x, rows.y, rows.boxes, rows.scores, rows.observed)
    return sorted_trajectories(*whole, columns)
