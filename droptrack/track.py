"""Command: follow the droplets in a video, ``python -m droptrack.track``."""

import functools
import time
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.compiled import explained
from droptrack.data.report import Value
from droptrack.data.stage_times import StageTimes
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.data.video import Video, VideoWriter
from droptrack.detection import decoding
from droptrack.detection.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.errors import DroptrackError
from droptrack.measurement import centre_of_mass
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg, parse_size
from droptrack.network.darknet_cfg import read_cfg, resized
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.from_detections import track_detections
from droptrack.pipeline.run import FURTHER_COLUMNS, Results, finish, follow
from droptrack.pipeline.threads import AnnotatedVideo
from droptrack.progress import progress_bar
from droptrack.tracking.choice import TrackerName, choose_appearance, make_tracker
from droptrack.tracking.deepsort import Parameters
from droptrack.version import __version__

app = new_app()


@app.command()
@one_line_errors
def main(
    video: Annotated[
        str | None, typer.Argument(help="Video file, folder of images, or camera index.")
    ] = None,
    detections: Annotated[
        Path | None, typer.Option(help="Instead of a video: boxes in MOT Challenge's format.")
    ] = None,
    descriptors: Annotated[
        Path | None, typer.Option(help="What they look like: .npy, a row for each.")
    ] = None,
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
    backend: Annotated[
        Backend, typer.Option(help="What runs the network; auto: the fastest that works here.")
    ] = Backend.auto,
    precision: Annotated[
        Precision, typer.Option(help="auto: the fastest that was checked; fp32: the exact network.")
    ] = Precision.auto,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="The network's input, px; default the cfg's.")
    ] = None,
    live: Annotated[
        bool | None,
        typer.Option(
            "--live/--every-frame",
            help="Always the newest frame, others dropped; default for cameras and streams.",
        ),
    ] = None,
    score: Annotated[float, typer.Option(min=0, max=1, help="Least score of a droplet.")] = 0.4,
    max_iou: Annotated[
        float, typer.Option(min=0, max=1, help="Overlap from which two boxes are one droplet.")
    ] = 0.3,
    dark: Annotated[
        bool, typer.Option("--dark", help="Droplets are darker than what is around them.")
    ] = False,
    batch: Annotated[int, typer.Option(min=1, help="Frames the network takes at once.")] = 1,
    max_frames: Annotated[int, typer.Option(min=0, help="Stop after these; 0: never.")] = 0,
    tracker: Annotated[TrackerName, typer.Option(help="How.")] = TrackerName.droplet,
    appearance: Annotated[
        Path | None, typer.Option(help="Network that tells droplets apart: .onnx, or Darknet .cfg.")
    ] = None,
    appearance_weights: Annotated[Path | None, typer.Option(help="Of that .cfg.")] = None,
    appearance_size: Annotated[
        tuple[int, int], typer.Option(help="Width and height of that network's input, px.")
    ] = (64, 64),
    max_age: Annotated[
        int | None, typer.Option(min=1, help="Frames that a droplet may be missed.")
    ] = None,
    n_init: Annotated[
        int | None, typer.Option(min=1, help="Detections that make a droplet.")
    ] = None,
    max_cosine_distance: Annotated[
        float, typer.Option(min=0, help="DeepSORT's, as the next two.")
    ] = Parameters.max_cosine_distance,
    nn_budget: Annotated[int, typer.Option(min=1)] = Parameters.nn_budget,
    max_iou_distance: Annotated[float, typer.Option(min=0, max=1)] = Parameters.max_iou_distance,
) -> None:
    """Follow the droplets in a video: trajectories.csv, tracked.mp4, paths.png, report.json."""
    follower, tracker_settings = make_tracker(
        tracker,
        Parameters(max_cosine_distance, nn_budget, max_iou_distance),
        max_age=max_age,
        n_init=n_init,
        by_appearance=appearance is not None or descriptors is not None,
    )
    if detections is not None:
        if video is not None or appearance is not None:
            raise DroptrackError("--detections takes the place of a video and its networks")
        track_detections(detections, descriptors, follower, tracker_settings, out)
        return
    if video is None or descriptors is not None:
        raise DroptrackError("name a video, or a file with --detections (and --descriptors)")
    weights = weights or BUNDLED_WEIGHTS
    describe = choose_appearance(tracker, appearance, appearance_weights, appearance_size)
    network = read_cfg(cfg or find_cfg(weights))
    if size is not None:
        network = resized(network, *parse_size(size))
    source = Video(video)
    info = source.info
    live = source.live if live is None else live
    say = functools.partial(typer.echo, err=True)
    with explained(say):
        decoding.load_loops()
        centre_of_mass.load_loops()
    detector = choose_detector(
        Network(network, weights, score, max_iou, dark), backend, precision, live=live, say=say
    )
    out = out or Path("tracks") / (Path(video).stem or "camera")
    if Path(video).resolve() == (out / "tracked.mp4").resolve():
        raise DroptrackError(f"{video}: would be overwritten by the results; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    about: dict[str, Value] = {
        "made by": f"droptrack {__version__}, droptrack.track",
        "video": f"{video}, {info.width} x {info.height} px, {info.fps:g} frames/s",
        "network": f"{network.path}, {weights}",
        "weights sha256": sha256_of(weights),
        "units": "px, pixel c covers [c, c + 1), y points down; frames count from 0",
    }
    settings: dict[str, Value] = {
        **about,
        "backend": detector.engine.name,
        "network_size": [network.width, network.height],
        "live": live,
        "score": score,
        "max_iou": max_iou,
        "dark": dark,
        **tracker_settings,
    }
    problem: DroptrackError | None = None
    began = time.perf_counter()
    with TrajectoryWriter(out / "trajectories.csv", about, FURTHER_COLUMNS) as rows:
        times = StageTimes()
        writer = (
            None
            if no_video
            else AnnotatedVideo(VideoWriter(out / "tracked.mp4", info, "mp4v"), times)
        )
        results = Results(rows, writer, times)
        frames = islice(source.numbered(), max_frames or None)
        total = min(info.n_frames or max_frames, max_frames or info.n_frames)
        typer.echo(
            f"{video}: {network.path.stem}, {network.width} x {network.height} px, on "
            f"{detector.engine.name}",
            err=True,
        )
        with progress_bar("frames") as progress:
            task = progress.add_task("tracking", total=total or None, note="")
            try:
                following = follow(
                    frames, detector, follower, describe, results, batch=batch, live=live
                )
                for done in following:
                    rate = done / (time.perf_counter() - began)
                    progress.update(task, completed=done, note=f"{rate:.1f} frames/s")
            except KeyboardInterrupt:
                problem = DroptrackError(f"interrupted after {results.n_frames} frames")
            except DroptrackError as error:
                problem = error
        try:
            if writer is not None:
                writer.close()
        except DroptrackError as error:
            problem = problem or error
    n_missing = 0 if live or problem else max(0, total - results.n_frames)
    finish(
        out, (info.width, info.height), settings, results, n_missing, time.perf_counter() - began
    )
    if problem is not None:
        raise DroptrackError(f"{problem}; what was tracked until there is in {out}")
    if n_missing:
        typer.echo(
            f"{video}: {n_missing} of the {total} frames it claims could not be decoded: it is "
            "damaged, or ends early",
            err=True,
        )
    if results.n_frames and not results.n_detections:
        shade, cure = ("brighter", "leave out") if dark else ("darker", "add")
        typer.echo(
            f"{video}: no droplets found; if they are {shade} than what is around them, {cure} "
            "--dark",
            err=True,
        )
    if results.n_dropped:
        typer.echo(f"{video}: {results.n_dropped} frames dropped, newer ones were there", err=True)
    typer.echo(f"results in {out}")


if __name__ == "__main__":
    app()
