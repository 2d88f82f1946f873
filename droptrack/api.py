"""What the commands do, as functions: for scripts and notebooks."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

from droptrack.data.formats.contours import ContoursFormat
from droptrack.data.units import Units
from droptrack.data.video import ReadOptions
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.detection.scale import parse_scale
from droptrack.errors import DroptrackError
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE, TrackingConfig
from droptrack.pipeline.report_events import wanted_events
from droptrack.pipeline.run import TrackingRun, run
from droptrack.tracking.choice import TrackerConfig, TrackerName

Choice = TypeVar("Choice", bound=StrEnum)


def track(
    video: str | Path,
    *,
    out: str | Path | None = None,
    weights: str | Path | None = None,
    cfg: str | Path | None = None,
    size: str | None = None,
    scale: float | str | None = None,
    diameter_px: float | tuple[float, float] | None = None,
    looks: int | None = None,
    backend: str = Backend.auto,
    precision: str = Precision.auto,
    score: float = MIN_SCORE,
    max_iou: float = MAX_IOU,
    dark: bool = False,
    normalise: bool | None = None,
    region: str | None = None,
    max_frames: int = 0,
    annotated_video: bool = True,
    levels: tuple[float, float] | None = None,
    channel: int | None = None,
    renumber: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    shape: bool = True,
    names: str | Path | None = None,
    cells: str | None = None,
    contours: str | None = None,
    um_per_px: float | None = None,
    fps: float | None = None,
    pixels_only: bool = False,
    line: Sequence[str] = (),
    stays: Sequence[str] = (),
    plots: str = "",
    tracker: str | TrackerConfig = TrackerName.droplet,
    progress: bool = True,
) -> TrackingRun:
    """Track the droplets of a video, as ``python -m droptrack.track`` does.

    The results are written into the folder `out`, by default ``tracks/<the video's name>``, while
    the video is tracked. The other settings are those of `TrackingConfig` and the command's
    options. Raises DroptrackError for what cannot be done as asked, and for a video that breaks off
    or a run that is interrupted; what was tracked until then is in the folder.

    >>> import droptrack
    >>> run = droptrack.track("video.avi", out="results", max_frames=10, progress=False)
    >>> run.report.summary["n_droplets"], len(run.trajectories)
    (12, 120)
    >>> sorted(file.name for file in run.folder.iterdir())
    ['paths.png', 'report.json', 'tracked.mp4', 'trajectories.csv']
    """
    if not isinstance(tracker, TrackerConfig):
        tracker = TrackerConfig(name=_one_of(TrackerName, "tracker", tracker))
    done = run(
        TrackingConfig(
            video=str(video),
            out=_path(out),
            weights=_path(weights),
            cfg=_path(cfg),
            size=size,
            scale=parse_scale(scale) if isinstance(scale, str) else scale,
            diameter_px=diameter_px,
            looks=looks,
            backend=_one_of(Backend, "backend", backend),
            precision=_one_of(Precision, "precision", precision),
            score=score,
            max_iou=max_iou,
            dark=dark,
            normalise=normalise,
            region=region,
            max_frames=max_frames,
            annotated_video=annotated_video,
            reading=ReadOptions(levels=levels, channel=channel, renumber=renumber),
            overwrite=overwrite,
            resume=resume,
            shape=shape,
            names=_path(names),
            cells=cells,
            contours=None if contours is None else _one_of(ContoursFormat, "contours", contours),
            units=Units(um_per_px=um_per_px, fps=fps),
            pixels_only=pixels_only,
            events=wanted_events(line, stays, plots),
            tracker=tracker,
        ),
        progress=progress,
    )
    if done.problem is not None:
        raise done.problem
    return done


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)


def _one_of(kind: type[Choice], setting: str, value: str) -> Choice:
    """A member of an enumeration by its value."""
    try:
        return kind(value)
    except ValueError:
        raise DroptrackError(f"{setting} {value!r}: should be one of {', '.join(kind)}") from None
