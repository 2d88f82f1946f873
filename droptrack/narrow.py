"""Command: write a network with fewer filters, ``python -m droptrack.narrow``."""

from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import read_data_file
from droptrack.network.bundled import find_network
from droptrack.options import CfgOption, WeightsOption
from droptrack.training.calibration import PRUNING_ERROR
from droptrack.training.narrowing import narrow, parse_filters

app = new_app()


@app.command()
@one_line_errors
def main(
    data: Annotated[
        Path,
        typer.Option(help="Data set (obj.data): its training images show which filters count."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the .cfg and the .weights.")],
    weights: WeightsOption = None,
    cfg: CfgOption = None,
    filters: Annotated[
        str | None,
        typer.Option(
            metavar="LAYER=N,...", help="How many filters layers have, counted from 0; others: all."
        ),
    ] = None,
    error: Annotated[
        float,
        typer.Option(min=0, max=1, help="Without --filters: relative error that may be caused."),
    ] = PRUNING_ERROR,
    images: Annotated[int, typer.Option(min=1, help="Look at the first N training images.")] = 200,
) -> None:
    """Write a network with fewer filters, which Darknet reads, too, to train it on."""
    network, path = find_network(weights, cfg)
    wanted = None if filters is None else parse_filters(filters)
    written, pruning = narrow(
        read_data_file(data), network, path, out, filters=wanted, error=error, images=images
    )
    for layer, channels in pruning.kept.items():
        had = network.layers[layer].integer("filters")
        typer.echo(f"layer {layer}: {len(channels)} of {had} filters")
    typer.echo(f"{written}: train it on, with --cfg {written.with_suffix('.cfg')}")


if __name__ == "__main__":
    app()
