"""How well droplets are found on real, labelled images: ``python -m bench real DIR``.

DIR has a folder for each set, with images and Darknet's label files beside them. What counts is
said by SETS: labels at an image's edge, or of droplets that are too small, count neither way; where
only whole plugs are labelled, so do boxes in the channel's line beside them. Besides droptrack's
network, at several fixed scales, it tries what a user would pick instead, each with the best of its
settings for the set.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from bench.classical import finders
from bench.real_sequence import SEQUENCES, score_sequence
from droptrack.data.arrays import Bools, Floats, Pixels
from droptrack.data.darknet_dataset import read_ground_truth
from droptrack.data.detections import Detections, iou_matrix
from droptrack.data.frames import grey_frame
from droptrack.data.samples import N_SAMPLES, spread
from droptrack.detection.detector import Detector, Finder
from droptrack.detection.engine_choice import Network, Precision, choose_detector
from droptrack.detection.looks import STILL_LOOKS, SeveralLooks, look_factors
from droptrack.detection.pyramid import Pyramid
from droptrack.detection.scale import Canvas
from droptrack.detection.scale_choice import choose_scale
from droptrack.detection.scale_evidence import MIN_SCORE as TILE_SCORE
from droptrack.detection.scale_evidence import TILE
from droptrack.network.bundled import FOOTAGE, find_network
from droptrack.network.darknet_cfg import resized

SCALES = tuple(0.8 * 2 ** (k / 2) for k in range(-4, 4))
MIN_SCORE = 0.01
DEFAULT_SCORE = 0.4
MAX_IOU = 0.3
EDGE_PX = 2.0
SIZES = {"small": (0.0, 32.0), "middle": (32.0, 96.0), "large": (96.0, np.inf)}  # px, as COCO's
Range = tuple[float, float]
ALL_SIZES = (0.0, np.inf)


@dataclass(frozen=True, kw_only=True)
class SetRules:
    """What counts on a set of images."""

    min_iou: float = 0.5
    cut_count: bool = True  # droplets cut by the image's edge
    min_size_px: float = 0.0
    only_whole_plugs: bool = False
    complete: bool = True  # all droplets have labels, so that what is found beside them is false


SETS = {
    "foam": SetRules(cut_count=False),
    "plugs": SetRules(only_whole_plugs=True),
    "foam_channel": SetRules(),
    "bubbly": SetRules(min_size_px=8, complete=False),
}


@dataclass(frozen=True)
class LabelledImage:
    """A grey image (H, W) and its labels."""

    path: Path
    image: Pixels
    truth: Detections


@dataclass(frozen=True, kw_only=True)
class Scores:
    """What was found on a set; NaN where the set cannot tell.

    `ap50_of_sizes`: of droplets with a sqrt(w h) in the SIZES, as COCO's evaluation takes them.
    `by_centre`: share of the labels in which the centre of a box lies that is in no other's, at the
    default score: where labels are loose, an IoU judges them more than what was found.
    """

    ap50: float
    recall: float
    precision: float
    ap50_of_sizes: tuple[float, ...] = ()
    by_centre: float = np.nan

    @property
    def worth(self) -> float:
        """What the best setting has most of."""
        return self.recall if np.isnan(self.ap50) else self.ap50


def read_set(folder: Path) -> list[LabelledImage]:
    """The images of a folder that have labels, as grey levels from 0 to 255."""
    found = []
    for labels in sorted(folder.glob("*.txt")):
        paths = [path for path in labels.parent.glob(f"{labels.stem}.*") if path != labels]
        if not paths:
            continue
        image = cv2.imread(str(paths[0]), cv2.IMREAD_UNCHANGED)
        assert image is not None, paths[0]
        if image.ndim == 3:
            image = image[..., :3].mean(axis=2)
        if image.dtype == np.uint16:
            low, high = np.percentile(image, [0.1, 99.9])
            image = (image - low) * (255 / max(high - low, 1))
        grey = np.clip(image, 0, 255).astype(np.uint8)
        height, width = grey.shape
        found.append(LabelledImage(paths[0], grey, read_ground_truth(paths[0], width, height)))
    return found


def score_set(
    images: Iterable[LabelledImage], rules: SetRules, find: Callable[[Pixels], Detections]
) -> Scores:
    """AP50, and recall and precision at the default score, of what `find` gives for each image."""
    images = list(images)
    found = [find(one.image) for one in images]
    best_first = [one[np.argsort(-one.scores, kind="stable")] for one in found]
    of_sizes = (_score_sizes(images, best_first, rules, sizes).ap50 for sizes in SIZES.values())
    return replace(
        _score_sizes(images, best_first, rules, ALL_SIZES),
        ap50_of_sizes=tuple(of_sizes),
        by_centre=_by_centre(images, found, rules),
    )


def _by_centre(
    images: Sequence[LabelledImage], found: Sequence[Detections], rules: SetRules
) -> float:
    """Share of the labels that have a box of their own with its centre in them."""
    n_found = n = 0
    for one, mine in zip(images, found, strict=True):
        labels = one.truth.boxes[~_ignored(one, rules)]
        centres = mine.boxes[mine.scores >= DEFAULT_SCORE, :2]
        apart = np.abs(labels[:, None, :2] - centres[None])
        inside = csr_matrix(np.asarray((apart <= labels[:, None, 2:] / 2).all(axis=2)))
        n_found += int((maximum_bipartite_matching(inside) >= 0).sum())
        n += len(labels)
    return n_found / n if n else np.nan


def _score_sizes(
    images: Sequence[LabelledImage], found: Sequence[Detections], rules: SetRules, sizes: Range
) -> Scores:
    """Scores of detections, best first, of droplets of some sizes; others neither help nor harm."""
    lines = _channel_lines(images) if rules.only_whole_plugs else {}
    scores, hits, n = [np.zeros(0)], [np.zeros(0)], 0
    for one, mine in zip(images, found, strict=True):
        ignored = _ignored(one, rules) | ~_of_sizes(one.truth.boxes, sizes)
        hit = _hits(mine, one.truth, ignored, rules.min_iou)
        hit[(hit == 0) & ~_of_sizes(mine.boxes, sizes)] = np.nan
        if not rules.cut_count or rules.only_whole_plugs:
            hit[(hit == 0) & _cut(mine.boxes, one.image.shape)] = np.nan
        if rules.only_whole_plugs:
            line = lines[_series(one)]
            hit[(hit == 0) & _beside_plugs(mine.boxes, one.truth.boxes, line)] = np.nan
        scores.append(mine.scores)
        hits.append(hit)
        n += int((~ignored).sum())
    if not n:
        return Scores(ap50=np.nan, recall=np.nan, precision=np.nan)
    return _scores(np.concatenate(scores), np.concatenate(hits), n, complete=rules.complete)


def _of_sizes(boxes: Floats, sizes: Range) -> Bools:
    """Which boxes (N,) have a sqrt(w h) from the one size, px, to below the other."""
    side = np.sqrt(boxes[:, 2:].prod(axis=1))
    return np.asarray((side >= sizes[0]) & (side < sizes[1]))


def _scores(scores: Floats, hits: Floats, n: int, *, complete: bool) -> Scores:
    """`hits`: 1 true, 0 false, NaN where it does not count; `n` droplets are to be found."""
    counted = ~np.isnan(hits)
    scores, hits = scores[counted], hits[counted]
    order = np.argsort(-scores, kind="stable")
    found = np.cumsum(hits[order])
    precision = found / np.arange(1, len(found) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    area = float((np.diff(np.append(0, found / n)) * envelope).sum())
    sure = scores >= DEFAULT_SCORE
    return Scores(
        ap50=area if complete else np.nan,
        recall=float(hits[sure].sum() / n),
        precision=float(hits[sure].mean()) if complete and sure.any() else np.nan,
    )


def _hits(found: Detections, truth: Detections, ignored: Bools, min_iou: float) -> Floats:
    """Of detections, best first: 1 where one finds a label that none before did, NaN if ignored."""
    hits = np.zeros(len(found))
    if not len(truth) or not len(found):
        return hits
    iou = iou_matrix(found.boxes, truth.boxes)
    for i in range(len(found)):
        best = int(iou[i].argmax())
        if iou[i, best] >= min_iou:
            iou[:, best] = -1
            hits[i] = np.nan if ignored[best] else 1
    return hits


def _ignored(one: LabelledImage, rules: SetRules) -> Bools:
    boxes = one.truth.boxes
    ignored = boxes[:, 2:].max(axis=1, initial=0) < rules.min_size_px
    cut = _cut(boxes, one.image.shape)
    return np.asarray(ignored if rules.cut_count else ignored | cut)


def _cut(boxes: Floats, shape: tuple[int, ...]) -> Bools:
    """Boxes (N,) that touch the image's edge."""
    low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
    size = np.array(shape[1::-1])
    return np.asarray((low < EDGE_PX).any(axis=1) | (high > size - EDGE_PX).any(axis=1))


