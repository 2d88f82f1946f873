"""Command: how good trajectories or a network are, ``python -m droptrack.evaluate``."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import also_call, new_app, one_line_errors, refuse_given
from droptrack.data.darknet_dataset import read_data_file
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.errors import DroptrackError
from droptrack.evaluation.network_scores import evaluate_network
from droptrack.evaluation.trajectories import OTHER_UNITS, evaluate
from droptrack.network.bundled import find_network
from droptrack.options import BackendOption, CfgOption, PrecisionOption, WeightsOption

OF_NETWORKS = ("weights", "cfg", "images", "backend", "precision", "dark")

app = new_app()
also_call(__name__, evaluate)


@app.command()
@one_line_errors
def main(
    context: typer.Context,
    ground_truth: Annotated[
        Path | None,
        typer.Argument(metavar="GROUND_TRUTH.csv", help="Trajectories of all droplets."),
    ] = None,
    result: Annotated[
        Path | None,
        typer.Argument(metavar="TRAJECTORIES.csv", help="The trajectories to evaluate."),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Instead: a data set (obj.data) on which to evaluate a network."),
    ] = None,
    weights: WeightsOption = None,
    cfg: CfgOption = None,
    images: Annotated[
        int, typer.Option(min=0, help="With --data: use the first N validation images; 0: all.")
    ] = 0,
    backend: BackendOption = Backend.opencv,
    precision: PrecisionOption = Precision.fp32,
    dark: Annotated[
        bool,
        typer.Option("--dark", help="With --data: the droplets are darker than the background."),
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Write the report to this file, too.")] = None,
) -> None:
    """Compare trajectories with the ground truth, or a network's detections with labels.

    Of trajectories: errors, identity switches, missed and false ones. Of a network: mAP@0.50 as
    Darknet computes it, precision, recall, F1 and mean IoU above a score of 0.25, COCO's AP.
    """
    if data is not None and ground_truth is None:
        report = evaluate_network(
            read_data_file(data),
            *find_network(weights, cfg),
            images=images,
            backend=backend,
            precision=precision,
            dark=dark,
        )
        report.print()
        if find_spec("hotcoco") is None:
            typer.echo("COCO's AP needs hotcoco: pip install 'droptrack[train]'", err=True)
    elif data is None and ground_truth is not None and result is not None:
        refuse_given(context, OF_NETWORKS, "is of networks: it needs --data")
        report = evaluate(ground_truth, result)
        report.print(without=OTHER_UNITS, all_in=json or "the file of --json FILE")
        if json is None:
            typer.echo("each droplet's errors in all units: --json FILE")
    else:
        raise DroptrackError("give GROUND_TRUTH.csv and TRAJECTORIES.csv, or --data obj.data")
    if json is not None:
        report.write_json(json)


if __name__ == "__main__":
    app()
