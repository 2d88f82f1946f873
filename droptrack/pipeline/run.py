"""One run: a video in; trajectories, annotated video, plot and report out."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import islice
from pathlib import Path

from droptrack.data.field_stop import FieldStop, find_field_stop
from droptrack.data.formats.contours import check_contours
from droptrack.data.formats.tables import read_csv
from droptrack.data.levels import EIGHT_BITS
from droptrack.data.report import Report, Value
from droptrack.data.samples import N_SAMPLES, sample_frames
from droptrack.data.sources.opencv_names import printable
from droptrack.data.stage_times import StageTimes
from droptrack.data.trajectories import Trajectories, TrajectoryWriter, read_trajectories
from droptrack.data.units import Units
from droptrack.data.video import Video, VideoWriter, mpeg4_info
from droptrack.detection.engine_choice import Engines
from droptrack.errors import DroptrackError, InterruptedRunError, UnwritableError
from droptrack.interrupts import whole
from droptrack.measurement.shapes import COLUMNS as SHAPE
from droptrack.measurement.shapes import DEFINITION
from droptrack.network.darknet_cfg import cfg_text
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.classes import CLASS_ID, CLASS_NAME, Classes, ClassVotes, classes_of
from droptrack.pipeline.config import TrackingConfig
from droptrack.pipeline.contours import contour_log
from droptrack.pipeline.detection_log import DetectionLog, size_of
from droptrack.pipeline.doubts import doubts, mixed_outlines
from droptrack.pipeline.drawing import Annotator
from droptrack.pipeline.loop import track_frames
from droptrack.pipeline.notes import Say, say_what_is_missing, say_what_is_unsure, to_stderr
from droptrack.pipeline.open_detector import OpenedDetector, open_detector
from droptrack.pipeline.report_events import parsed, write_events
from droptrack.pipeline.results import Results, columns_with, summarise, write_report
from droptrack.pipeline.results_folder import prepare_folder, whole_name
from droptrack.pipeline.threads import AnnotatedVideo
from droptrack.progress import progress_bar
from droptrack.tracking.appearance import DescriptorExtractor
from droptrack.tracking.choice import choose_descriptor, make_tracker
from droptrack.tracking.tracker import Tracker
from droptrack.version import __version__

OF_DETECTIONS = (
    *("backend", "network_size", "scale", "score", "max_iou", "dark", "network_sees"),
    "grey_levels",
)
Progress = bool | Callable[[int, int], object]
MAX_RATE_ERROR = 0.001  # frames a second, of the annotated video, that need not be said


@dataclass(frozen=True)
class TrackingRun:
    """What a run left: its folder, its report, and what ended it too early, if anything did.

    The folder holds ``trajectories.csv``, ``tracked.mp4``, ``paths.png`` and ``report.json``, and
    ``events``, what `report_events.write_events` writes.
    """

    folder: Path
    report: Report
    problem: DroptrackError | None = None
    events: Report | None = None  # where they were asked for

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
    classes: Classes | None
    stop: FieldStop | None  # where no region is given

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames, px."""
        return self.source.info.width, self.source.info.height

    def n_frames(self, max_frames: int) -> int:
        """Frames that are to come, as far as the container knows; 0 where nobody does."""
        known = [n for n in (self.source.info.n_frames, max_frames) if n]
        return min(known, default=0)

    def rates(self, config: TrackingConfig) -> dict[str, Value]:
        """Frames a second and micrometres a pixel, None where neither user nor file says it."""
        own = self.source.info.fps if self.source.says_fps and not self.live else None
        fps = own if config.units.fps is None else config.units.fps
        return {"fps": fps, "um_per_px": self.units(config).um_per_px}

    def units(self, config: TrackingConfig) -> Units:
        """What the user says a pixel and a frame are; by default what the file says of them."""
        units = config.units
        if units.um_per_px is None and self.pixel_of_file(config):
            units = replace(units, um_per_px=self.source.pixel_size_um)
        if units.fps is None and units.um_per_px is not None and self.source.says_fps:
            return replace(units, fps=self.source.info.fps)
        return units

    def pixel_of_file(self, config: TrackingConfig) -> float:
        """The size of a pixel, um, that the file says and nobody else; 0 where it is not used."""
        given = config.units.um_per_px is not None or config.pixels_only
        return 0.0 if given else self.source.pixel_size_um


