"""Command: weights for one's own set-up, ``python -m droptrack.adapt``."""

import functools
from pathlib import Path
from typing import Annotated

import typer

from droptrack.adaptation.config import BATCH, ITERATIONS, LEARNING_RATE, AdaptationConfig
from droptrack.adaptation.run import adapt
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.video import ReadOptions
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.detection.scale import parse_diameter, parse_scale
from droptrack.options import (
    BackendOption,
    CfgOption,
    ChannelOption,
    DiameterOption,
    LevelsOption,
    MaxIouOption,
    PrecisionOption,
    ScaleOption,
    ScoreOption,
    WeightsOption,
)
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE

app = new_app()


@app.command()
@one_line_errors
def main(
    video: Annotated[
        str, typer.Argument(help="Video, or folder of images, which may be unrelated.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the new weights and all else.")],
    labels: Annotated[
        Path | None,
        typer.Option(help="Images with Darknet label files beside them; they count most."),
    ] = None,
    weights: WeightsOption = None,
    cfg: CfgOption = None,
    scale: ScaleOption = None,
    diameter: DiameterOption = None,
    iterations: Annotated[
        int, typer.Option(min=1, help="Iterations of training; 500 take about 20 minutes.")
    ] = ITERATIONS,
    batch: Annotated[int, typer.Option(min=2, help="Images an iteration.")] = BATCH,
    rate: Annotated[
        float, typer.Option("--learning-rate", min=0, help="Learning rate.")
    ] = LEARNING_RATE,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same images and batches.")] = 0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Resume an interrupted adaptation in --out.")
    ] = False,
    backend: BackendOption = Backend.auto,
    precision: PrecisionOption = Precision.auto,
    score: ScoreOption = MIN_SCORE,
    max_iou: MaxIouOption = MAX_IOU,
    levels: LevelsOption = None,
    channel: ChannelOption = None,
) -> None:
    """Train the network on for the droplets of your own video, without a label.

    Writes adapted.weights and adapted.cfg, report.json with before and after, contact_sheet.png to
    look at; the network that it starts from stays as it is.
    """
    config = AdaptationConfig(
        video=video,
        out=out,
        labels=labels,
        weights=weights,
        cfg=cfg,
        scale=None if scale is None else parse_scale(scale),
        diameter_px=None if diameter is None else parse_diameter(diameter),
        iterations=iterations,
        batch=batch,
        learning_rate=rate,
        seed=seed,
        resume=resume,
        backend=backend,
        precision=precision,
        score=score,
        max_iou=max_iou,
        reading=ReadOptions(levels=levels, channel=channel),
    )
    done = adapt(config, functools.partial(typer.echo, err=True))
    done.report.print()
    if done.helped:
        scale = f"--scale {done.report.settings['scale']:.3g}"
        typer.echo(f"it helped: droptrack track {video} --weights {done.weights} {scale}")
    else:
        typer.echo("it did not help: keep the network that you have; see docs/adapt.md")
    typer.echo(f"look at {done.folder / 'contact_sheet.png'}")


if __name__ == "__main__":
    app()
