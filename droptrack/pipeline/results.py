"""What one run writes: rows, annotated video, plots and report."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.data.frames import Frame
from droptrack.data.report import Report, Value
from droptrack.data.stage_times import StageTimes
from droptrack.data.trajectories import BOX_CENTRE, TrajectoryWriter
from droptrack.data.units import Units
from droptrack.pipeline.classes import CLASS_ID, ClassVotes
from droptrack.pipeline.contours import PLACE, ContourLog
from droptrack.pipeline.paths import Paths, counted
from droptrack.pipeline.paths_picture import draw_paths
from droptrack.pipeline.threads import AnnotatedVideo
from droptrack.tracking.recorder import Gap, Recorded
from droptrack.tracking.session import TrackingSession
from droptrack.tracking.smoothing import COLUMNS as SMOOTHED
from droptrack.tracking.smoothing import Smoother
from droptrack.tracking.tracker import Velocity

AT_EDGE = "at_edge"
FIXED = ("frame", "x", "y", "w", "h")  # columns that other units are of
FURTHER_COLUMNS = (*BOX_CENTRE, "centre_of_mass", *SMOOTHED)


def columns_with(units: Units, further: tuple[str, ...] = ()) -> tuple[str, ...]:
    """The names of the columns that follow the fixed ones; `further`: of shapes and classes."""
    columns = FURTHER_COLUMNS + further
    return columns + units.names(FIXED + columns)


@dataclass
class Results:
    """The files that tracking writes, filled frame by frame, and what is counted meanwhile."""

    rows: TrajectoryWriter
    video: AnnotatedVideo | None = None
    times: StageTimes = field(default_factory=StageTimes)
    units: Units = field(default_factory=Units)
    votes: ClassVotes | None = None  # where a network tells classes
    contours: ContourLog | None = None  # where outlines are wanted
    n_frames: int = 0
    last_frame: int = -1  # its number
    n_dropped: int = 0  # frames of a live source that came while others were at work
    n_measured: int = 0  # detections whose centre of mass could be measured
    n_detections: int = 0
    n_sizes: int = 0  # detections whose outline could be measured,
    n_rings: int = 0  # and those of them whose outline is the outside of a ring
    slowest: float = 0.0  # seconds from decoding a frame to the end of its tracking
    paths: Paths = field(default_factory=Paths)
    gaps: list[Gap] = field(default_factory=list)  # that were bridged, once all is finished
    velocities: tuple[Velocity, ...] = ()  # two if the images do not tell which is right
    _late: deque[tuple[int, Frame]] = field(default_factory=deque)
    _smoother: Smoother = field(default_factory=Smoother)

    def write(self, final: Recorded) -> None:
        """Write final rows, once they are smoothed."""
        with self.times.measure("write"):
            self._write(self._smoother.add(final))

    def finish(self, session: TrackingSession) -> None:
        """Write the rows that are left, and those that are being smoothed."""
        with self.times.measure("write"):
            self._write(self._smoother.add(session.finish()))
            self._write(self._smoother.rest())
        self.gaps, self.velocities = session.gaps, session.possible_velocities

    def _write(self, smoothed: Iterable[tuple[Recorded, NDArray[np.float64]]]) -> None:
        for recorded, columns in smoothed:
            rows = recorded.rows
            further = {name: one for name, one in rows.columns.items() if name != PLACE}
            if AT_EDGE in further:
                further[AT_EDGE] = further[AT_EDGE] == 1  # not NaN, where gaps were bridged
            if self.votes is not None:
                further |= self.votes.classes.columns(further[CLASS_ID])
                self.votes.add(rows, further[CLASS_ID])
            extra = {
                **dict(zip(BOX_CENTRE, rows.boxes.T, strict=False)),
                **{"centre_of_mass": recorded.measured},
                **dict(zip(SMOOTHED, columns.T, strict=True)),
                **further,
            }
            fixed = dict(zip(FIXED, (rows.frame, rows.x, rows.y, *rows.boxes.T[2:]), strict=True))
            extra |= self.units.further({**fixed, **extra})
            self.rows.write(rows, extra.values())
            self.paths.add(rows)
            if self.contours is not None:
                self.contours.write(rows)

    def show(self, index: int, frame: Frame, session: TrackingSession) -> None:
        """Write the annotated frame from some frames ago: by now new tracks are confirmed."""
        if self.video is None:
            return
        self._late.append((index, frame))
        if len(self._late) > session.delay:
            self._show_next(session)

    def show_rest(self, session: TrackingSession) -> None:
        """Write the annotated frames that are left."""
        while self._late:
            self._show_next(session)

    def _show_next(self, session: TrackingSession) -> None:
        assert self.video is not None
        index, frame = self._late.popleft()
        self.video.write(index, frame, session.rows_of(index))


def summarise(
    results: Results,
    settings: dict[str, Value],
    size: tuple[float, float],
    n_missing: int,
    seconds: float,
    doubts: list[str] | None = None,
) -> Report:
    """One row a droplet: when and how far it went; and one a long gap that was bridged.

    `size`: width and height of the images, px; `n_missing` frames could not be decoded; `seconds`
    are those of the whole; `doubts`: what makes one doubt the results.
    """
    droplets = results.paths.table(results.units)
    votes = results.votes
    if votes is not None:
        droplets = [row | votes.row(int(str(row["track_id"]))) for row in droplets]
    entered, left = results.paths.passages(*size)
    gaps = sorted(results.gaps, key=lambda gap: (gap.first_frame, gap.track_id))
    summary: dict[str, Value] = {
        "n_frames": results.n_frames,
        "n_droplets": len(droplets),
        **(votes.summary() if votes is not None else {}),
        "n_entered": len(entered),
        "entered_at": counted(entered),
        "n_left": len(left),
        "left_at": counted(left),
        "n_long_gaps": len(gaps),
        "n_gaps_against_flow": sum(gap.against_flow for gap in gaps),
        "velocity_is_ambiguous": bool(results.velocities),
        "n_detections": results.n_detections,
        "n_centres_of_mass_measured": results.n_measured,
        "n_sizes_measured": results.n_sizes,
        "n_sizes_of_rings": results.n_rings,
        "n_frames_missing": n_missing,
        "n_frames_dropped": results.n_dropped,
        "slowest_frame_s": results.slowest,
        "seconds": seconds,
        "frames_per_second": results.n_frames / seconds,
        **results.times.milliseconds_a_frame(results.n_frames),
    }
    if doubts:
        summary["doubts"] = doubts
    return Report("Droplets", settings, summary, droplets, [gap._asdict() for gap in gaps])


def write_report(folder: Path, report: Report, paths: Paths, size: tuple[int, int]) -> None:
    """Write ``report.json``, and the plot ``paths.png`` of an image of `size` px."""
    report.write_json(folder / "report.json")
    draw_paths(folder / "paths.png", paths.lines(), *size)
