"""Command: track the droplets of a video, ``python -m droptrack.track``."""

import functools
from pathlib import Path
from typing import Annotated, Any

import typer

from droptrack.api import track
from droptrack.command_line import also_call, new_app, one_line_errors, refuse_given, was_given
from droptrack.data.video import ReadOptions
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.detection.scale import parse_diameter, parse_scale
from droptrack.errors import DroptrackError
from droptrack.options import (
    BackendOption,
    CellsOption,
    CfgOption,
    ChannelOption,
    ContoursOption,
    DarkOption,
    DiameterOption,
    FpsOption,
    KnownLengthOption,
    LevelsOption,
    LineOption,
    LooksOption,
    MaxIouOption,
    NamesOption,
    NormaliseOption,
    OverwriteOption,
    PixelsOnlyOption,
    PlotsOption,
    PrecisionOption,
    ReconnectOption,
    RegionOption,
    RenumberOption,
    ResumeOption,
    ScaleOption,
    ScoreOption,
    ShapeOption,
    SizeOption,
    UmPerPxOption,
    WeightsOption,
    units_from,
)
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE, DetectionsConfig, TrackingConfig
from droptrack.pipeline.from_detections import run_detections
from droptrack.pipeline.report_events import wanted_events
from droptrack.pipeline.run import run
from droptrack.tracking.choice import TrackerConfig, TrackerName, parse_velocity

app = new_app()
also_call(__name__, track)

OF_VIDEOS = (
    *("weights", "cfg", "no_video", "backend", "precision", "size", "scale", "diameter", "live"),
    *(
        "max_iou",
        "dark",
        "normalise",
        "batch",
        "levels",
        "channel",
        "renumber",
        "reconnect",
        "appearance_weights",
    ),
    *("appearance_size", "region", "shape", "names", "cells", "contours"),
    *("pixels_only", "line", "stays", "plots"),
)
OF_DEEPSORT = ("max_cosine_distance", "nn_budget", "max_iou_distance")


def configured(
    context: typer.Context,
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
    looks: LooksOption = None,
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
    normalise: NormaliseOption = None,
    region: RegionOption = None,
    shape: ShapeOption = True,
    names: NamesOption = None,
    cells: CellsOption = None,
    contours: ContoursOption = None,
    line: LineOption = None,
    stays: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X1,Y1,X2,Y2[,X3,Y3...]",
            help="Stays in a rectangle by its corners, or in a polygon; repeat for more.",
        ),
    ] = None,
    plots: PlotsOption = "",
    batch: Annotated[int, typer.Option(min=1, help="Frames the network takes at once.")] = 1,
    max_frames: Annotated[
        int, typer.Option(min=0, help="Stop after so many frames; 0: never.")
    ] = 0,
    levels: LevelsOption = None,
    channel: ChannelOption = None,
    renumber: RenumberOption = False,
    reconnect: ReconnectOption = 0,
    overwrite: OverwriteOption = False,
    resume: ResumeOption = False,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    pixels_only: PixelsOnlyOption = False,
    fps: FpsOption = None,
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
) -> TrackingConfig | DetectionsConfig:
    """Track the droplets of a video: trajectories.csv, tracked.mp4, paths.png, report.json."""
    units = units_from(um_per_px, known_length, fps, pixels_only=pixels_only)
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
    _refuse_ignored(context, tracking)
    if detections is not None:
        if video is not None or appearance is not None:
            raise DroptrackError("--detections takes the place of a video and its networks")
        refuse_given(context, OF_VIDEOS, "is of videos, and changes nothing of --detections")
        return DetectionsConfig(
            detections=detections,
            frames=frames,
            descriptors=descriptors,
            score=score if was_given(context, "score") else None,
            max_frames=max_frames,
            out=out,
            overwrite=overwrite,
            units=units,
            tracker=tracking,
        )
    if video is None or descriptors is not None or frames is not None:
        raise DroptrackError(
            "name a video, or a file with --detections (and --descriptors, --frames)"
        )
    return TrackingConfig(
        video=video,
        out=out,
        weights=weights,
        cfg=cfg,
        size=size,
        scale=None if scale is None else parse_scale(scale),
        diameter_px=None if diameter is None else parse_diameter(diameter),
        looks=looks,
        backend=backend,
        precision=precision,
        live=live,
        score=score,
        max_iou=max_iou,
        dark=dark,
        normalise=normalise,
        region=region,
        shape=shape,
        names=names,
        cells=cells,
        contours=contours,
        batch=batch,
        max_frames=max_frames,
        annotated_video=not no_video,
        reading=ReadOptions(
            levels=levels, channel=channel, renumber=renumber, reconnect_s=reconnect
        ),
        overwrite=overwrite,
        resume=resume,
        units=units,
        pixels_only=pixels_only,
        events=wanted_events(line or (), stays or (), plots),
        tracker=tracking,
    )


@app.command()
@one_line_errors
@functools.wraps(configured)  # Typer reads the options of the function that is wrapped
def main(*args: Any, **options: Any) -> None:
    """Run what the options say, and print what came of it."""
    config = configured(*args, **options)
    say = functools.partial(typer.echo, err=True)
    done = run(config, say) if isinstance(config, TrackingConfig) else run_detections(config, say)
    done.report.print(all_in=done.folder / "report.json")
    if done.events is not None:
        done.events.print()
    if done.problem is not None:
        raise done.problem
    typer.echo(f"results in {done.folder}")


def _refuse_ignored(context: typer.Context, tracking: TrackerConfig) -> None:
    """Raise DroptrackError for options that would change nothing."""
    if tracking.name is not TrackerName.deepsort:
        refuse_given(context, OF_DEEPSORT, "is of --tracker deepsort")
    else:
        refuse_given(context, ("expect_velocity",), "is of --tracker droplet")
    if tracking.appearance is None:
        refuse_given(
            context, ("appearance_weights", "appearance_size"), "is of an --appearance network"
        )


if __name__ == "__main__":
    app()
