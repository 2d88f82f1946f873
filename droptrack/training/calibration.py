"""Calibrate a network for 8 bits: prune it, measure its ranges, check the cost in mAP."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from droptrack.data.arrays import Float32s
from droptrack.data.darknet_dataset import DataSet, read_image
from droptrack.data.degradation import degrade
from droptrack.data.frames import Frame
from droptrack.detection.detector import Detector, Engine
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import MAX_IOU, MIN_SCORE
from droptrack.evaluation.network_scores import (
    LabelledImage,
    one_by_one,
    read_labelled,
    score_detections,
)
from droptrack.network.darknet_cfg import Cfg
from droptrack.network.darknet_weights import Weights, read_weights
from droptrack.network.pruning import (
    NO_PRUNING,
    Moments,
    Pruning,
    choose_pruning,
    pruned,
    readers,
)
from droptrack.network.quantisation import (
    MAX_LOSS,
    Calibration,
    merge_ranges,
    quantised_layers,
    sha256_of,
    write_calibration,
)
from droptrack.progress import with_progress

PRUNING_ERROR = 2e-4  # docs/performance.md
MAX_LOSSES = (MAX_LOSS, 0.01)  # of mAP, on images as they are and degraded; above, prune less
TRIES = 3  # errors to prune for, before nothing is pruned
PRUNED_LESS = 4  # how much smaller the error is at the next try


def calibrate(
    data: DataSet,
    cfg: Cfg,
    weights: Path,
    *,
    images: int = 200,
    checked: int = 300,
    error: float = PRUNING_ERROR,
) -> tuple[Path, Calibration]:
    """Prune a network, measure the ranges that int8 needs, check the cost in mAP, and keep it.

    Ranges come from the first `images` training images, mAPs from the first `checked` validation
    images; `error` is what pruning may change (`choose_pruning`), 0 for no pruning. Where int8
    costs more than MAX_LOSSES, less is pruned. Returns the file written. Raises DroptrackError
    where OpenVINO is not installed, and where int8 costs more than MAX_LOSS without pruning, too.
    """
    try:
        from droptrack.detection.engines.openvino import OpenVinoEngine, output_ranges
    except ImportError:
        raise DroptrackError("calibrating needs: pip install 'droptrack[openvino]'") from None
    values = read_weights(weights, cfg)
    train, valid = data.train[:images], data.valid[:checked]
    map_fp32 = mean_average_precisions(OpenVinoEngine(cfg, values, "fp32", MIN_SCORE), valid)
    for pruning in prunings(cfg, values, train, error):
        smaller = pruned(cfg, values, pruning)
        layers = quantised_layers(cfg)
        ranges = merge_ranges(cfg, output_ranges(*smaller, layers, _frames(train, "ranges")))
        engine = OpenVinoEngine(*smaller, "int8", MIN_SCORE, ranges)
        calibration = Calibration(
            weights_sha256=sha256_of(weights),
            width=cfg.width,
            height=cfg.height,
            ranges=ranges,
            n_calibrated=len(train),
            n_checked=len(valid),
            map_fp32=map_fp32,
            map_int8=mean_average_precisions(engine, valid),
            pruning=pruning,
        )
        losses = zip(calibration.losses, MAX_LOSSES, strict=True)
        if all(loss <= allowed for loss, allowed in losses):
            break
    return write_calibration(weights, cfg, calibration), calibration


def mean_average_precisions(engine: Engine, images: Sequence[Path]) -> tuple[float, float]:
    """mAP@0.50 on images of a data set as they are, and degraded."""
    detect = one_by_one(Detector(engine, MIN_SCORE, MAX_IOU, greedy=True))

    def mean(labelled: Iterable[LabelledImage]) -> float:
        counted = with_progress(labelled, len(images), engine.name, "images")
        return score_detections(detect, counted).average_precision

    return mean(read_labelled(images)), mean(_degraded(read_labelled(images)))


def _degraded(labelled: Iterable[LabelledImage]) -> Iterator[LabelledImage]:
    """The same images degraded, each time in the same way."""
    rng = np.random.default_rng(0)
    for image, ground_truth in labelled:
        yield degrade(image, rng), ground_truth


def _frames(paths: Sequence[Path], stage: str) -> Iterator[Frame]:
    """Each image as it is, then degraded, with a progress bar."""
    rng = np.random.default_rng(0)
    for path in with_progress(paths, len(paths), stage, "images"):
        frame = read_image(path)
        yield frame
        yield degrade(frame, rng)


def prunings(cfg: Cfg, weights: Weights, images: Sequence[Path], error: float) -> Iterator[Pruning]:
    """The pruning for an error, for a quarter of it, for a sixteenth of it, and no pruning."""
    from droptrack.network.onnx_layers import folded_convolutions

    if error:
        kernels = {i: kernel for i, (kernel, _) in folded_convolutions(cfg, weights).items()}
        moments = measure_moments(cfg, weights, kernels, _frames(images, "channels"))
        for divided in range(TRIES):
            yield choose_pruning(cfg, kernels, moments, error / PRUNED_LESS**divided)
    yield NO_PRUNING


def measure_moments(
    cfg: Cfg, weights: Weights, kernels: Mapping[int, Float32s], frames: Iterable[Frame]
) -> dict[int, Moments]:
    """Moments of what each of the `pruning.readers` reads, over frames, by layer.

    `kernels` (outputs, inputs, h, w) of the convolutions, by layer: those of 1 x 1 have no border.
    """
    from droptrack.detection.engines.openvino import layer_outputs

    moments = {i: Moments(centred=kernels[i].shape[2] == 1) for i in readers(cfg)}
    before = [reader - 1 for reader in moments]
    for outputs in layer_outputs(cfg, weights, before, frames):
        for reader, moment in moments.items():
            moment.add(outputs[reader - 1])
    return moments
