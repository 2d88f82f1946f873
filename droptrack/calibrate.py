"""Command: prepare a network for 8 bits, ``python -m droptrack.calibrate``."""

from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import read_data_file
from droptrack.network.bundled import find_network
from droptrack.options import CfgOption, WeightsOption
from droptrack.training.calibration import PRUNING_ERROR, calibrate

app = new_app()


@app.command()
@one_line_errors
def main(
    data: Annotated[
        Path, typer.Option(help="Data set (obj.data): ranges from train, mAP from valid images.")
    ],
    weights: WeightsOption = None,
    cfg: CfgOption = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="WxH", help="For this input only, px; default: for inputs of any size."
        ),
    ] = None,
    images: Annotated[
        int, typer.Option(min=1, help="Measure the ranges on the first N training images.")
    ] = 200,
    checked: Annotated[
        int, typer.Option(min=1, help="Measure the mAP on the first N validation images.")
    ] = 300,
    prune: Annotated[
        float,
        typer.Option(min=0, max=1, help="Relative error that pruning may cause; 0: no pruning."),
    ] = PRUNING_ERROR,
) -> None:
    """Prune a network, measure what 8 bits need, check that it costs little, and keep it.

    It costs at most 0.2 points of mAP, and 1 point on degraded images; else less is pruned. Without
    pruning, a cost of more than 0.2 points is refused.
    """
    network, path = find_network(weights, cfg, size)
    written, calibration = calibrate(
        read_data_file(data),
        network,
        path,
        any_size=size is None,
        images=images,
        checked=checked,
        error=prune,
    )
    for layer, channels in calibration.pruning.kept.items():
        filters = network.layers[layer].integer("filters")
        typer.echo(f"layer {layer}: {len(channels)} of {filters} channels kept")
    (fp32, fp32_degraded), (int8, int8_degraded) = calibration.map_fp32, calibration.map_int8
    typer.echo(f"{written}: mAP@0.50 {int8:.4f} in int8, {fp32:.4f} in fp32")
    typer.echo(f"on degraded images {int8_degraded:.4f} and {fp32_degraded:.4f}")


if __name__ == "__main__":
    app()