def run(
    config: TrackingConfig,
    say: Say = to_stderr,
    *,
    progress: Progress = True,
    engines: Engines | None = None,
) -> TrackingRun:
    """Track the droplets of a video into a folder.

    `say` is told which engine is used, and what went wrong on the way. `progress`: whether to show
    it, or who is told the frames done and those there are, 0 where nobody knows. `engines`: those
    of earlier videos, see `Engines`. Whatever ends the run, what was tracked until then is kept.
    Raises DroptrackError where it cannot begin.
    """
    opened = _open(config, say, engines)
    folder = _make_folder(config)
    for note in opened.source.notes:
        say(printable(note))
    if pixel := opened.pixel_of_file(config):
        say(
            f"{printable(config.video)}: a pixel is {pixel:.4g} um wide, as the file says; another "
            "width: --um-per-px, none: --pixels-only"
        )
    about = _about(config, opened)
    network, size = opened.network.cfg, opened.size
    say(
        f"{printable(config.video)}: {network.path.stem}, {network.width} x {network.height} px, "
        f"on {opened.network.detector.engine.name}"
    )
    began = time.perf_counter()
    results, problem = _track(config, opened, folder, about, say, progress=progress)
    n_missing = opened.source.n_lost
    if not (opened.live or opened.source.live):
        n_missing = _n_missing(config, opened.source, results, problem)
    settings = {**about, **_settings(config, opened)}
    seconds = time.perf_counter() - began
    odd = doubts(results.paths.each(), results.n_frames, network, opened.network.scale)
    odd += mixed_outlines(results.n_sizes, results.n_rings)
    odd += [opened.source.doubt] * bool(opened.source.doubt)
    report = summarise(results, settings, size, n_missing, seconds, odd)
    with whole():
        write_report(folder, report, results.paths, size)
    if problem is not None:
        number = getattr(problem, "errno", None)
        problem = type(problem)(f"{problem}; what was tracked until there is in {folder}")
        if isinstance(problem, UnwritableError):
            problem.errno = number
    else:
        _say_what_is_odd(config, opened.source, results, n_missing, say)
        for doubt in odd:
            say(f"{printable(config.video)}: {doubt}")
    events = None
    if config.events is not None and problem is None:
        table = read_csv(folder / "trajectories.csv")
        events = write_events(folder / "events", table, config.events, overwrite=True)
    return TrackingRun(folder, report, problem, events)


def _open(config: TrackingConfig, say: Say, engines: Engines | None) -> _Opened:
    """Everything that can refuse to work, before anything is written."""
    check_contours(config.contours, shape=config.shape)
    tracker, tracker_settings = make_tracker(config.tracker)
    describe = choose_descriptor(config.tracker)
    source = Video(config.video, config.reading)
    live = source.live if config.live is None else config.live
    size = (source.info.width, source.info.height)
    if config.events is not None:
        parsed(config.events, size)
    samples = cache(partial(sample_frames, source, N_SAMPLES))
    network = open_detector(config, size, samples, live=live, say=say, engines=engines)
    stop = find_field_stop(samples()) if network.region is None and config.shape else None
    if stop is not None:
        say(
            f"{printable(config.video)}: {stop}: droplets that it cuts are at_edge; --region says "
            "what else is to be seen"
        )
    return _Opened(
        source=source,
        live=live,
        network=network,
        tracker=tracker,
        tracker_settings=tracker_settings,
        describe=describe,
        classes=classes_of(network.cfg, config.names, config.cells),
        stop=stop,
    )


