"""Options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from droptrack.detection.engine_choice import Backend, Precision

WeightsOption = Annotated[
    Path | None, typer.Option(help="Darknet weights (.weights); default: the bundled model.")
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
