"""Video -> detections -> tracks -> centres of mass -> trajectories, frame by frame."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.centroid import centres_of_mass
from droptrack.detector import Detector
from droptrack.drawing import Annotator
from droptrack.recorder import Recorded, Recorder
from droptrack.report import Report, Value
from droptrack.smoothing import COLUMNS as SMOOTHED
from droptrack.smoothing import Smoother
from droptrack.tracks import Tracker
from droptrack.trajectories import BOX_CENTRE, Trajectories, TrajectoryWriter, read_trajectories
from droptrack.video import Frame, VideoWriter

FURTHER_COLUMNS = (*BOX_CENTRE, "centre_of_mass", *SMOOTHED)
# a frame and boxes (N, 4) -> unit descriptors (N, D)
Describe = Callable[[Frame, NDArray[np.float64]], NDArray[np.float64]]


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
    _smoother: Smoother = field(default_factory=Smoother)

    def take(self, recorded: Recorded) -> None:
        """Write final rows, once they are smoothed."""
        for done, smoothed in self._smoother.add(recorded):
            self._write(done, smoothed)

    def take_rest(self, recorded: Recorded) -> None:
        """Write all that is left."""
        self.take(recorded)
        for done, smoothed in self._smoother.rest():
            self._write(done, smoothed)

    def _write(self, recorded: Recorded, smoothed: NDArray[np.float64]) -> None:
        rows = recorded.rows
        extra = (rows.boxes[:, 0], rows.boxes[:, 1], recorded.measured.astype(float), *smoothed.T)
        self.rows.write(rows, extra)

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
    tracker: Tracker,
    describe: Describe,
    batch: int,
    results: Results,
) -> Iterator[int]:
    """Detect and track frame by frame into `results`; yields the number of frames done."""
    recorder = Recorder(tracker.max_age)
    source = iter(frames)
    try:
        while pictures := list(islice(source, batch)):
            for frame, detections in zip(pictures, detector.detect(pictures), strict=True):
                index = results.n_frames
                update = tracker.update(detections.boxes, describe(frame, detections.boxes))
                centres, measured = centres_of_mass(frame, detections.boxes)
                recorder.add(index, detections, centres, measured, update)
                results.n_frames += 1
                results.n_detections += len(detections)
                results.n_measured += int(measured.sum())
                results.show(index, frame, recorder, tracker.delay)
                results.take(recorder.take_final(index - tracker.delay))
            yield results.n_frames
    finally:
        results.show_rest(recorder)
        too_short = results.n_frames < tracker.n_init  # for any track to be confirmed
        results.take_rest(recorder.take_rest(unconfirmed=too_short))


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


def finish(
    out: Path, size: tuple[int, int], settings: dict[str, Value], results: Results, seconds: float
) -> None:
    """Write the plot, of a picture of `size` px, and the report, and print the table."""
    from droptrack.plots import plot_paths

    rows, _ = read_trajectories(out / "trajectories.csv")
    report = summarise(rows, settings, results, seconds)
    report.write_json(out / "report.json")
    report.print()
    plot_paths(out / "paths.png", rows, *size)
