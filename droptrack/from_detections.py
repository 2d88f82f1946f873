"""A file of detections -> tracks -> trajectories: no video, no network."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import typer
from numpy.typing import NDArray

from droptrack import DroptrackError, __version__
from droptrack.appearance import describe_sizes
from droptrack.detections import Detections, xyxy_from_boxes
from droptrack.mot_files import read_detections
from droptrack.pipeline import FURTHER_COLUMNS, Results, finish
from droptrack.recorder import Recorder
from droptrack.report import Value
from droptrack.tracks import Tracker
from droptrack.trajectories import TrajectoryWriter

Floats = NDArray[np.float64]


def read_descriptors(path: Path, frames: Sequence[NDArray[np.int64]]) -> list[Floats]:
    """Unit descriptors (M, D) of each frame, from an .npy file with one row for each detection.

    `frames`: the rows of each frame, as `mot_files.read_detections` gives them.
    """
    try:
        table = np.load(path)
    except FileNotFoundError:
        raise DroptrackError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise DroptrackError(f"{path}: cannot be read as .npy: {error}") from None
    n = sum(len(rows) for rows in frames)
    if table.ndim != 2 or len(table) != n or not np.issubdtype(table.dtype, np.number):
        raise DroptrackError(f"{path}: should be {n} rows of numbers, not {table.shape}")
    table = np.asarray(table, np.float64)
    length = np.linalg.norm(table, axis=1, keepdims=True)
    if not np.isfinite(length).all() or (length == 0).any():
        row = int(np.flatnonzero(~np.isfinite(length[:, 0]) | (length[:, 0] == 0))[0])
        raise DroptrackError(f"{path}: row {row + 1} has no direction")
    return [(table / length)[rows] for rows in frames]


def follow_detections(
    frames: Sequence[Detections], looks: Sequence[Floats] | None, tracker: Tracker, results: Results
) -> Iterator[int]:
    """Track frame by frame into `results`; yields the number of frames done.

    `looks`: unit descriptors (M, D) of each frame's detections; without, their sizes.
    """
    recorder = Recorder(tracker.max_age)
    try:
        for index, found in enumerate(frames):
            look = describe_sizes(found.boxes) if looks is None else looks[index]
            update = tracker.update(found.boxes, look)
            recorder.add(index, found, found.boxes[:, :2], np.zeros(len(found), bool), update)
            results.n_frames += 1
            results.n_detections += len(found)
            results.take(recorder.take_final(index - tracker.delay))
            yield results.n_frames
    finally:
        too_short = results.n_frames < tracker.n_init
        results.take_rest(recorder.take_rest(unconfirmed=too_short))


def track_detections(
    detections: Path,
    descriptors: Path | None,
    tracker: Tracker,
    settings: dict[str, Value],
    out: Path | None,
) -> None:
    """Track a file of detections into a folder, by default tracks/<the file's name>."""
    frames, order = read_detections(detections)
    looks = None if descriptors is None else read_descriptors(descriptors, order)
    out = out or Path("tracks") / detections.stem
    out.mkdir(parents=True, exist_ok=True)
    corners = [xyxy_from_boxes(found.boxes)[:, 2:] for found in frames if len(found)]
    size = np.ceil(np.concatenate([np.ones((1, 2)), *corners]).max(axis=0)).astype(int)
    width, height = int(size[0]), int(size[1])
    about: dict[str, Value] = {
        "made by": f"droptrack {__version__}, droptrack.track",
        "detections": f"{detections}, {len(frames)} frames",
        "units": "px, y points down; frames count from 0, one less than in the detections",
    }
    began = time.perf_counter()
    with TrajectoryWriter(out / "trajectories.csv", about, FURTHER_COLUMNS) as rows:
        results = Results(rows)
        for _ in follow_detections(frames, looks, tracker, results):
            pass
    finish(out, (width, height), {**about, **settings}, results, 0, time.perf_counter() - began)
    typer.echo(f"results in {out}")
