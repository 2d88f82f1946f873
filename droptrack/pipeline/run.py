"""One run: a video in; trajectories, annotated video, plot and report out."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

from droptrack.data.report import Report, Value
from droptrack.data.stage_times import StageTimes
from droptrack.data.trajectories import Trajectories, TrajectoryWriter, read_trajectories
from droptrack.data.video import Video, VideoWriter
from droptrack.errors import DroptrackError
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.config import TrackingConfig
from droptrack.pipeline.loop import track_frames
from droptrack.pipeline.notes import Say, say_what_is_unsure, to_stderr
from droptrack.pipeline.open_detector import OpenedDetector, open_detector
from droptrack.pipeline.results import FURTHER_COLUMNS, Results, summarise, write_report
from droptrack.pipeline.threads import AnnotatedVideo
from droptrack.progress import progress_bar
from droptrack.tracking.appearance import DescriptorExtractor
from droptrack.tracking.choice import choose_descriptor, make_tracker
from droptrack.tracking.tracker import Tracker
from droptrack.version import __version__


@dataclass(frozen=True)
class TrackingRun:
    """What a run left: its folder, its report, and what ended it too early, if anything did.

    The folder holds ``trajectories.csv``, ``tracked.mp4``, ``paths.png`` and ``report.json``.
    """

    folder: Path
    report: Report
    problem: DroptrackError | None = None

    @cached_property
    def trajectories(self) -> Trajectories:
        """The rows of ``trajectories.csv``, read when they are first asked for."""
        return read_trajectories(self.folder / "trajectories.csv")[0]


@dataclass(frozen=True, kw_only=True)
class _Opened:
    """What a run reads, and what it computes with."""

    source: Video
    live: bool
    network: OpenedDetector
    tracker: Tracker
    tracker_settings: dict[str, Value]
    describe: DescriptorExtractor

    def n_frames(self, max_frames: int) -> int:
        """Frames that are to come, as far as the container knows; 0 where nobody does."""
        known = [n for n in (self.source.info.n_frames, max_frames) if n]
        return min(known, default=0)


def run(config: TrackingConfig, say: Say = to_stderr, *, progress: bool = True) -> TrackingRun:
    """Track the droplets of a video into a folder.

    `say` is told which engine is used, and what went wrong on the way. Whatever ends the run, what
    was tracked until then is kept. Raises DroptrackError where it cannot begin.
    """
    opened = _open(config, say)
    folder = _make_folder(config)
    about = _about(config, opened)
    info, network = opened.source.info, opened.network.cfg
    say(
        f"{config.video}: {network.path.stem}, {network.width} x {network.height} px, on "
        f"{opened.network.detector.engine.name}"
    )
    began = time.perf_counter()
    results, problem = _track(config, opened, folder, about, progress=progress)
    total = opened.n_frames(config.max_frames)
    n_missing = 0 if opened.live or problem else max(0, total - results.n_frames)
    settings = {**about, **_settings(config, opened)}
    size = (info.width, info.height)
    report = summarise(results, settings, size, n_missing, time.perf_counter() - began)
    write_report(folder, report, results.paths, size)
    if problem is not None:
        problem = DroptrackError(f"{problem}; what was tracked until there is in {folder}")
    else:
        _say_what_is_odd(config, results, n_missing, total, say)
    return TrackingRun(folder, report, problem)


def _open(config: TrackingConfig, say: Say) -> _Opened:
    """Everything that can refuse to work, before anything is written."""
    tracker, tracker_settings = make_tracker(config.tracker)
    describe = choose_descriptor(config.tracker)
    source = Video(config.video)
    live = source.live if config.live is None else config.live
    frames = source.info
    network = open_detector(config, frames.width, frames.height, live=live, say=say)
    return _Opened(
        source=source,
        live=live,
        network=network,
        tracker=tracker,
        tracker_settings=tracker_settings,
        describe=describe,
    )


def _make_folder(config: TrackingConfig) -> Path:
    folder = config.folder
    if Path(config.video).resolve() == (folder / "tracked.mp4").resolve():
        raise DroptrackError(
            f"{config.video}: would be overwritten by the results; choose another --out"
        )
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _about(config: TrackingConfig, opened: _Opened) -> dict[str, Value]:
    """What made the results, for the first lines of their table."""
    info = opened.source.info
    return {
        "made by": f"droptrack {__version__}, droptrack.track",
        "video": f"{config.video}, {info.width} x {info.height} px, {info.fps:g} frames/s",
        "network": f"{opened.network.cfg.path}, {opened.network.weights}",
        "weights sha256": sha256_of(opened.network.weights),
        "units": "px, pixel c covers [c, c + 1), y points down; frames count from 0",
    }


def _settings(config: TrackingConfig, opened: _Opened) -> dict[str, Value]:
    """How the results were made, for the report."""
    return {
        "backend": opened.network.detector.engine.name,
        "network_size": [opened.network.cfg.width, opened.network.cfg.height],
        "scale": opened.network.scale,
        "live": opened.live,
        "score": config.score,
        "max_iou": config.max_iou,
        "dark": config.dark,
        **opened.tracker_settings,
    }


def _track(
    config: TrackingConfig,
    opened: _Opened,
    folder: Path,
    about: Mapping[str, Value],
    *,
    progress: bool,
) -> tuple[Results, DroptrackError | None]:
    """Track frame by frame into the folder's files; also tells what ended it too early."""
    problem: DroptrackError | None = None
    times = StageTimes()
    with TrajectoryWriter(folder / "trajectories.csv", about, FURTHER_COLUMNS) as rows:
        video: AnnotatedVideo | None = None
        if config.annotated_video:
            writer = VideoWriter(folder / "tracked.mp4", opened.source.info, "mp4v")
            video = AnnotatedVideo(writer, times)
        results = Results(rows, video, times)
        done = track_frames(
            islice(opened.source.numbered(), config.max_frames or None),
            opened.network.detector,
            opened.tracker,
            opened.describe,
            results,
            batch=config.batch,
            live=opened.live,
        )
        try:
            _show_progress(done, opened.n_frames(config.max_frames), shown=progress)
        except KeyboardInterrupt:
            problem = DroptrackError(f"interrupted after {results.n_frames} frames")
        except DroptrackError as error:
            problem = error
        try:
            if video is not None:
                video.close()
        except DroptrackError as error:
            problem = problem or error
    return results, problem


def _show_progress(done: Iterator[int], total: int, *, shown: bool) -> None:
    """Go through the numbers of frames done, with a progress bar."""
    began = time.perf_counter()
    with progress_bar("frames", shown=shown) as bar:
        task = bar.add_task("tracking", total=total or None, note="")
        for n in done:
            rate = n / (time.perf_counter() - began)
            bar.update(task, completed=n, note=f"{rate:.1f} frames/s")


def _say_what_is_odd(
    config: TrackingConfig, results: Results, n_missing: int, total: int, say: Say
) -> None:
    """Tell what a user might not expect of the results."""
    if n_missing:
        say(
            f"{config.video}: {n_missing} of the {total} frames it claims could not be decoded: it "
            "is damaged, or ends early"
        )
    say_what_is_unsure(config.video, results, say)
    if results.n_frames and not results.n_detections:
        shade, cure = ("brighter", "leave out") if config.dark else ("darker", "add")
        say(
            f"{config.video}: no droplets found; if they are {shade} than what is around them, "
            f"{cure} --dark"
        )
    if results.n_dropped:
        say(f"{config.video}: {results.n_dropped} frames dropped, newer ones were there")
