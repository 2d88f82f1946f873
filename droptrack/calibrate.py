"""Command: prepare a network for 8 bits, ``python -m droptrack.calibrate``."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import read_data_file, read_image, read_truth
from droptrack.data.degradation import degrade
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.detection.detector import Detector, Engine
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import LEAST_SCORE, MAX_IOU, Pair, average_precision
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg, parse_size
from droptrack.network.darknet_cfg import Cfg, read_cfg, resized
from droptrack.network.darknet_weights import Weights, read_weights
from droptrack.network.pruning import NOTHING, Moments, Pruning, choose, pruned, readers
from droptrack.network.quantisation import (
    MAX_LOSS,
    Calibration,
    joined,
    quantised_layers,
    sha256_of,
    write_calibration,
)
from droptrack.progress import progress_bar

PRUNING_ERROR = 2e-4  # docs/performance.md
MAX_LOSSES = (MAX_LOSS, 0.01)  # of mAP, as drawn and as a bad camera shows it, else:
PRUNED_LESS = 4  # how much smaller the error is at the next try

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
    checked: Annotated[int, typer.Option(min=1, help="Validation pictures for the mAP.")] = 300,
    prune: Annotated[
        float,
        typer.Option(min=0, max=1, help="Error that left out channels may cause; 0: keep all."),
    ] = PRUNING_ERROR,
) -> None:
    """Prune a network and measure what 8 bits need, check that it costs little, and keep it.

    At most 0.2 points of mAP, and a point on pictures as a bad camera shows them. Else it prunes
    less; without pruning, it refuses what costs more than 0.2 points.
    """
    try:
        from droptrack.detection.engines.openvino import OpenVinoEngine, output_ranges
    except ImportError:
        raise DroptrackError("calibrating needs: pip install 'droptrack[openvino]'") from None
    weights = weights or BUNDLED_WEIGHTS
    network = read_cfg(cfg or find_cfg(weights))
    if size is not None:
        network = resized(network, *parse_size(size))
    values = read_weights(weights, network)
    pictures = read_data_file(data)
    train, valid = pictures.train[:images], pictures.valid[:checked]
    n_classes = len(pictures.names)
    exact = OpenVinoEngine(network, values, "fp32", LEAST_SCORE)
    map_fp32 = mean_average_precision(exact, valid, n_classes)
    for pruning in prunings(network, values, train, prune):
        smaller = pruned(network, values, pruning)
        ranges = joined(
            network, output_ranges(*smaller, quantised_layers(network), frames(train, "ranges"))
        )
        engine = OpenVinoEngine(*smaller, "int8", LEAST_SCORE, ranges)
        calibration = Calibration(
            sha256_of(weights),
            network.width,
            network.height,
            ranges,
            len(train),
            len(valid),
            map_fp32,
            mean_average_precision(engine, valid, n_classes),
            pruning,
        )
        if all(loss <= most for loss, most in zip(calibration.losses, MAX_LOSSES, strict=True)):
            break
    path = write_calibration(weights, network, calibration)
    for layer, rows in pruning.kept.items():
        filters = network.layers[layer].integer("filters")
        typer.echo(f"layer {layer}: {len(rows)} of {filters} channels kept")
    (drawn, spoilt), (int8, spoilt_int8) = map_fp32, calibration.map_int8
    typer.echo(f"{path}: mAP@0.50 {int8:.4f} in int8, {drawn:.4f} in fp32")
    typer.echo(f"on spoilt pictures {spoilt_int8:.4f} and {spoilt:.4f}")


def frames(paths: Sequence[Path], stage: str) -> Iterator[Frame]:
    """Pictures, each also as a bad camera would show it, with a progress bar."""
    rng = np.random.default_rng(0)
    with progress_bar("pictures") as progress:
        for path in progress.track(paths, description=stage, total=len(paths)):
            frame = read_image(path)
            yield frame
            yield degrade(frame, rng)


def prunings(
    cfg: Cfg, weights: Weights, pictures: Sequence[Path], error: float
) -> Iterator[Pruning]:
    """What to leave out for an error, for a fourth of it, for a sixteenth, and nothing."""
    from droptrack.detection.engines.openvino import layer_outputs
    from droptrack.network.onnx_export import folded_convolutions

    if error:
        kernels = {i: kernel for i, (kernel, _) in folded_convolutions(cfg, weights).items()}
        moments = {i: Moments(centred=kernels[i].shape[2] == 1) for i in readers(cfg)}
        before = [reader - 1 for reader in moments]
        for outputs in layer_outputs(cfg, weights, before, frames(pictures, "channels")):
            for reader, moment in moments.items():
                moment.add(outputs[reader - 1])
        for divided in range(3):
            yield choose(cfg, kernels, moments, error / PRUNED_LESS**divided)
    yield NOTHING


def mean_average_precision(
    engine: Engine, images: Sequence[Path], n_classes: int
) -> tuple[float, float]:
    """MAP@0.50 over the classes, by Darknet's definition, on images with labels beside them.

    On the images as they are, and as a bad camera shows them.
    """
    detector = Detector(engine, LEAST_SCORE, MAX_IOU, greedy=True)
    found: tuple[list[Pair], list[Pair]] = [], []
    for number, frame in enumerate(frames(images, engine.name)):
        truth = read_truth(images[number // 2], frame.shape[1], frame.shape[0])
        found[number % 2].append((detector.detect([frame])[0], truth))

    def mean(pairs: list[Pair]) -> float:
        by_class = [
            average_precision((of_class(ours, i), of_class(truth, i)) for ours, truth in pairs)
            for i in range(n_classes)
        ]
        return float(np.nanmean([precision.average_precision for precision in by_class]))

    return mean(found[0]), mean(found[1])


def of_class(detections: Detections, class_id: int) -> Detections:
    """The detections of one class."""
    return detections[detections.class_ids == class_id]


if __name__ == "__main__":
    app()