def _make_folder(config: TrackingConfig) -> Path:
    folder = config.folder
    if Path(config.video).resolve() == (folder / "tracked.mp4").resolve():
        raise DroptrackError(
            f"{config.video}: would be overwritten by the results; choose another --out"
        )
    prepare_folder(folder, config.video, overwrite=config.overwrite, resume=config.resume)
    return folder


def _about(config: TrackingConfig, opened: _Opened) -> dict[str, Value]:
    """What made the results, for the first lines of their table."""
    source, info = opened.source, opened.source.info
    further: dict[str, Value] = {}
    if source.pixel_size_um:
        further["pixel size"] = f"{source.pixel_size_um:g} um"
    if source.levels is not EIGHT_BITS:
        further["grey levels"] = str(source.levels)
    rate = f", {info.fps:g} frames/s" if source.says_fps else ""
    return {
        "made by": f"droptrack {__version__}, droptrack.track",
        "video": f"{whole_name(config.video)}, {info.width} x {info.height} px{rate}",
        **further,
        "network": f"{opened.network.cfg.path}, {opened.network.weights}",
        "weights sha256": sha256_of(opened.network.weights),
        "units": "px, pixel c covers [c, c + 1), y points down; frames count from 0",
        **({"sizes": DEFINITION} if config.shape else {}),
        **opened.units(config).about(),
    }


def _settings(config: TrackingConfig, opened: _Opened) -> dict[str, Value]:
    """How the results were made, for the report."""
    return {
        "backend": opened.network.detector.engine.name,
        "network_size": [opened.network.cfg.width, opened.network.cfg.height],
        **opened.network.settings,
        "live": opened.live,
        "grey_levels": str(opened.source.levels),
        "score": config.score,
        "max_iou": config.max_iou,
        "dark": config.dark,
        "region": config.region or "",
        **opened.rates(config),
        "field_stop": str(opened.stop or ""),
        **(opened.classes.settings() if opened.classes else {}),
        **opened.tracker_settings,
    }


def _track(
    config: TrackingConfig,
    opened: _Opened,
    folder: Path,
    about: Mapping[str, Value],
    say: Say,
    *,
    progress: Progress,
) -> tuple[Results, DroptrackError | None]:
    """Track frame by frame into the folder's files; also tells what ended it too early."""
    problem: DroptrackError | None = None
    times = StageTimes()
    units = opened.units(config)
    further = SHAPE * config.shape + (CLASS_ID, CLASS_NAME) * (opened.classes is not None)
    with (
        _detection_log(config, opened, folder, say) as log,
        TrajectoryWriter(folder / "trajectories.csv", about, columns_with(units, further)) as rows,
        contour_log(config.contours, folder, about, opened.classes, opened.size) as contours,
    ):
        video: AnnotatedVideo | None = None
        if config.annotated_video:
            try:
                video = _annotated_video(folder, opened, times, units, say)
            except DroptrackError as error:  # the analysis does not depend on it
                problem = error
        votes = None if opened.classes is None else ClassVotes(opened.classes)
        results = Results(rows, video, times, units, votes, contours)
        done = track_frames(
            islice(opened.source.numbered(), config.max_frames or None),
            opened.network.detector,
            opened.tracker,
            opened.describe,
            results,
            batch=config.batch,
            live=opened.live,
            log=log,
            shape=config.shape,
            region=opened.stop.region if opened.stop else opened.network.region,
        )
        try:
            with closing(done):  # it writes what it holds, also if the end comes in between
                _show_progress(done, opened.n_frames(config.max_frames), progress)
        except KeyboardInterrupt:
            problem = InterruptedRunError(f"interrupted after {results.n_frames} frames")
        except DroptrackError as error:
            problem = problem or error
        if problem is None and opened.source.live and not _stopped_as_asked(config, results):
            problem = DroptrackError(
                f"{printable(config.video)}: ended after {results.n_frames} frames, though nobody "
                "asked for it"
            )
        try:
            if video is not None:
                video.close()
        except DroptrackError as error:
            problem = problem or error
        if problem is None and log is not None:
            log.remove()
    return results, problem


