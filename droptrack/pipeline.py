"""Video -> detections -> tracks -> centres of mass -> trajectories, frame by frame."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from droptrack.appearance import describe
from droptrack.centroid import centres_of_mass
from droptrack.deepsort import Parameters, Tracker
from droptrack.detector import Detector
from droptrack.drawing import Annotator
from droptrack.recorder import Recorder
from droptrack.report import Report, Value
from droptrack.trajectories import Trajectories, TrajectoryWriter
from droptrack.video import Frame, VideoWriter


@dataclass
class Results:
    """The files that tracking writes, filled frame by frame."""

    rows: TrajectoryWriter
    video: VideoWriter | None
    n_frames: int = 0
    n_measured: int = 0  # detections whose centre of mass could be measured
    n_detections: int = 0
    _late: deque[tuple[int, Frame]] = field(default_factory=deque)
    _annotator: Annotator = field(default_factory=Annotator)

    def take(self, rows: Trajectories) -> None:
        """Write final rows."""
        self.rows.write(rows, (rows.boxes[:, 0], rows.boxes[:, 1]))

    def show(self, index: int, frame: Frame, recorder: Recorder, delay: int) -> None:
        """Write the annotated frame from `delay` frames ago: by now new tracks are confirmed."""
        if self.video is None:
            return
        self._late.append((index, frame))
        if len(self._late) > delay:
            self._draw_next(recorder)

    def show_rest(self, recorder: Recorder) -> None:
        """Write the annotated frames that are left."""
        while self._late:
            self._draw_next(recorder)

    def _draw_next(self, recorder: Recorder) -> None:
        assert self.video is not None
        index, frame = self._late.popleft()
        self.video.write(self._annotator.draw(index, frame, recorder.rows_of(index)))


def follow(
    frames: Iterable[Frame],
    detector: Detector,
    parameters: Parameters,
    batch: int,
    results: Results,
) -> Iterator[int]:
    """Detect and track frame by frame into `results`; yields the number of frames done."""
    tracker, recorder = Tracker(parameters), Recorder(parameters.max_age)
    delay = parameters.n_init - 1
    source = iter(frames)
    try:
        while pictures := list(islice(source, batch)):
            for frame, detections in zip(pictures, detector.detect(pictures), strict=True):
                index = results.n_frames
                update = tracker.update(detections.boxes, describe(frame, detections.boxes))
                centres, measured = centres_of_mass(frame, detections.boxes)
                recorder.add(index, centres, detections.boxes, detections.scores, update)
                results.n_frames += 1
                results.n_detections += len(detections)
                results.n_measured += int(measured.sum())
                results.show(index, frame, recorder, delay)
                results.take(recorder.take_final(index - delay))
            yield results.n_frames
    finally:
        results.show_rest(recorder)
        too_short = results.n_frames < parameters.n_init  # for any track to be confirmed
        results.take(recorder.take_rest(unconfirmed=too_short))


def summarise(
    rows: Trajectories, settings: dict[str, Value], results: Results, seconds: float
) -> Report:
    """One row a droplet: when and how far it went."""
    droplets: list[dict[str, Value]] = []
    for track_id in np.unique(rows.track_id):
        mine = rows.track_id == track_id
        x, y, frame = rows.x[mine], rows.y[mine], rows.frame[mine]
        path = float(np.hypot(np.diff(x), np.diff(y)).sum())
        n = int(frame[-1] - frame[0])
        droplets.append(
            {
                "track_id": int(track_id),
                "first_frame": int(frame[0]),
                "last_frame": int(frame[-1]),
                "n_observed": int(rows.observed[mine].sum()),
                "n_bridged": int((~rows.observed[mine]).sum()),
                "diameter_px": float(np.sqrt(rows.boxes[mine, 2] * rows.boxes[mine, 3]).mean()),
                "path_px": path,
                "speed_px_per_frame": path / n if n else float("nan"),
            }
        )
    summary: dict[str, Value] = {
        "n_frames": results.n_frames,
        "n_droplets": len(droplets),
        "n_detections": results.n_detections,
        "n_centres_of_mass_measured": results.n_measured,
        "seconds": seconds,
        "frames_per_second": results.n_frames / seconds,
    }
    return Report("Droplets", settings, summary, droplets)
