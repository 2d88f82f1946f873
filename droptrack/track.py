"""Command: track the droplets of a video, ``python -m droptrack.track``."""

import functools
from pathlib import Path
from typing import Annotated

import typer

from droptrack.api import track
from droptrack.command_line import also_call, new_app, one_line_errors
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.errors import DroptrackError
from droptrack.options import (
    BackendOption,
    CfgOption,
    DarkOption,
    DiameterOption,
    MaxIouOption,
    PrecisionOption,
    ScaleOption,
    ScoreOption,
    SizeOption,
    WeightsOption,
)
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE, DetectionsConfig, TrackingConfig
from droptrack.pipeline.from_detections import run_detections
from droptrack.pipeline.run import run
from droptrack.tracking.choice import TrackerConfig, TrackerName, parse_velocity

app = new_app()
also_call(__name__, track)


@app.command()
@one_line_errors
def main(
    video: Annotated[
        str | None,
        typer.Argument(help="Video file, folder of images, index of a camera, or a stream."),
    ] = None,
    detections: Annotated[
        Path | None, typer.Option(help="Instead of a video: boxes in MOT Challenge's format.")
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(
            help="With --detections: a file with the numbers of the frames that exist, from 1, or "
            "ranges such as 12-80; in others no droplet is missed. Default: those with a box."
        ),
    ] = None,
    descriptors: Annotated[
        Path | None,
        typer.Option(help="With --detections: appearance descriptors, .npy, a row for each box."),
    ] = None,
    weights: WeightsOption = None,
    cfg: CfgOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; default: tracks/<video's name>.")
    ] = None,
    no_video: Annotated[bool, typer.Option("--no-video", help="Write no annotated video.")] = False,
    backend: BackendOption = Backend.auto,
    precision: PrecisionOption = Precision.auto,
    size: SizeOption = None,
    scale: ScaleOption = None,
    diameter: DiameterOption = None,
    live: Annotated[
        bool | None,
        typer.Option(
            "--live/--every-frame",
            help="Always take the newest frame and drop others; default for cameras and streams.",
        ),
    ] = None,
    score: ScoreOption = MIN_SCORE,
    max_iou: MaxIouOption = MAX_IOU,
    dark: DarkOption = False,
    batch: Annotated[int, typer.Option(min=1, help="Frames the network takes at once.")] = 1,
    max_frames: Annotated[
        int, typer.Option(min=0, help="Stop after so many frames; 0: never.")
    ] = 0,
    tracker: Annotated[
        TrackerName, typer.Option(help="The tracker made for droplets, or DeepSORT.")
    ] = TrackerName.droplet,
    appearance: Annotated[
        Path | None,
        typer.Option(help="Network that tells droplets apart: an .onnx file or a Darknet .cfg."),
    ] = None,
    appearance_weights: Annotated[
        Path | None, typer.Option(help="Weights of an --appearance .cfg.")
    ] = None,
    appearance_size: Annotated[
        tuple[int, int], typer.Option(help="Width and height of the --appearance input, px.")
    ] = TrackerConfig.appearance_size,
    max_age: Annotated[
        int | None, typer.Option(min=1, help="Frames that a droplet may be missed.")
    ] = None,
    n_init: Annotated[
        int | None, typer.Option(min=1, help="Detections that confirm a droplet.")
    ] = None,
    expect_velocity: Annotated[
        str | None,
        typer.Option(
            metavar="VX,VY",
            help="Velocity of entering droplets, px a frame: where steps are longer than half the "
            "spacing of a train, several velocities explain it.",
        ),
    ] = None,
    max_cosine_distance: Annotated[
        float, typer.Option(min=0, help="DeepSORT: maximum distance of appearance descriptors.")
    ] = TrackerConfig.max_cosine_distance,
    nn_budget: Annotated[
        int, typer.Option(min=1, help="DeepSORT: descriptors kept of each track.")
    ] = TrackerConfig.nn_budget,
    max_iou_distance: Annotated[
        float, typer.Option(min=0, max=1, help="DeepSORT: maximum of 1 - IoU of a match.")
    ] = TrackerConfig.max_iou_distance,
) -> None:
    """Track the droplets of a video: trajectories.csv, tracked.mp4, paths.png, report.json."""
    say = functools.partial(typer.echo, err=True)
    tracking = TrackerConfig(
        name=tracker,
        max_age=max_age,
        n_init=n_init,
        expect_velocity=None if expect_velocity is None else parse_velocity(expect_velocity),
        max_cosine_distance=max_cosine_distance,
        nn_budget=nn_budget,
        max_iou_distance=max_iou_distance,
        appearance=appearance,
        appearance_weights=appearance_weights,
        appearance_size=appearance_size,
    )
    if detections is not None:
        if video is not None or appearance is not None:
            raise DroptrackError("--detections takes the place of a video and its networks")
        done = run_detections(
            DetectionsConfig(
                detections=detections,
                frames=frames,
                descriptors=descriptors,
                out=out,
                tracker=tracking,
            ),
            say,
        )
    elif video is None or descriptors is not None or frames is not None:
        raise DroptrackError(
            "name a video, or a file with --detections (and --descriptors, --frames)"
        )
    else:
        config = TrackingConfig(
            video=video,
            out=out,
            weights=weights,
            cfg=cfg,
            size=size,
            scale=scale,
            diameter_px=diameter,
            backend=backend,
            precision=precision,
            live=live,
            score=score,
            max_iou=max_iou,
            dark=dark,
            batch=batch,
            max_frames=max_frames,
            annotated_video=not no_video,
            tracker=tracking,
        )
        done = run(config, say)
    done.report.print()
    if done.problem is not None:
        raise done.problem
    typer.echo(f"results in {done.folder}")


if __name__ == "__main__":
    app()
