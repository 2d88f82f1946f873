"""Command: anchors that suit a data set's droplets, ``python -m droptrack.anchors``."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import read_data_file
from droptrack.network.darknet_cfg import read_cfg
from droptrack.training.anchors import suit_anchors

app = new_app()


@app.command()
@one_line_errors
def main(
    data: Annotated[Path, typer.Option(help="Data set (obj.data).")],
    cfg: Annotated[
        Path,
        typer.Option(help="Network description (.cfg), for the input size and number of anchors."),
    ],
    figure: Annotated[
        Path | None, typer.Option(help="Draw the boxes and the anchors into this file.")
    ] = None,
    write: Annotated[
        Path | None, typer.Option(help="Write a .cfg with the anchors to this file.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts of k-means.")] = 0,
) -> None:
    """Find the anchors that suit a data set's droplets best."""
    rng = np.random.default_rng(seed)
    present, found = suit_anchors(
        read_data_file(data), read_cfg(cfg), rng, figure=figure, write=write
    )
    for name, anchors in ((f"{cfg} has", present), ("found", found)):
        number = len(anchors.sizes)
        typer.echo(f"{name}: mean IoU {anchors.mean_iou:.4f} with the best of {number} anchors")
    typer.echo(f"anchors={found.option()}")


if __name__ == "__main__":
    app()
