"""Anchors that suit the droplets of a data set."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.darknet_dataset import DataSet, read_labels
from droptrack.data.files import write_text
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, cfg_text, with_options, yolo_heads


@dataclass(frozen=True)
class Anchors:
    """Anchors (K, 2) px of the network's input, and how well they suit boxes.

    `mean_iou`: the mean, over all boxes, of the IoU with the best anchor, both on one centre.
    """

    sizes: Floats
    mean_iou: float

    def option(self) -> str:
        """As a ``.cfg`` has them, ``w,h, w,h``."""
        return ", ".join(f"{w:g},{h:g}" for w, h in self.sizes.tolist())


def suit_anchors(
    data: DataSet,
    cfg: Cfg,
    rng: np.random.Generator,
    *,
    figure: Path | None = None,
    write: Path | None = None,
) -> tuple[Anchors, Anchors]:
    """The anchors that a network has, and as many that suit the training boxes of a data set best.

    `figure`: draw boxes and anchors there; `write`: put a ``.cfg`` with the new anchors there.
    Raises DroptrackError for a data set with too few different boxes, and before it overwrites a
    ``.cfg``.
    """
    if write is not None and write.exists():
        raise DroptrackError(f"{write}: is there already; choose another name")
    boxes = box_sizes(data, cfg.width, cfg.height)
    present = yolo_heads(cfg)[0].all_anchors
    try:
        best = np.round(find_anchors(boxes, len(present), rng), 1)
    except ValueError as error:
        raise DroptrackError(f"{data.path}: {error}") from None
    found = Anchors(best, mean_best_iou(boxes, best))
    if figure is not None:
        from droptrack.training.plots import plot_anchors

        plot_anchors(figure, boxes, best)
    if write is not None:
        write_text(write, cfg_text(with_options(cfg, {}, {"anchors": found.option()})))
    return Anchors(present, mean_best_iou(boxes, present)), found


def box_sizes(data: DataSet, width: int, height: int) -> Floats:
    """Sizes (N, 2) px of all training boxes in a network's input of width x height px."""
    sizes = [read_labels(image)[1][:, 2:] for image in data.train]
    return np.concatenate(sizes) * [width, height]


def shape_iou(sizes: Floats, anchors: Floats) -> Floats:
    """IoU (N, K) of boxes (N, 2) and anchors (K, 2) laid on one centre."""
    shared = np.minimum(sizes[:, None], anchors[None]).prod(axis=2)
    return np.asarray(shared / (sizes.prod(axis=1)[:, None] + anchors.prod(axis=1)[None] - shared))


def mean_best_iou(sizes: Floats, anchors: Floats) -> float:
    """The IoU of each box with its best anchor, on average."""
    return float(shape_iou(sizes, anchors).max(axis=1).mean())


def find_anchors(sizes: Floats, k: int, rng: np.random.Generator, starts: int = 5) -> Floats:
    """The best (k, 2) anchors by area of some k-means with the distance 1 - IoU.

    As section 2 of YOLO9000 (Redmon and Farhadi, 2017); started as k-means++. Raises ValueError for
    less than k different sizes.
    """
    if len(np.unique(sizes, axis=0)) < k:
        raise ValueError(f"{k} anchors need as many different boxes")
    found = [_k_means(sizes, k, rng) for _ in range(starts)]
    best = max(found, key=lambda anchors: mean_best_iou(sizes, anchors))
    return best[np.argsort(best.prod(axis=1))]


def _k_means(sizes: Floats, k: int, rng: np.random.Generator) -> Floats:
    anchors = sizes[rng.integers(len(sizes), size=1)]
    while len(anchors) < k:
        distance = 1 - shape_iou(sizes, anchors).max(axis=1)
        following = rng.choice(len(sizes), p=distance / distance.sum())
        anchors = np.concatenate([anchors, sizes[following : following + 1]])
    nearest = np.full(len(sizes), -1)
    while True:
        before, nearest = nearest, shape_iou(sizes, anchors).argmax(axis=1)
        if (nearest == before).all():
            return anchors
        for cluster in np.unique(nearest):
            anchors[cluster] = np.median(sizes[nearest == cluster], axis=0)
