"""Options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from droptrack.data.formats.contours import ContoursFormat
from droptrack.data.units import Units, parse_known_length
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.detection.looks import MAX_LOOKS
from droptrack.errors import DroptrackError

WeightsOption = Annotated[
    Path | None,
    typer.Option(
        help="Darknet weights (.weights), or one of the bundled models: simulations (bright, "
        "filled droplets), footage (droplets as laboratories film them).",
    ),
]
CfgOption = Annotated[
    Path | None,
    typer.Option(help="Network description (.cfg); default: the one with the weights' name."),
]
SizeOption = Annotated[
    str | None, typer.Option(metavar="WxH", help="Input of the network, px; default: the cfg's.")
]
BackendOption = Annotated[
    Backend, typer.Option(help="What runs the network; auto: the fastest that works here.")
]
PrecisionOption = Annotated[
    Precision,
    typer.Option(help="What the network computes in; auto: the fastest checked; fp32: exact."),
]
ScaleOption = Annotated[
    str | None,
    typer.Option(
        metavar="auto|NUMBER",
        help="Px of the network's input for a px of the frames; auto: what suits the droplets of "
        "some of the frames. Default: auto for footage, else the cfg's size.",
    ),
]
DiameterOption = Annotated[
    str | None,
    typer.Option(
        metavar="PX|PX-PX",
        help="Diameter of a typical droplet, px of the frames, for the scale; or the smallest and "
        "the largest: others do not count, and several scales are used where one is too few.",
    ),
]
LooksOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=MAX_LOOKS,
        help="At how many scales around the one chosen the network sees each frame; their mean "
        "counts: fewer false boxes, in more time. Default: 1, but 3 for single images.",
    ),
]
ScoreOption = Annotated[float, typer.Option(min=0, max=1, help="Minimum score of a droplet.")]
MaxIouOption = Annotated[
    float, typer.Option(min=0, max=1, help="IoU above which two boxes are one droplet.")
]
RegionOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y X,Y X,Y... | FILE",
        help="Where droplets count: a polygon, px, or an image that is black elsewhere.",
    ),
]
ShapeOption = Annotated[
    bool, typer.Option("--shape/--no-shape", help="Measure outlines: sizes and shapes.")
]
ContoursOption = Annotated[
    ContoursFormat | None,
    typer.Option(
        help="Write the outlines, too: contours.parquet, or contours.json as COCO has it."
    ),
]
LineOption = Annotated[
    list[str] | None,
    typer.Option(metavar="X1,Y1,X2,Y2", help="Count what passes this line; repeat for more."),
]
PlotsOption = Annotated[
    str,
    typer.Option(
        help="Figures to draw as PDF and PNG: all, or some of sizes,deformation,speed,kymograph,"
        "paths."
    ),
]
NamesOption = Annotated[
    Path | None,
    typer.Option(
        help="Of a network with several classes, their names: a .names file, or an obj.data."
    ),
]
CellsOption = Annotated[
    str | None,
    typer.Option(
        metavar="N,N,N...",
        help="How many cells droplets of each class have, such as 0,1,2+: counts are compared with "
        "a Poisson distribution.",
    ),
]
DarkOption = Annotated[
    bool, typer.Option("--dark", help="Droplets are darker than their surroundings.")
]
NormaliseOption = Annotated[
    bool | None,
    typer.Option(
        "--normalise/--as-it-is",
        help="Show the network grey frames, of the best channel, faint ones stretched; default: "
        "the bundled model.",
    ),
]
LevelsOption = Annotated[
    tuple[float, float] | None,
    typer.Option(
        metavar="LOW HIGH",
        help="Grey levels that are black and white, of more than 8 bits; default: those in use.",
    ),
]
ChannelOption = Annotated[
    int | None, typer.Option(min=0, help="Channel of a stack with several, from 0.")
]
RenumberOption = Annotated[
    bool,
    typer.Option("--renumber", help="Count the images of a numbered sequence with holes 0, 1, 2."),
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Go on with a run of the same that was ended too early.")
]
ReconnectOption = Annotated[
    float,
    typer.Option(min=0, metavar="SECONDS", help="Wait so long for a stream that is away; 0: end."),
]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace the results of an earlier run of the same.")
]
UmPerPxOption = Annotated[
    float | None, typer.Option(help="Micrometres a pixel; default: what the file says.")
]
KnownLengthOption = Annotated[
    str | None,
    typer.Option(
        metavar="X1,Y1,X2,Y2,UM",
        help="Instead: two places in the image, px, and the micrometres between them.",
    ),
]
PixelsOnlyOption = Annotated[
    bool,
    typer.Option("--pixels-only", help="No micrometres, though the file says a pixel's size."),
]
FpsOption = Annotated[
    float | None, typer.Option(help="Frames a second when it was filmed; default: the file's.")
]


def units_from(
    um_per_px: float | None,
    known_length: str | None,
    fps: float | None = None,
    *,
    pixels_only: bool = False,
) -> Units:
    """What the options say; raises DroptrackError where they contradict each other."""
    if known_length is not None:
        if um_per_px is not None:
            raise DroptrackError("give --um-per-px or --known-length, not both")
        um_per_px = parse_known_length(known_length)
    if pixels_only and um_per_px is not None:
        raise DroptrackError("give a pixel's size or --pixels-only, not both")
    return Units(um_per_px=um_per_px, fps=fps)
