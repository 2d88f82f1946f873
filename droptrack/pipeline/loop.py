"""Video -> detections -> tracks -> centres of mass -> trajectories, frame by frame.

Stages overlap: while one frame is tracked, networks run on the next ones, those after them are
decoded, and those before are drawn and written. Order is kept, and what waits is bounded.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from functools import partial
from itertools import islice
from time import perf_counter

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.data.region import Region
from droptrack.detection.detector import Finder
from droptrack.interrupts import whole
from droptrack.measurement.droplets import Measured, load_loops, measure_droplets
from droptrack.measurement.shapes import COLUMNS as SHAPE
from droptrack.pipeline.classes import CLASS_ID
from droptrack.pipeline.contours import PLACE
from droptrack.pipeline.detection_log import DetectionLog
from droptrack.pipeline.results import Results
from droptrack.pipeline.threads import FrameReader, NumberedFrame, side_by_side
from droptrack.tracking.appearance import DescriptorExtractor
from droptrack.tracking.session import Recordable, TrackingSession
from droptrack.tracking.tracker import Tracker


def _as_it_is(found: list[Detections]) -> list[Detections]:
    return found


class FrameTracker:
    """Tracks the detections of one frame after the other into `results`, see `TrackingSession`."""

    def __init__(
        self,
        tracker: Tracker,
        describe: DescriptorExtractor,
        results: Results,
        *,
        live: bool = False,
        shape: bool = False,
        region: Region | None = None,
    ) -> None:
        further = SHAPE * shape + (PLACE,) * (results.contours is not None)
        further += (CLASS_ID,) * (results.votes is not None)  # the last, see `Annotator`
        self._session = TrackingSession(tracker, live=live, further=further)
        self._shape, self._region = shape, region
        self._describe, self._results = describe, results
        load_loops()  # now, not while the first frame waits

    def add(self, item: NumberedFrame, detections: Detections) -> None:
        """Take the next frame's detections."""
        results, session = self._results, self._session
        index, frame, decoded = item
        with results.times.measure("track"):
            descriptors = self._describe(frame, detections.boxes)
            found = measure_droplets(
                frame, detections.boxes, shape=self._shape, region=self._region
            )
            final = session.add(
                index,
                detections,
                found.centres,
                found.measured,
                descriptors,
                Recordable(found.boxes, self._further(index, detections, found)),
            )
        results.n_frames += 1
        results.last_frame = index
        results.n_detections += len(detections)
        results.n_measured += int(found.measured.sum())
        results.n_sizes += int(np.isfinite(found.outlines[:, :1, 0]).sum())
        results.n_rings += int(found.rings.sum())
        results.slowest = max(results.slowest, perf_counter() - decoded)
        results.show(index, frame, session)
        results.write(final)

    def _further(self, index: int, detections: Detections, found: Measured) -> Floats:
        """What the rows of a frame say beside their boxes (N, F)."""
        columns = [found.shapes]
        if self._results.contours is not None:
            self._results.contours.keep(index, found.outlines)
            columns.append(np.arange(len(detections), dtype=float)[:, None])
        if self._results.votes is not None:
            columns.append(detections.class_ids[:, None].astype(float))
        return np.hstack(columns)

    def finish(self) -> None:
        """Write what was held back."""
        self._results.show_rest(self._session)
        self._results.finish(self._session)


def track_frames(
    frames: Iterable[tuple[int, Frame]],
    detector: Finder,
    tracker: Tracker,
    describe: DescriptorExtractor,
    results: Results,
    *,
    batch: int = 1,
    live: bool = False,
    log: DetectionLog | None = None,
    shape: bool = False,
    region: Region | None = None,
) -> Generator[int]:
    """Detect and track numbered frames into `results`; yields the number of frames done.

    `live`: no frame waits for others. When one is done, the newest goes next, and those that came
    in between are dropped, so that a frame is never older than two take. Otherwise every frame is
    tracked, `batch` at once through the network. `log` has the detections of an earlier run, and
    gets those of this one. `shape`: measure sizes and shapes, too; `region`: see
    `measure_droplets`.
    """
    frame_tracker = FrameTracker(tracker, describe, results, live=live, shape=shape, region=region)
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
            with whole():
                if log is not None:
                    log.add(item.number, detections)
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
                known = None if log is None else log.find([item.number for item in items])
                if known is None:
                    running.append((items, detector.start(images, results.times)))
                else:
                    running.append((items, partial(_as_it_is, known)))
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
        with whole():
            frame_tracker.finish()