@contextmanager
def _detection_log(
    config: TrackingConfig, opened: _Opened, folder: Path, say: Say
) -> Iterator[DetectionLog | None]:
    """What a later run can resume this one from; None of a live source, which has no past."""
    if opened.live or opened.source.live:
        if config.resume:
            raise DroptrackError(f"{printable(config.video)}: is live: it cannot be resumed")
        yield None
        return
    made = {
        "video": whole_name(config.video),
        "bytes": size_of(Path(config.video)),
        "weights sha256": sha256_of(opened.network.weights),
        "cfg": cfg_text(opened.network.cfg),
        "batch": config.batch,
        "max_frames": config.max_frames if config.batch > 1 else 0,  # cuts the last batch
        "renumber": config.reading.renumber,
        "channel": config.reading.channel,
        **{key: value for key, value in _settings(config, opened).items() if key in OF_DETECTIONS},
    }
    with DetectionLog(folder, made, resume=config.resume) as log:
        if log.n_frames:
            say(f"{printable(config.video)}: resumed after {log.n_frames} frames")
        yield log


def _stopped_as_asked(config: TrackingConfig, results: Results) -> bool:
    """Whether a run has done as many frames as it was to do."""
    return results.n_frames == config.max_frames > 0


def _annotated_video(
    folder: Path, opened: _Opened, times: StageTimes, units: Units, say: Say
) -> AnnotatedVideo:
    """A video for annotated frames, smaller or with another rate where MPEG-4 wants it."""
    info = opened.source.info
    held, smaller = mpeg4_info(info)
    path = folder / "tracked.mp4"
    if smaller > 1:
        say(f"{path}: is {held.width} x {held.height} px, as MPEG-4 has no larger images")
    if abs(held.fps - info.fps) > MAX_RATE_ERROR:
        say(f"{path}: plays {held.fps:g} frames/s, as MPEG-4 cannot hold {info.fps:g}")
    shrink = (held.width, held.height) != (info.width, info.height)
    annotator = Annotator(units, opened.classes.names if opened.classes else ())
    return AnnotatedVideo(VideoWriter(path, held, "mp4v"), times, annotator, shrink=shrink)


def _show_progress(done: Iterator[int], total: int, shown: Progress) -> None:
    """Go through the numbers of frames done, with a progress bar."""
    began = time.perf_counter()
    if callable(shown):
        for n in done:
            shown(n, total)
        return
    with progress_bar("frames", shown=shown) as bar:
        task = bar.add_task("tracking", total=total or None, note="")
        for n in done:
            rate = n / (time.perf_counter() - began)
            bar.update(task, completed=n, note=f"{rate:.1f} frames/s")


def _n_missing(
    config: TrackingConfig, source: Video, results: Results, problem: DroptrackError | None
) -> int:
    """Frames that could not be decoded, or are missing in a numbered sequence."""
    stopped = problem is not None or _stopped_as_asked(config, results)
    ends_known = source.counted and not stopped
    n_all = max(results.last_frame + 1, source.info.n_frames if ends_known else 0)
    return n_all - results.n_frames


def _say_what_is_odd(
    config: TrackingConfig, source: Video, results: Results, n_missing: int, say: Say
) -> None:
    """Tell what a user might not expect of the results."""
    name = printable(config.video)
    say_what_is_missing(name, source, n_missing, say)
    say_what_is_unsure(config.video, results, say)
    if results.n_frames and not results.n_detections:
        shade, cure = ("brighter", "leave out") if config.dark else ("darker", "add")
        say(
            f"{name}: no droplets found; if they are {shade} than what is around them, {cure} "
            "--dark; --diameter says how large they are, --weights footage knows other droplets"
        )
    if results.n_dropped:
        say(f"{name}: {results.n_dropped} frames dropped, newer ones were there")
