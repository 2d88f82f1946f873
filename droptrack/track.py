"""Command: follow the droplets in a video, ``python -m droptrack.track``."""

import hashlib
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack import DroptrackError, __version__
from droptrack.appearance import describe
from droptrack.centroid import centres_of_mass
from droptrack.command_line import new_app, one_line_errors, progress_bar
from droptrack.darknet_files import read_cfg
from droptrack.deepsort import Parameters, Tracker
from droptrack.drawing import Annotator
from droptrack.engines.opencv_dnn import OpenCvDetector
from droptrack.network_choice import SHIPPED_WEIGHTS, find_cfg
from droptrack.recorder import Recorder
from droptrack.report import Report, Value
from droptrack.trajectories import (
    BOX_CENTRE,
    Trajectories,
    TrajectoryWriter,
    read_trajectories,
)
from droptrack.video import Frame, Video, VideoWriter


class Backend(StrEnum):
    """What runs the network."""

    auto = "auto"
    opencv = "opencv"
    opencv_cuda = "opencv-cuda"


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
    detector: OpenCvDetector,
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


app = new_app()


@app.command()
@one_line_errors
def main(
    video: Annotated[str, typer.Argument(help="Video file, folder of images, or camera index.")],
    weights: Annotated[
        Path | None, typer.Option(help="Darknet weights; without, the network that ships.")
    ] = None,
    cfg: Annotated[
        Path | None, typer.Option(help="Network description; without, by the weights' name.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; default tracks/<video's name>.")
    ] = None,
    no_video: Annotated[bool, typer.Option("--no-video", help="No annotated video.")] = False,
    backend: Annotated[Backend, typer.Option(help="What runs the network.")] = Backend.auto,
    score: Annotated[float, typer.Option(min=0, max=1, help="Least score of a droplet.")] = 0.4,
    max_iou: Annotated[
        float, typer.Option(min=0, max=1, help="Overlap from which two boxes are one droplet.")
    ] = 0.45,
    batch: Annotated[int, typer.Option(min=1, help="Frames the network takes at once.")] = 1,
    max_frames: Annotated[int, typer.Option(min=0, help="Stop after these; 0: never.")] = 0,
    max_cosine_distance: Annotated[float, typer.Option(min=0)] = Parameters.max_cosine_distance,
    nn_budget: Annotated[int, typer.Option(min=1)] = Parameters.nn_budget,
    max_iou_distance: Annotated[float, typer.Option(min=0, max=1)] = Parameters.max_iou_distance,
    max_age: Annotated[int, typer.Option(min=1)] = Parameters.max_age,
    n_init: Annotated[int, typer.Option(min=1)] = Parameters.n_init,
) -> None:
    """Follow the droplets in a video: trajectories.csv, tracked.mp4, paths.png, report.json."""
    weights = weights or SHIPPED_WEIGHTS
    parameters = Parameters(max_cosine_distance, nn_budget, max_iou_distance, max_age, n_init)
    network = read_cfg(cfg or find_cfg(weights))
    detector = OpenCvDetector(network, weights, backend.value, score, max_iou)
    source = Video(video)
    info = source.info
    out = out or Path("tracks") / (Path(video).stem or "camera")
    files = {name: out / name for name in ("trajectories.csv", "tracked.mp4", "paths.png")}
    if any(Path(video).resolve() == file.resolve() for file in files.values()):
        raise DroptrackError(f"{video}: would be overwritten by the results; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    about: dict[str, Value] = {
        "made by": f"droptrack {__version__}, droptrack.track",
        "video": f"{video}, {info.width} x {info.height} px, {info.fps:g} frames/s",
        "network": f"{network.path}, {weights}",
        "weights sha256": hashlib.sha256(weights.read_bytes()).hexdigest(),
        "units": "px, pixel c covers [c, c + 1), y points down; frames count from 0",
    }
    settings: dict[str, Value] = {
        **about,
        "backend": detector.name,
        "score": score,
        "max_iou": max_iou,
        **asdict(parameters),
    }
    problem: DroptrackError | None = None
    began = time.perf_counter()
    with TrajectoryWriter(files["trajectories.csv"], about, BOX_CENTRE) as rows:
        writer = None if no_video else VideoWriter(files["tracked.mp4"], info, "mp4v")
        results = Results(rows, writer)
        frames = islice(source, max_frames) if max_frames else source
        total = min(info.n_frames or max_frames, max_frames or info.n_frames)
        typer.echo(f"{video}: {network.path.stem} on {detector.name}", err=True)
        with progress_bar("frames") as progress:
            task = progress.add_task("tracking", total=total or None, note="")
            try:
                for done in follow(frames, detector, parameters, batch, results):
                    rate = done / (time.perf_counter() - began)
                    progress.update(task, completed=done, note=f"{rate:.1f} frames/s")
            except KeyboardInterrupt:
                problem = DroptrackError(f"interrupted after {results.n_frames} frames")
            except DroptrackError as error:
                problem = error
        if writer is not None:
            writer.close()
    finish(files, settings, results, time.perf_counter() - began)
    if problem is not None:
        raise DroptrackError(f"{problem}; what was tracked until there is in {out}")
    if 0 < results.n_frames < total:
        typer.echo(
            f"{video}: ends after {results.n_frames} of the {total} frames it claims", err=True
        )
    typer.echo(f"results in {out}")


def finish(
    files: dict[str, Path], settings: dict[str, Value], results: Results, seconds: float
) -> None:
    """Write the plot and the report, and print the table."""
    from droptrack.plots import plot_paths

    rows, _ = read_trajectories(files["trajectories.csv"])
    report = summarise(rows, settings, results, seconds)
    report.write_json(files["paths.png"].with_name("report.json"))
    report.print()
    size = str(settings["video"]).rsplit(", ", 2)[1].split(" ")
    plot_paths(files["paths.png"], rows, int(size[0]), int(size[2]))


if __name__ == "__main__":
    app()
