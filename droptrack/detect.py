"""Command: find the droplets of single images, ``python -m droptrack.detect``."""

import functools
from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.video import ReadOptions
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.detection.scale import parse_diameter, parse_scale
from droptrack.options import (
    BackendOption,
    CellsOption,
    CfgOption,
    ChannelOption,
    ContoursOption,
    DarkOption,
    DiameterOption,
    KnownLengthOption,
    LevelsOption,
    LooksOption,
    MaxIouOption,
    NamesOption,
    NormaliseOption,
    OverwriteOption,
    PixelsOnlyOption,
    PrecisionOption,
    RegionOption,
    ScaleOption,
    ScoreOption,
    ShapeOption,
    SizeOption,
    UmPerPxOption,
    WeightsOption,
    units_from,
)
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE, ImagesConfig
from droptrack.pipeline.detect_images import detect_images

app = new_app()


@app.command()
@one_line_errors
def main(
    sources: Annotated[
        list[str], typer.Argument(help="Images, folders of images, and videos; sizes may differ.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    weights: WeightsOption = None,
    cfg: CfgOption = None,
    size: SizeOption = None,
    scale: ScaleOption = None,
    diameter: DiameterOption = None,
    looks: LooksOption = None,
    backend: BackendOption = Backend.auto,
    precision: PrecisionOption = Precision.auto,
    score: ScoreOption = MIN_SCORE,
    max_iou: MaxIouOption = MAX_IOU,
    dark: DarkOption = False,
    normalise: NormaliseOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    channel: ChannelOption = None,
    shape: ShapeOption = True,
    names: NamesOption = None,
    cells: CellsOption = None,
    contours: ContoursOption = None,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    pixels_only: PixelsOnlyOption = False,
    overwrite: OverwriteOption = False,
    no_images: Annotated[
        bool, typer.Option("--no-images", help="Write no annotated images.")
    ] = False,
) -> None:
    """Find the droplets of images: detections.csv, annotated images, sizes.png, report.json."""
    config = ImagesConfig(
        sources=tuple(sources),
        out=out,
        weights=weights,
        cfg=cfg,
        size=size,
        scale=None if scale is None else parse_scale(scale),
        diameter_px=None if diameter is None else parse_diameter(diameter),
        looks=looks,
        backend=backend,
        precision=precision,
        score=score,
        max_iou=max_iou,
        dark=dark,
        normalise=normalise,
        region=region,
        reading=ReadOptions(levels=levels, channel=channel),
        shape=shape,
        names=names,
        cells=cells,
        contours=contours,
        annotated=not no_images,
        overwrite=overwrite,
        units=units_from(um_per_px, known_length, pixels_only=pixels_only),
        pixels_only=pixels_only,
    )
    done = detect_images(config, functools.partial(typer.echo, err=True))
    done.report.print(all_in=done.folder / "report.json")
    typer.echo(f"results in {done.folder}")


if __name__ == "__main__":
    app()
