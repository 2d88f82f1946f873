"""Video -> detections -> tracks -> centres of mass -> trajectories, frame by frame.

Stages overlap: while one frame is tracked, networks run on the next ones, those after them are
decoded, and those before are drawn and written. Order is kept, and what waits is bounded.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.data.report import Report, Value
from droptrack.data.stage_times import StageTimes
from droptrack.data.trajectories import BOX_CENTRE, TrajectoryWriter
from droptrack.detection.detector import Detector
from droptrack.measurement.centre_of_mass import centres_of_mass, load_loops
from droptrack.pipeline.paths import Paths
from droptrack.pipeline.threads import AnnotatedVideo, FrameReader, NumberedFrame, side_by_side
from droptrack.tracking.appearance import Describe
from droptrack.tracking.recorder import Recorded, Recorder
from droptrack.tracking.smoothing import COLUMNS as SMOOTHED
from droptrack.tracking.smoothing import Smoother
from droptrack.tracking.tracker import Tracker

FURTHER_COLUMNS = (*BOX_CENTRE, "centre_of_mass", *SMOOTHED)
AT_ONCE = 10  # frames; one by one they take half as long again


@dataclass
class Results:
    """The files that tracking writes, filled frame by frame, and what is counted meanwhile."""

    rows: TrajectoryWriter
    video: AnnotatedVideo | None = None
    times: StageTimes = field(default_factory=StageTimes)
    n_frames: int = 0
    n_dropped: int = 0  # frames of a live source that came while others were at work
    n_measured: int = 0  # detections whose centre of mass could be measured
    n_detections: int = 0
    slowest: float = 0.0  # seconds from decoding a frame to the end of its tracking
    paths: Paths = field(default_factory=Paths)
    _late: deque[tuple[int, Frame]] = field(default_factory=deque)
    _smoother: Smoother = field(default_factory=Smoother)

    def take_final(self, recorder: Recorder) -> None:
        """Write rows that are final, those of some frames together, once they are smoothed."""
        if self.n_frames % AT_ONCE == 0:
            with self.times.measure("write"):
                self._write(self._smoother.add(recorder.take_final()))

    def take_rest(self, recorder: Recorder, *, unconfirmed: bool) -> None:
        """Write all that is left, see `Recorder.take_rest`."""
        with self.times.measure("write"):
            self._write(self._smoother.add(recorder.take_rest(unconfirmed=unconfirmed)))
            self._write(self._smoother.rest())

    def _write(self, smoothed: Iterable[tuple[Recorded, NDArray[np.float64]]]) -> None:
        for recorded, columns in smoothed:
            rows = recorded.rows
            extra = (rows.boxes[:, 0], rows.boxes[:, 1], recorded.measured, *columns.T)
            self.rows.write(rows, extra)
            self.paths.add(rows)

    def show(self, index: int, frame: Frame, recorder: Recorder, delay: int) -> None:
        """Write the annotated frame from `delay` frames ago: by now new tracks are confirmed."""
        if self.video is None:
            return
        self._late.append((index, frame))
        if len(self._late) > delay:
            self._show_next(recorder)

    def show_rest(self, recorder: Recorder) -> None:
        """Write the annotated frames that are left."""
        while self._late:
            self._show_next(recorder)

    def _show_next(self, recorder: Recorder) -> None:
        assert self.video is not None
        index, frame = self._late.popleft()
        self.video.write(index, frame, list(recorder.rows_of(index)))


class Follower:
    """Tracks the detections of one frame after the other into `results`.

    Where a number is left out, the droplets moved on in a frame that could not be decoded; in a
    live source the next frame that is looked at comes next.
    """

    def __init__(
        self, tracker: Tracker, describe: Describe, results: Results, *, live: bool = False
    ) -> None:
        self._tracker, self._describe, self._results = tracker, describe, results
        self._recorder = Recorder(tracker.delay + tracker.max_age)
        load_loops()  # now, not while the first frame waits
        self._live = live
        self._next: int | None = None

    def add(self, item: NumberedFrame, detections: Detections) -> None:
        """Take the next frame's detections."""
        results, tracker = self._results, self._tracker
        index, frame, decoded = item
        lost = range(index if self._live or self._next is None else self._next, index)
        self._next = index + 1
        with results.times.measure("track"):
            for number in lost:
                self._track(number, frame, detections[:0])
            results.n_measured += self._track(index, frame, detections)
        results.n_frames += 1
        results.n_detections += len(detections)
        results.slowest = max(results.slowest, perf_counter() - decoded)
        results.show(index, frame, self._recorder, tracker.delay)
        results.take_final(self._recorder)

    def _track(self, index: int, frame: Frame, detections: Detections) -> int:
        """Track and record; returns for how many droplets a centre of mass was measured."""
        update = self._tracker.update(detections.boxes, self._describe(frame, detections.boxes))
        centres, measured = centres_of_mass(frame, detections.boxes)
        self._recorder.add(index, detections, centres, measured, update)
        return int(measured.sum())

    def finish(self) -> None:
        """Write what was held back."""
        self._results.show_rest(self._recorder)
        too_short = self._results.n_frames < self._tracker.n_init  # for any to be confirmed
        self._results.take_rest(self._recorder, unconfirmed=too_short)


