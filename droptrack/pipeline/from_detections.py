"""A file of detections -> tracks -> trajectories: no video, no network."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from itertools import islice
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections, labels
from droptrack.data.files import reading
from droptrack.data.mot_files import (
    BLOCK,
    DetectionFile,
    FrameList,
    open_detections,
    read_frame_list,
)
from droptrack.data.report import Value
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.errors import DroptrackError
from droptrack.pipeline.config import DetectionsConfig
from droptrack.pipeline.notes import Say, say_what_is_unsure, to_stderr
from droptrack.pipeline.results import Results, columns_with, summarise, write_report
from droptrack.pipeline.results_folder import prepare_folder, whole_name
from droptrack.pipeline.run import TrackingRun
from droptrack.tracking.appearance import describe_sizes
from droptrack.tracking.choice import make_tracker
from droptrack.tracking.session import TrackingSession
from droptrack.tracking.tracker import Tracker
from droptrack.version import __version__

# rows (M,) of a file, from 0 -> unit descriptors (M, D)
DescriptorsOf = Callable[[NDArray[np.int64]], Floats]


def open_descriptors(path: Path, n: int) -> DescriptorsOf:
    """Unit descriptors of a file's detections, from an .npy file with a row for each of the n.

    The file stays where it is: rows are read when they are asked for.
    """
    with reading(path, ".npy"):
        table = np.load(path, mmap_mode="r")
    if table.ndim != 2 or len(table) != n or not np.issubdtype(table.dtype, np.number):
        raise DroptrackError(f"{path}: should be {n} rows of numbers, not {table.shape}")
    for start in range(0, n, BLOCK):
        length = np.linalg.norm(np.asarray(table[start : start + BLOCK], np.float64), axis=1)
        bad = np.flatnonzero(~np.isfinite(length) | (length == 0))
        if len(bad):
            raise DroptrackError(f"{path}: row {start + int(bad[0]) + 1} has no direction")

    def descriptors_of(rows: NDArray[np.int64]) -> Floats:
        some = np.asarray(table[rows], np.float64)
        return np.asarray(some / np.linalg.norm(some, axis=1, keepdims=True))

    return descriptors_of


def track_detections(
    frames: Iterable[tuple[Detections, NDArray[np.int64]]],
    descriptors_of: DescriptorsOf | None,
    tracker: Tracker,
    results: Results,
    frames_that_exist: FrameList | None = None,
    *,
    first: int = 0,
) -> Generator[int]:
    """Track frame by frame into `results`; yields the number of frames done.

    `frames`: detections and their rows, as `mot_files.DetectionFile` gives them, from the frame
    `first` on, which counts from 0. `descriptors_of` gives the unit descriptors of rows; without,
    they are the detections' sizes. In frames that do not exist, no droplet is missed.
    """
    session = TrackingSession(tracker)
    try:
        for index, (found, rows) in enumerate(frames, first):
            exists = None if frames_that_exist is None else index + 1 in frames_that_exist
            if descriptors_of is None:
                descriptors = describe_sizes(found.boxes)
            else:
                descriptors = descriptors_of(rows)
            results.write(session.add_boxes(index, found, descriptors, image=exists))
            results.n_frames += 1
            results.last_frame = index
            results.n_detections += len(found)
            yield results.n_frames
    finally:
        results.finish(session)


def _all_frames(
    frames: DetectionFile, there: FrameList | None
) -> Iterator[tuple[Detections, NDArray[np.int64]]]:
    """The frames of a file, and after them those that exist besides."""
    yield from frames
    for _ in range(0 if there is None else there.last - frames.n_frames):
        yield labels(np.zeros((0, 4))), np.zeros(0, np.int64)


def _above(
    frames: Iterable[tuple[Detections, NDArray[np.int64]]], score: float | None
) -> Iterator[tuple[Detections, NDArray[np.int64]]]:
    """Frames without the detections below a score."""
    for found, rows in frames:
        keep = found.scores >= (-np.inf if score is None else score)
        yield found[keep], rows[keep]


def run_detections(config: DetectionsConfig, say: Say = to_stderr) -> TrackingRun:
    """Track the detections of a file into a folder.

    `say` is told what is odd about the file. Raises DroptrackError where it cannot be used.
    """
    tracker, tracker_settings = make_tracker(
        config.tracker, by_descriptors=config.descriptors is not None
    )
    there = None if config.frames is None else read_frame_list(config.frames)
    frames = open_detections(config.detections, there)
    descriptors_of = None
    if config.descriptors is not None:
        descriptors_of = open_descriptors(config.descriptors, frames.n_rows)
    if frames.out_of_order:
        say(
            f"{config.detections}: row {frames.out_of_order} belongs before the one above it: rows "
            "are sorted by frame first"
        )
    folder = config.folder
    prepare_folder(folder, str(config.detections), overwrite=config.overwrite)
    about: dict[str, Value] = {
        "made by": f"droptrack {__version__}, droptrack.track",
        "detections": f"{whole_name(str(config.detections))}, {frames.n_frames} frames",
        "units": "px, y points down; frames count from 0, one less than in the detections",
        **config.units.about(),
    }
    began = time.perf_counter()
    with TrajectoryWriter(folder / "trajectories.csv", about, columns_with(config.units)) as rows:
        results = Results(rows, units=config.units)
        wanted = islice(_above(_all_frames(frames, there), config.score), config.max_frames or None)
        first = frames.first_frame - 1
        done = track_detections(wanted, descriptors_of, tracker, results, there, first=first)
        with closing(done):
            for _ in done:
                pass
    n_missing = 0 if there is None else int((~there.exists[1:]).sum())
    seconds = time.perf_counter() - began
    settings = {**about, "score": config.score, **tracker_settings}
    size = (max(1, ceil(frames.right)), max(1, ceil(frames.bottom)))
    report = summarise(results, settings, size, n_missing, seconds)
    write_report(folder, report, results.paths, size)
    say_what_is_unsure(str(config.detections), results, say)
    return TrackingRun(folder, report)
