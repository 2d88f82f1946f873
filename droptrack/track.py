"""Command: follow the droplets in a video, ``python -m droptrack.track``."""

import time
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from droptrack import DroptrackError, __version__
from droptrack.command_line import new_app, one_line_errors, progress_bar
from droptrack.darknet_files import read_cfg, resized
from droptrack.deepsort import Parameters
from droptrack.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.network_choice import SHIPPED_WEIGHTS, find_cfg, parse_size
from droptrack.pipeline import Results, follow, summarise
from droptrack.quantisation import sha256_of
from droptrack.report import Value
from droptrack.stage_times import StageTimes
from droptrack.threads import AnnotatedVideo
from droptrack.trajectories import BOX_CENTRE, TrajectoryWriter
from droptrack.video import Video, VideoInfo, VideoWriter

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
    backend: Annotated[
        Backend, typer.Option(help="What runs the network; auto: the fastest that works here.")
    ] = Backend.auto,
    precision: Annotated[
        Precision, typer.Option(help="auto: int8 where it is calibrated, else what is exact.")
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
    if size is not None:
        network = resized(network, *parse_size(size))
    source = Video(video)
    info = source.info
    live = source.live if live is None else live
    detector = choose_detector(
        Network(network, weights, score, max_iou),
        backend,
        precision,
        live=live,
        say=lambda text: typer.echo(text, err=True),
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
        **asdict(parameters),
    }
    problem: DroptrackError | None = None
    began = time.perf_counter()
    with TrajectoryWriter(out / "trajectories.csv", about, BOX_CENTRE) as rows:
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
                for done in follow(frames, detector, parameters, results, batch=batch, live=live):
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
    finish(out, info, settings, results, n_missing, time.perf_counter() - began)
    if problem is not None:
        raise DroptrackError(f"{problem}; what was tracked until there is in {out}")
    if n_missing:
        typer.echo(
            f"{video}: {n_missing} of the {total} frames it claims could not be decoded: it is "
            "damaged, or ends early",
            err=True,
        )
    if results.n_dropped:
        typer.echo(f"{video}: {results.n_dropped} frames dropped, newer ones were there", err=True)
    typer.echo(f"results in {out}")


def finish(
    out: Path,
    info: VideoInfo,
    settings: dict[str, Value],
    results: Results,
    n_missing: int,
    seconds: float,
) -> None:
    """Write the plot and the report, and print the table."""
    from droptrack.plots import plot_paths

    report = summarise(results, settings, n_missing, seconds)
    report.write_json(out / "report.json")
    report.print()
    plot_paths(out / "paths.png", results.paths.lines(), info.width, info.height)


if __name__ == "__main__":
    app()
