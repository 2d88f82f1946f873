"""Video -> detections -> tracks -> centres of mass -> trajectories, frame by frame.

Stages overlap: while one frame is tracked, networks run on the next ones, those after them are
decoded, and those before are drawn and written. Order is kept, and what waits is bounded.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from time import perf_counter

from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.detection.detector import Detector
from droptrack.measurement.centre_of_mass import centres_of_mass, load_loops
from droptrack.pipeline.results import Results
from droptrack.pipeline.threads import FrameReader, NumberedFrame, side_by_side
from droptrack.tracking.appearance import Describe
from droptrack.tracking.recorder import Recorder
from droptrack.tracking.tracker import Tracker


class FrameTracker:
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


def track_frames(
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
    frame_tracker = FrameTracker(tracker, describe, results, live=live)
    running: deque[tuple[list[NumberedFrame], Callable[[], list[Detections]]]] = deque()
    engine = detector.engine
    max_running = 0 if live else 2 * engine.parallel  # so that the network waits for nobody

    def finish_oldest() -> int:
        items, detections_of = running.popleft()
        try:
            found = detections_of()
        except BaseException:
            running.clear()  # nothing goes on from here
            raise
        for item, detections in zip(items, found, strict=True):
            frame_tracker.add(item, detections)
        return results.n_frames

    try:
        with (
            side_by_side(engine.opencv_threads),
            FrameReader(frames, results.times, newest=live) as reader,
        ):
            source = iter(reader)
            while items := list(islice(source, 1 if live else batch)):
                images = [item.frame for item in items]
                running.append((items, detector.start(images, results.times)))
                results.n_dropped = reader.n_dropped
                if len(running) > max_running:
                    yield finish_oldest()
            while running:
                yield finish_oldest()
    except BaseException:
        while running:
            finish_oldest()
        raise
    finally:
        frame_tracker.finish()
