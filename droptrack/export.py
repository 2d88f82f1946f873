"""Command: Darknet networks as ONNX models, ``python -m droptrack.export``."""

from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg, parse_size
from droptrack.network.darknet_cfg import read_cfg, resized
from droptrack.network.darknet_weights import read_weights

app = new_app()


@app.command()
@one_line_errors
def main(
    weights: Annotated[
        Path | None, typer.Argument(help="Darknet weights; without, the network that ships.")
    ] = None,
    cfg: Annotated[
        Path | None, typer.Option(help="Network description; without, by the weights' name.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write; default: the weights' name, .onnx, here.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Input, px; without, the cfg's.")
    ] = None,
    decode: Annotated[
        bool, typer.Option("--decode", help="One output: boxes, objectness, probabilities.")
    ] = False,
) -> None:
    """Write a network as an ONNX model, which nearly every inference engine reads."""
    from droptrack.network.onnx_export import onnx_model, write_onnx

    weights = weights or BUNDLED_WEIGHTS
    network = read_cfg(cfg or find_cfg(weights))
    if size is not None:
        network = resized(network, *parse_size(size))
    model = onnx_model(network, read_weights(weights, network), decode=decode)
    out = out or Path(f"{weights.stem}.onnx")
    write_onnx(out, model)
    outputs = ", ".join(output.name for output in model.graph.output)
    typer.echo(f"{out}: images (batch, 3, {network.height}, {network.width}) -> {outputs}")


if __name__ == "__main__":
    app()
