"""Detections, frame by frame -> final rows of trajectories: a tracker and its recorder."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from droptrack.data.arrays import Bools, Floats
from droptrack.data.detections import Detections
from droptrack.tracking.recorder import NO_ROWS, Gap, Recorded, Recorder, Row
from droptrack.tracking.tracker import Tracker, Velocity


class Recordable(NamedTuple):
    """What rows say of M detections: their boxes (M, 4) px, and the further columns (M, F)."""

    boxes: Floats
    further: Floats


FRAMES_AT_ONCE = 10  # whose rows are given together; one by one they take half as long again


class TrackingSession:
    """Tracks the droplets of one video, or of one file of detections.

    A frame whose number is left out could not be decoded: the droplets moved on and were missed in
    it. In a `live` source such frames were only not looked at, and nothing was missed in them.
    `further` names the further columns of the rows.
    """

    def __init__(
        self, tracker: Tracker, *, live: bool = False, further: tuple[str, ...] = ()
    ) -> None:
        self.n_frames = 0
        self._tracker, self._live = tracker, live
        self._recorder = Recorder(tracker.delay + tracker.max_age, further)
        self._next: int | None = None

    @property
    def delay(self) -> int:
        """Frames after which the tracks in a frame are confirmed, merged or terminated."""
        return self._tracker.delay

    @property
    def gaps(self) -> list[Gap]:
        """Those of more than three frames that were bridged so far."""
        return self._recorder.gaps

    @property
    def possible_velocities(self) -> tuple[Velocity, ...]:
        """Two if the images do not tell which of them is right: see `Tracker`."""
        return self._tracker.possible_velocities

    def add(
        self,
        frame: int,
        detections: Detections,
        centres: Floats,
        measured: Bools,
        descriptors: Floats,
        recorded: Recordable | None = None,
        *,
        image: bool | None = None,
    ) -> Recorded:
        """Take the M detections of a frame; returns rows that the frames before it made final.

        `centres` (M, 2): of the droplets, px; `measured` (M,): which of them are centres of mass,
        not of boxes; `descriptors` (M, D) and `image`: see `Tracker`; `recorded`: what rows say,
        where that is more than what the tracker goes by. Rows come with every tenth frame, each
        once.
        """
        due = self.n_frames > 0 and self.n_frames % FRAMES_AT_ONCE == 0
        final = self._recorder.take_final() if due else NO_ROWS
        expected = frame if self._live or self._next is None else self._next
        for missed in range(expected, frame):
            none = (detections[:0], centres[:0], measured[:0], descriptors[:0])
            self._track(missed, *none, image=False)
        self._track(frame, detections, centres, measured, descriptors, recorded, image=image)
        self._next = frame + 1
        self.n_frames += 1
        return final

    def add_boxes(
        self,
        frame: int,
        detections: Detections,
        descriptors: Floats,
        *,
        image: bool | None = None,
    ) -> Recorded:
        """As `add`, where nothing but boxes is known: their centres are the droplets'."""
        measured = np.zeros(len(detections), bool)
        centres = detections.boxes[:, :2]
        return self.add(frame, detections, centres, measured, descriptors, image=image)

    def rows_of(self, frame: int) -> list[Row]:
        """The rows of a frame so far, see `Recorder`; call it before the next frame is added."""
        return self._recorder.rows_of(frame)

    def finish(self) -> Recorded:
        """The rows that are left; if there were too few frames to confirm any track, of all."""
        self._recorder.add_end(self._tracker.finish())
        return self._recorder.take_rest(unconfirmed=self.n_frames < self._tracker.n_init)

    def _track(
        self,
        frame: int,
        detections: Detections,
        centres: Floats,
        measured: Bools,
        descriptors: Floats,
        recorded: Recordable | None = None,
        *,
        image: bool | None,
    ) -> None:
        update = self._tracker.update(detections.boxes, descriptors, image=image)
        further = None
        if recorded is not None:
            detections = replace(detections, boxes=recorded.boxes)
            further = recorded.further
        self._recorder.add(frame, detections, centres, measured, update, further)
