"""How good a network is on a list of labelled images."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from droptrack.darknet_files import Cfg
from droptrack.dataset import read_image, read_truth
from droptrack.detections import Detections
from droptrack.detector import Detector
from droptrack.engines.opencv_dnn import OpenCvDetector
from droptrack.metrics import average_precision

# what Darknet's `detector map` counts
LEAST_SCORE, MAX_IOU = 0.005, 0.45


def darknet_detector(cfg: Cfg, weights: Path) -> OpenCvDetector:
    """A detector whose detections are those Darknet's mAP is computed from."""
    return OpenCvDetector(cfg, weights, "auto", LEAST_SCORE, MAX_IOU)


def detect_images(
    detector: Detector, images: Sequence[Path]
) -> Iterator[tuple[Detections, Detections]]:
    """What is found on each image, and the truth."""
    for path in images:
        image = read_image(path)
        height, width = image.shape[:2]
        yield detector.detect([image])[0], read_truth(path, width, height)


def mean_ap(cfg: Cfg, weights: Path, images: Sequence[Path]) -> float:
    """mAP@0.50 of weights by Darknet's definition."""
    found = detect_images(darknet_detector(cfg, weights), images)
    return average_precision(found).average_precision
