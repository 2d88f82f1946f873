"""How good a network is on labelled images: the one way from detections to a mAP."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from droptrack.data.darknet_dataset import DataSet, read_ground_truth, read_image, read_scenes
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.data.normalisation import Normalisation
from droptrack.data.report import Report, Value
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.evaluation.average_precision import (
    MAX_IOU,
    MIN_SCORE,
    OPERATING_SCORE,
    DetectionScores,
    Pair,
    average_precision,
    coco_average_precision,
)
from droptrack.network.darknet_cfg import Cfg
from droptrack.network.quantisation import sha256_of
from droptrack.progress import with_progress

Detect = Callable[[Frame], Detections]  # the detections of one image
LabelledImage = tuple[Frame, Detections]  # an image, and its ground truth


def darknet_detector(
    cfg: Cfg,
    weights: Path,
    *,
    backend: Backend = Backend.opencv,
    precision: Precision = Precision.fp32,
    dark: bool = False,
) -> Detector:
    """A detector whose detections are those Darknet's mAP is computed from.

    `dark`: the droplets are darker than their background.
    """
    network = Network(
        cfg,
        weights,
        threshold=MIN_SCORE,
        max_iou=MAX_IOU,
        greedy=True,
        normalisation=Normalisation(dark=dark),
    )
    return choose_detector(network, backend, precision)


def one_by_one(detector: Detector) -> Detect:
    """A detector as a function of a single image."""
    return lambda image: detector.detect([image])[0]


def read_labelled(images: Iterable[Path]) -> Iterator[LabelledImage]:
    """Images of a data set with their ground truth, in px."""
    for path in images:
        image = read_image(path)
        height, width = image.shape[:2]
        yield image, read_ground_truth(path, width, height)


def detect_labelled(detect: Detect, labelled: Iterable[LabelledImage]) -> Iterator[Pair]:
    """What is found on each labelled image, and its ground truth."""
    for image, ground_truth in labelled:
        yield detect(image), ground_truth


def score_detections(detect: Detect, labelled: Iterable[LabelledImage]) -> DetectionScores:
    """Average precision of detections on labelled images, by Darknet's definition."""
    return average_precision(detect_labelled(detect, labelled))


def mean_average_precision(cfg: Cfg, weights: Path, images: Sequence[Path]) -> float:
    """mAP@0.50 of weights on images of a data set, by Darknet's definition, with any engine."""
    detect = one_by_one(darknet_detector(cfg, weights, backend=Backend.auto))
    return score_detections(detect, read_labelled(images)).average_precision


def evaluate_network(
    data: DataSet,
    cfg: Cfg,
    weights: Path,
    *,
    images: int = 0,
    backend: Backend = Backend.opencv,
    precision: Precision = Precision.fp32,
    dark: bool = False,
) -> Report:
    """How good weights are on the first `images` validation images of a data set; 0: on all.

    The report has a row for each scene. `backend`, `precision`: what runs the network and what it
    computes in; `dark`: the droplets are darker than their background. Raises DroptrackError for
    files that are missing or cannot be understood, and where the engine does not work.
    """
    detector = darknet_detector(cfg, weights, backend=backend, precision=precision, dark=dark)
    listing = data.valid[:images] if images else data.valid
    labelled = with_progress(read_labelled(listing), len(listing), weights.name, "images")
    pairs = dict(zip(listing, detect_labelled(one_by_one(detector), labelled), strict=True))
    settings: dict[str, Value] = {
        "network": f"{cfg.path}, {weights}",
        "weights_sha256": sha256_of(weights),
        "data": str(data.path),
        "engine": detector.engine.name,
        "least_score": MIN_SCORE,
        "max_iou": MAX_IOU,
        "dark": dark,
        "score_of_precision_recall_f1_iou": OPERATING_SCORE,
    }
    return network_report(pairs, read_scenes(data), settings, data.names)


def network_report(
    pairs: Mapping[Path, Pair],
    scenes: Mapping[Path, str],
    settings: Mapping[str, Value],
    names: Sequence[str] = (),
) -> Report:
    """Precision on images, in all and for each scene, by Darknet's definition and by COCO's.

    And for each class, where `names` has several.
    """
    by_scene: dict[str, list[Pair]] = {}
    for path, pair in pairs.items():
        if path in scenes:
            by_scene.setdefault(scenes[path], []).append(pair)
    rows = [{"scene": scene, **_scores(mine)} for scene, mine in sorted(by_scene.items())]
    return Report("Scenes", settings, _scores(list(pairs.values()), names), rows)


def _scores(pairs: Sequence[Pair], names: Sequence[str] = ()) -> dict[str, Value]:
    result = average_precision(pairs)
    coco = coco_average_precision(pairs) if find_spec("hotcoco") else (float("nan"),) * 2
    of_classes: dict[str, Value] = {}
    if len(names) > 1:
        of_classes["ap_50_of_class"] = [
            f"{names[k] if k < len(names) else k} {area:.4f}"
            for k, area in sorted(result.of_classes.items())
        ]
    return {
        "n_images": len(pairs),
        "n_droplets": result.n_ground_truths,
        "map_50": result.average_precision,
        **of_classes,
        "precision": result.precision,
        "recall": result.recall,
        "f1": result.f1,
        "average_iou": result.average_iou,
        "coco_ap_50_95": coco[0],
        "coco_ap_50": coco[1],
    }