def _series(one: LabelledImage) -> tuple[str, tuple[int, ...]]:
    """Images of one video have names that begin alike, and one size."""
    return one.path.stem.split("_")[0], one.image.shape


def _channel_lines(images: Iterable[LabelledImage]) -> dict[tuple[str, tuple[int, ...]], Floats]:
    """The typical box (4,) of each series: the channel is where its plugs are."""
    series: dict[tuple[str, tuple[int, ...]], list[Floats]] = {}
    for one in images:
        series.setdefault(_series(one), []).append(one.truth.boxes)
    return {name: np.median(np.concatenate(boxes), axis=0) for name, boxes in series.items()}


def _beside_plugs(boxes: Floats, plugs: Floats, line: Floats) -> Bools:
    """Boxes (N,) in the channel's line that are as large as a part of a plug, and beside them all.

    They are plugs cut by the field stop, or about to be formed.
    """
    inside = np.zeros(len(boxes), bool)
    for plug in plugs:
        low = np.maximum(boxes[:, :2] - boxes[:, 2:] / 2, plug[:2] - plug[2:] / 2)
        high = np.minimum(boxes[:, :2] + boxes[:, 2:] / 2, plug[:2] + plug[2:] / 2)
        shared = np.maximum(high - low, 0).prod(axis=1)
        inside |= shared > 0.3 * boxes[:, 2:].prod(axis=1)
    in_line = np.abs(boxes[:, 1] - line[1]) < 0.35 * line[3]
    large = boxes[:, 2:].max(axis=1, initial=0) > 0.5 * line[3]
    return np.asarray(in_line & large & ~inside)


