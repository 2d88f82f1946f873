"""Command: prepare a network for 8 bits, ``python -m droptrack.calibrate``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack import DroptrackError
from droptrack.command_line import new_app, one_line_errors, progress_bar
from droptrack.darknet_files import read_cfg, read_weights, resized
from droptrack.dataset import read_data_file, read_image, read_truth
from droptrack.detections import Detections
from droptrack.detector import Detector, Engine
from droptrack.metrics import average_precision
from droptrack.network_choice import SHIPPED_WEIGHTS, find_cfg, parse_size
from droptrack.quantisation import (
    Calibration,
    joined,
    quantised_layers,
    sha256_of,
    write_calibration,
)

# as Darknet measures mAP
LEAST_SCORE = 0.005
MAX_IOU = 0.45

app = new_app()


@app.command()
@one_line_errors
def main(
    data: Annotated[
        Path, typer.Option(help="obj.data: ranges from its training pictures, mAP from the others.")
    ],
    weights: Annotated[
        Path | None, typer.Option(help="Darknet weights; without, the network that ships.")
    ] = None,
    cfg: Annotated[
        Path | None, typer.Option(help="Network description; without, by the weights' name.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Input, px; without, the cfg's.")
    ] = None,
    images: Annotated[int, typer.Option(min=1, help="Training pictures to measure on.")] = 200,
    checked: Annotated[int, typer.Option(min=1, help="Validation pictures for the mAP.")] = 500,
) -> None:
    """Measure what 8 bits need, check that they cost at most 0.2 points of mAP, keep it."""
    try:
        from droptrack.engines.openvino import OpenVinoEngine, output_ranges
    except ImportError:
        raise DroptrackError("calibrating needs: pip install 'droptrack[openvino]'") from None
    weights = weights or SHIPPED_WEIGHTS
    network = read_cfg(cfg or find_cfg(weights))
    if size is not None:
        network = resized(network, *parse_size(size))
    values = read_weights(weights, network)
    pictures = read_data_file(data)
    train, valid = pictures.train[:images], pictures.valid[:checked]
    with progress_bar("pictures") as progress:
        frames = map(read_image, progress.track(train, description="ranges", total=len(train)))
        ranges = output_ranges(network, values, quantised_layers(network), frames)
    ranges = joined(network, ranges)
    maps = [
        mean_average_precision(engine, valid, len(pictures.names))
        for engine in (
            OpenVinoEngine(network, values, "fp32", LEAST_SCORE),
            OpenVinoEngine(network, values, "int8", LEAST_SCORE, ranges),
        )
    ]
    calibration = Calibration(
        sha256_of(weights),
        network.width,
        network.height,
        ranges,
        len(train),
        len(valid),
        *maps,
    )
    path = write_calibration(weights, network, calibration)
    typer.echo(f"{path}: mAP@0.50 {maps[1]:.4f} in int8, {maps[0]:.4f} in fp32")


def mean_average_precision(engine: Engine, images: Sequence[Path], n_classes: int) -> float:
    """MAP@0.50 over the classes, by Darknet's definition, on images with labels beside them."""
    detector = Detector(engine, LEAST_SCORE, MAX_IOU)
    found = []
    with progress_bar("pictures") as progress:
        for path in progress.track(images, description=engine.name, total=len(images)):
            frame = read_image(path)
            truth = read_truth(path, frame.shape[1], frame.shape[0])
            found.append((detector.detect([frame])[0], truth))
    by_class = [
        average_precision((of_class(ours, i), of_class(truth, i)) for ours, truth in found)
        for i in range(n_classes)
    ]
    return float(np.nanmean([precision.average_precision for precision in by_class]))


def of_class(detections: Detections, class_id: int) -> Detections:
    """The detections of one class."""
    return detections[detections.class_ids == class_id]


if __name__ == "__main__":
    app()
