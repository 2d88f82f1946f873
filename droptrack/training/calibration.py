"""Calibrate a network for 8 bits: prune it, measure its ranges, check the cost in mAP."""

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.arrays import Float32s
from droptrack.data.darknet_dataset import DataSet, read_image
from droptrack.data.degradation import degrade
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.detection.detector import Detector, Engine
from droptrack.detection.scale import STRIDE
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import MAX_IOU, MIN_SCORE, Pair, average_precision
from droptrack.evaluation.network_scores import LabelledImage, one_by_one, read_labelled
from droptrack.network.darknet_cfg import Cfg, resized
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
    Range,
    least_error_range,
    merge_ranges,
    quantised_layers,
    sha256_of,
    write_calibration,
)
from droptrack.progress import with_progress

PRUNING_ERROR = 2e-4  # docs/performance.md
MAX_LOSSES = (MAX_LOSS, 0.01)  # of mAP, on images as they are and degraded; above, prune less
CHECKED_SIZES = (0.5, 1.0, 1.4)  # of the cfg's input, for a calibration that holds for any
KNOWN_PX = (8.0, 240.0)  # sizes of droplets in the input that count at these sizes
ZOOMS = (0.35, 1.6)  # that images are shown at for it
BINS = 4096  # of a layer's outputs, for its range
TRIES = 3  # errors to prune for, before nothing is pruned
PRUNED_LESS = 4  # how much smaller the error is at the next try


def calibrate(
    data: DataSet,
    cfg: Cfg,
    weights: Path,
    *,
    any_size: bool = False,
    images: int = 200,
    checked: int = 300,
    error: float = PRUNING_ERROR,
) -> tuple[Path, Calibration]:
    """Prune a network, measure the ranges that int8 needs, check the cost in mAP, and keep it.

    It holds for the cfg's input size; with `any_size` for others, too: then images are also shown
    larger and smaller, and the cost is the mean of that at CHECKED_SIZES times the cfg's, of
    droplets that the input shows with KNOWN_PX: others are for other scales. Ranges come from the
    first `images` training images, mAPs from the first `checked` validation images; `error` is what
    pruning may change (`choose_pruning`), 0 for no pruning. Where int8 costs more than MAX_LOSSES,
    less is pruned. Returns the file written. Raises DroptrackError where OpenVINO is not installed,
    and where int8 costs more than MAX_LOSS without pruning, too.
    """
    try:
        from droptrack.detection.engines.openvino import OpenVinoEngine
    except ImportError:
        raise DroptrackError("calibrating needs: pip install 'droptrack[openvino]'") from None
    values = read_weights(weights, cfg)
    train, valid = data.train[:images], data.valid[:checked]
    cfgs = _checked_sizes(cfg) if any_size else [cfg]

    def maps(engines: Iterable[Engine]) -> tuple[float, float]:
        shown = [(one.width, one.height) if any_size else None for one in cfgs]
        pairs = zip(engines, shown, strict=True)
        return _mean([mean_average_precisions(engine, valid, size) for engine, size in pairs])

    map_fp32 = maps(OpenVinoEngine(one, values, "fp32", MIN_SCORE) for one in cfgs)
    frames = functools.partial(calibration_frames, train, zoomed=any_size)
    for pruning in prunings(cfg, values, frames, error):
        smaller, kept = pruned(cfg, values, pruning)
        ranges = merge_ranges(cfg, measure_ranges(smaller, kept, quantised_layers(cfg), frames))
        engines = (
            OpenVinoEngine(resized(smaller, one.width, one.height), kept, "int8", MIN_SCORE, ranges)
            for one in cfgs
        )
        calibration = Calibration(
            weights_sha256=sha256_of(weights),
            width=0 if any_size else cfg.width,
            height=0 if any_size else cfg.height,
            ranges=ranges,
            n_calibrated=len(train),
            n_checked=len(valid),
            map_fp32=map_fp32,
            map_int8=maps(engines),
            pruning=pruning,
        )
        losses = zip(calibration.losses, MAX_LOSSES, strict=True)
        if all(loss <= allowed for loss, allowed in losses):
            break
    return write_calibration(weights, calibration), calibration


def _checked_sizes(cfg: Cfg) -> list[Cfg]:
    return [
        resized(cfg, *(STRIDE * round(side * factor / STRIDE) for side in (cfg.width, cfg.height)))
        for factor in CHECKED_SIZES
    ]


def _mean(maps: Sequence[tuple[float, float]]) -> tuple[float, float]:
    plain, degraded = np.mean(maps, axis=0).tolist()
    return plain, degraded