def follow(
    frames: Iterable[tuple[int, Frame]],
    detector: Detector,
    tracker: Tracker,
    describe: Describe,
    results: Results,
    *,
    batch: int = 1,
    live: bool = False,
) -> Iterator[int]:
    """Detect and track numbered frames into `results`; yields the number of frames done.

    `live`: no frame waits for others. When one is done, the newest goes next, and those that came
    in between are dropped, so that a frame is never older than two take. Otherwise every frame is
    tracked, `batch` at once through the network.
    """
    follower = Follower(tracker, describe, results, live=live)
    running: deque[tuple[list[NumberedFrame], Callable[[], list[Detections]]]] = deque()
    engine = detector.engine
    most = 0 if live else 2 * engine.parallel  # so that the network waits for nobody

    def finish_oldest() -> int:
        items, detections_of = running.popleft()
        try:
            found = detections_of()
        except BaseException:
            running.clear()  # nothing goes on from here
            raise
        for item, detections in zip(items, found, strict=True):
            follower.add(item, detections)
        return results.n_frames

    try:
        with (
            side_by_side(engine.opencv_threads),
            FrameReader(frames, results.times, newest=live) as reader,
        ):
            source = iter(reader)
            while items := list(islice(source, 1 if live else batch)):
                pictures = [item.frame for item in items]
                running.append((items, detector.start(pictures, results.times)))
                results.n_dropped = reader.n_dropped
                if len(running) > most:
                    yield finish_oldest()
            while running:
                yield finish_oldest()
    except BaseException:
        while running:
            finish_oldest()
        raise
    finally:
        follower.finish()


def summarise(
    results: Results, settings: dict[str, Value], n_missing: int, seconds: float
) -> Report:
    """One row a droplet: when and how far it went.

    `n_missing` frames could not be decoded; `seconds` are those of the whole.
    """
    droplets = results.paths.table()
    summary: dict[str, Value] = {
        "n_frames": results.n_frames,
        "n_droplets": len(droplets),
        "n_detections": results.n_detections,
        "n_centres_of_mass_measured": results.n_measured,
        "n_frames_missing": n_missing,
        "n_frames_dropped": results.n_dropped,
        "slowest_frame_s": results.slowest,
        "seconds": seconds,
        "frames_per_second": results.n_frames / seconds,
        **results.times.milliseconds_a_frame(results.n_frames),
    }
    return Report("Droplets", settings, summary, droplets)


def finish(
    out: Path,
    size: tuple[int, int],
    settings: dict[str, Value],
    results: Results,
    n_missing: int,
    seconds: float,
) -> None:
    """Write the plot, of a picture of `size` px, and the report, and print the table."""
    from droptrack.pipeline.plots import plot_paths

    report = summarise(results, settings, n_missing, seconds)
    report.write_json(out / "report.json")
    report.print()
    plot_paths(out / "paths.png", results.paths.lines(), *size)
