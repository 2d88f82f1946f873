"""How good a network is on a list of labelled images."""

from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from droptrack.data.darknet_dataset import read_ground_truth, read_image
from droptrack.data.report import Report, Value
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.evaluation.average_precision import (
    LEAST_SCORE,
    MAX_IOU,
    Pair,
    average_precision,
    coco_average_precision,
)
from droptrack.network.darknet_cfg import Cfg


def darknet_detector(
    cfg: Cfg,
    weights: Path,
    *,
    backend: Backend = Backend.opencv,
    precision: Precision = Precision.fp32,
    dark: bool = False,
) -> Detector:
    """A detector whose detections are those Darknet's mAP is computed from; `dark`: `Detector`."""
    network = Network(cfg, weights, LEAST_SCORE, MAX_IOU, dark=dark, greedy=True)
    return choose_detector(network, backend, precision)


def detect_images(detector: Detector, images: Sequence[Path]) -> Iterator[Pair]:
    """What is found on each image, and the truth."""
    for path in images:
        image = read_image(path)
        height, width = image.shape[:2]
        yield detector.detect([image])[0], read_ground_truth(path, width, height)


def mean_ap(cfg: Cfg, weights: Path, images: Sequence[Path]) -> float:
    """mAP@0.50 of weights by Darknet's definition."""
    found = detect_images(darknet_detector(cfg, weights), images)
    return average_precision(found).average_precision


def network_report(pairs: Mapping[Path, Pair], scenes: Mapping[Path, str]) -> Report:
    """Precision on images, in all and for each scene, by Darknet's definition and by COCO's."""
    by_scene: dict[str, list[Pair]] = {}
    for path, pair in pairs.items():
        if path in scenes:
            by_scene.setdefault(scenes[path], []).append(pair)
    rows = [{"scene": scene, **_scores(mine)} for scene, mine in sorted(by_scene.items())]
    return Report("Scenes", {}, _scores(list(pairs.values())), rows)


def _scores(pairs: Sequence[Pair]) -> dict[str, Value]:
    result = average_precision(pairs)
    coco = coco_average_precision(pairs) if find_spec("hotcoco") else (float("nan"),) * 2
    return {
        "n_images": len(pairs),
        "n_droplets": result.n_truths,
        "map_50": result.average_precision,
        "precision": result.precision,
        "recall": result.recall,
        "f1": result.f1,
        "average_iou": result.average_iou,
        "coco_ap_50_95": coco[0],
        "coco_ap_50": coco[1],
    }