def mean_average_precisions(
    engine: Engine, images: Sequence[Path], size: tuple[int, int] | None = None
) -> tuple[float, float]:
    """mAP@0.50 on images of a data set as they are, and degraded.

    `size` (width, height) px of the input: only of droplets that it shows with KNOWN_PX.
    """
    detect = one_by_one(Detector(engine, MIN_SCORE, MAX_IOU, greedy=True))

    def pairs(labelled: Iterable[LabelledImage]) -> Iterator[Pair]:
        for image, ground_truth in labelled:
            found = detect(image)
            if size is None:
                yield found, ground_truth
            else:
                scale = np.sqrt(np.prod(size) / np.prod(image.shape[:2]))
                yield _known(found, scale), _known(ground_truth, scale)

    def mean(labelled: Iterable[LabelledImage]) -> float:
        counted = with_progress(labelled, len(images), engine.name, "images")
        return average_precision(pairs(counted)).average_precision

    return mean(read_labelled(images)), mean(_degraded(read_labelled(images)))


def _known(droplets: Detections, scale: float) -> Detections:
    """Those of the sizes that count, where the input has `scale` px for a px of the image."""
    sides = np.sqrt(droplets.boxes[:, 2:].prod(axis=1)) * scale
    return droplets[(sides >= KNOWN_PX[0]) & (sides <= KNOWN_PX[1])]


def _degraded(labelled: Iterable[LabelledImage]) -> Iterator[LabelledImage]:
    """The same images degraded, each time in the same way."""
    rng = np.random.default_rng(0)
    for image, ground_truth in labelled:
        yield degrade(image, rng), ground_truth


def calibration_frames(paths: Sequence[Path], stage: str, *, zoomed: bool) -> Iterator[Frame]:
    """Each image as it is, then degraded, with a progress bar.

    `zoomed`: every other one is shown larger or smaller, as an input of another size shows it.
    """
    rng = np.random.default_rng(0)
    for number, path in enumerate(with_progress(paths, len(paths), stage, "images")):
        frame = read_image(path)
        if zoomed and number % 2:
            frame = _zoomed(frame, float(np.exp(rng.uniform(*np.log(ZOOMS)))))
        yield frame
        yield degrade(frame, rng)


def _zoomed(frame: Frame, factor: float) -> Frame:
    """A frame as large as before, of the middle of it enlarged, or of itself, smaller, repeated."""
    height, width = frame.shape[:2]
    if factor > 1:
        h, w = round(height / factor), round(width / factor)
        top, left = (height - h) // 2, (width - w) // 2
        part = frame[top : top + h, left : left + w]
        return np.asarray(cv2.resize(part, (width, height)), np.uint8)
    small = cv2.resize(frame, None, fx=factor, fy=factor)
    below, right = height - small.shape[0], width - small.shape[1]
    repeated = np.pad(small, ((0, below), (0, right), (0, 0)), mode="symmetric")
    return np.asarray(repeated, np.uint8)


def prunings(
    cfg: Cfg, weights: Weights, frames: Callable[[str], Iterable[Frame]], error: float
) -> Iterator[Pruning]:
    """The pruning for an error, for a quarter of it, for a sixteenth of it, and no pruning.

    `frames`: shows the images that tell which channels matter, under the name of a stage.
    """
    from droptrack.network.onnx_layers import folded_convolutions

    if error:
        kernels = {i: kernel for i, (kernel, _) in folded_convolutions(cfg, weights).items()}
        moments = measure_moments(cfg, weights, kernels, frames("channels"))
        for divided in range(TRIES):
            yield choose_pruning(cfg, kernels, moments, error / PRUNED_LESS**divided)
    yield NO_PRUNING


def measure_ranges(
    cfg: Cfg,
    weights: Weights,
    layers: Sequence[int],
    frames: Callable[[str], Iterable[Frame]],
) -> dict[int, Range]:
    """The ranges in which 8 bits show best what layers put out over frames, by layer.

    `frames`: shows the same images twice, under the names of two stages.
    """
    from droptrack.detection.engines.openvino import layer_outputs, output_ranges

    limits = output_ranges(cfg, weights, layers, frames("limits"))
    counts = {layer: np.zeros(BINS) for layer in layers}
    for outputs in layer_outputs(cfg, weights, layers, frames("ranges")):
        for layer, values in outputs.items():
            counts[layer] += np.histogram(values, BINS, limits[layer])[0]
    return {layer: least_error_range(counts[layer], limits[layer]) for layer in layers}


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