class ScaledFinder:
    """droptrack's network at a scale of the image, never stretched; or at several around it."""

    def __init__(self, scale: float, weights: Path | None = None, n_looks: int = 1) -> None:
        self.scale, self._factors = scale, look_factors(n_looks)
        self._cfg, self._weights = find_network(weights)
        self._detectors: dict[tuple[int, int], Detector | SeveralLooks] = {}

    def __call__(self, image: Pixels) -> Detections:
        """Droplets of a grey image (H, W)."""
        return self.detector(image.shape[1], image.shape[0]).detect([grey_frame(image)])[0]

    def detector(self, width: int, height: int) -> Detector | SeveralLooks:
        """What finds droplets of images of a size, px."""
        if (width, height) not in self._detectors:
            looks = [self._look(width, height, self.scale * factor) for factor in self._factors]
            found = looks[0] if len(looks) == 1 else SeveralLooks(looks, MIN_SCORE)
            self._detectors[width, height] = found
        return self._detectors[width, height]

    def _look(self, width: int, height: int, scale: float) -> Detector:
        canvas = Canvas.of(width, height, scale)
        network = Network(
            resized(self._cfg, *canvas.network),
            self._weights,
            threshold=MIN_SCORE,
            max_iou=MAX_IOU,
            canvas=canvas,
        )
        return choose_detector(network, precision=Precision.fp32)


