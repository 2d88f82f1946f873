"""Command: Darknet networks as ONNX models, ``python -m droptrack.export``."""

from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.network.bundled import find_network
from droptrack.network.darknet_weights import read_weights
from droptrack.options import CfgOption, SizeOption

app = new_app()


@app.command()
@one_line_errors
def main(
    weights: Annotated[
        Path | None, typer.Argument(help="Darknet weights (.weights); default: the bundled model.")
    ] = None,
    cfg: CfgOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="File to write; default: the weights' name with .onnx, in this folder."),
    ] = None,
    size: SizeOption = None,
    decode: Annotated[
        bool,
        typer.Option("--decode", help="Decode in the model: boxes, objectness, probabilities."),
    ] = False,
) -> None:
    """Write a network as an ONNX model, which nearly every inference engine reads."""
    from droptrack.network.onnx_export import export_onnx

    network, path = find_network(weights, cfg, size)
    out = out or Path(f"{path.stem}.onnx")
    outputs = ", ".join(export_onnx(out, network, read_weights(path, network), decode=decode))
    typer.echo(f"{out}: images (batch, 3, {network.height}, {network.width}) -> {outputs}")


if __name__ == "__main__":
    app()