class AutoFinder:
    """droptrack's network as `detect` has it, at scales that some images of each size suggest."""

    def __init__(self, images: Sequence[Pixels], weights: Path | None = None) -> None:
        cfg, path = find_network(weights)
        tile = resized(cfg, TILE, TILE)
        detector = choose_detector(Network(tile, path, threshold=TILE_SCORE, max_iou=MAX_IOU))
        self._finders: dict[tuple[int, int], Finder] = {}
        self.scales: list[float] = []  # those chosen, each once
        for height, width in dict.fromkeys(image.shape for image in images):
            alike = [image for image in images if image.shape == (height, width)]
            samples = [grey_frame(alike[number]) for number in spread(len(alike), N_SAMPLES)]
            own = Canvas.like(width, height, (cfg.width, cfg.height))
            choice = choose_scale(samples, detector, own.scale)
            scales = [scale for _, scale in choice.levels] or [choice.scale]
            finders = [ScaledFinder(scale, weights, STILL_LOOKS) for scale in scales]
            found = [finder.detector(width, height) for finder in finders]
            levels = [(sizes, one) for (sizes, _), one in zip(choice.levels, found, strict=False)]
            self._finders[height, width] = Pyramid(levels) if levels else found[0]
            self.scales = sorted({*self.scales, *scales})

    def __call__(self, image: Pixels) -> Detections:
        """Droplets of a grey image (H, W) of one of the sizes."""
        height, width = image.shape
        return self._finders[height, width].detect([grey_frame(image)])[0]


def rows_of(folder: Path, name: str, weights: Path | None) -> Iterator[tuple[str, Scores]]:
    """Each method's scores on a set: the network at every scale, then the best of the others."""
    images = read_set(folder / name)
    automatic = AutoFinder([one.image for one in images], weights)
    scores = score_set(images, SETS[name], automatic)
    chosen = ", ".join(f"{scale:.2f}" for scale in automatic.scales)
    yield f"droptrack, scale auto ({chosen})", scores
    for scale in SCALES:
        largest = max(max(one.image.shape) for one in images)
        if scale * largest <= 2200:
            yield (
                f"droptrack, scale {scale:.2f}",
                score_set(images, SETS[name], ScaledFinder(scale, weights)),
            )
    best: dict[str, Scores] = {}
    for method, find in finders():
        scores = score_set(images, SETS[name], find)
        if method not in best or scores.worth > best[method].worth:
            best[method] = scores
    yield from best.items()


def run(folder: Path, weights: Path | None, sets: Iterable[str]) -> None:
    """Print a table for each set that is there; by default, of the bundled model for footage.

    AP50, recall, by IoU and by centre, and precision of all droplets, then AP50 of small, middle
    and large ones (SIZES).
    Raises KeyError for a set without rules.
    """
    weights = weights or Path(FOOTAGE)
    console = Console(width=100)
    for name in sets:
        if not (folder / name).is_dir():
            continue
        table = Table(title=name, title_justify="left")
        for heading in ("method", "AP50", "recall", "by centre", "precision", *SIZES):
            table.add_column(heading, justify="left" if heading == "method" else "right")
        for method, scores in rows_of(folder, name, weights):
            sure = (scores.recall, scores.by_centre, scores.precision)
            values = (scores.ap50, *sure, *scores.ap50_of_sizes)
            table.add_row(method, *("" if np.isnan(v) else f"{v:.3f}" for v in values))
        console.print(table)
    for name in SEQUENCES:
        if (folder / name).is_dir():
            counts = score_sequence(folder / name, weights)
            text = ", ".join(f"{key.removeprefix('n_')} {value}" for key, value in counts.items())
            console.print(f"{name}, tracked: {text}")
