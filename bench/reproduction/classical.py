"""What a user would pick instead of a network: thresholds, watershed, trackpy's locator.

Each has a few settings, of which those are taken that find most on four frames of the video, by
its ground truth: more than a user can do.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from bench.reproduction.linking import Found, quiet_trackpy, rows_of
from droptrack.data.arrays import Floats, Pixels
from droptrack.data.trajectories import Trajectories
from droptrack.evaluation.trajectory_scores import match

N_CHOSEN_ON = 4  # frames
MIN_AREA = 20  # px²: smaller things are noise
LINE_PX = 3  # of a watershed, at most
Finder = Callable[[Pixels], Found]


@dataclass(frozen=True)
class Method:
    """A way to find droplets in a grey image, with one of its settings."""

    setting: str
    find: Finder


def threshold(image: Pixels, blur_px: float) -> Found:
    """Otsu's threshold of the blurred image, then connected regions, but for those at the edge."""
    labels, n = ndimage.label(_inside(image, blur_px))
    return _regions(image, labels, n)


def watershed(image: Pixels, blur_px: float, seeds: float) -> Found:
    """The same, cut at necks: a watershed from where the distance to the edge is large.

    `seeds`: the share of the largest distance around from which a place is a droplet's inside.
    """
    mask = _inside(image, blur_px)
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    around = cv2.dilate(depth, np.ones((15, 15)))
    peaks, n = ndimage.label((depth > seeds * around) & (depth > 2))
    markers = np.asarray(peaks, np.int32) + 1
    markers[mask & (peaks == 0)] = 0
    inverse = np.asarray(255 * (1 - depth / max(float(depth.max()), 1e-9)), np.uint8)
    cv2.watershed(cv2.cvtColor(inverse, cv2.COLOR_GRAY2BGR), markers)
    parts = np.where(markers > 1, markers - 1, 0)
    apart, nearest = ndimage.distance_transform_edt(parts == 0, return_indices=True)
    grown = parts[tuple(nearest)]  # lines between parts, and edges, belong to the part beside them
    return _regions(image, np.where(mask & (apart <= LINE_PX), grown, 0), n)


def trackpy_locate(image: Pixels, diameter: int, minmass: float) -> Found:
    """Crocker and Grier's locator as trackpy has it; boxes of the given diameter."""
    import trackpy

    with quiet_trackpy():
        table: Any = trackpy.locate(image, diameter, minmass=minmass, characterize=False)
    centres = table[["x", "y"]].to_numpy(float) + 0.5
    return Found(centres, np.full((len(centres), 2), float(diameter)))


def methods(diameter: float) -> dict[str, list[Method]]:
    """Every method with its settings, for droplets of about a diameter in px."""
    odd = sorted({int(diameter * factor) // 2 * 2 + 1 for factor in (0.7, 1.0, 1.4)})
    return {
        "threshold": [
            Method(f"blur {blur:g} px", partial(threshold, blur_px=blur)) for blur in (0, 1, 2)
        ],
        "watershed": [
            Method(
                f"blur {blur:g} px, seeds {seeds:g}", partial(watershed, blur_px=blur, seeds=seeds)
            )
            for blur in (0, 2)
            for seeds in (0.5, 0.7)
        ],
        "trackpy.locate": [
            Method(
                f"diameter {size}, minmass {mass:g}",
                partial(trackpy_locate, diameter=size, minmass=mass),
            )
            for size in odd
            for mass in (10 * size**2, 30 * size**2)
        ],
    }


def best_setting(
    settings: Sequence[Method], frames: Iterable[tuple[int, Pixels]], truth: Trajectories
) -> Method:
    """The setting with the highest F1 on frames, by their ground truth; the first of equals."""
    images = list(frames)
    seen = np.isin(truth.frame, [number for number, _ in images])
    scores = []
    for one in settings:
        rows = rows_of([(number, one.find(image)) for number, image in images])
        pairs = match(truth[seen], rows)
        n_truths = int((truth[seen].scores > 0).sum())
        n_hits = len(pairs.truth)
        scores.append(2 * n_hits / max(n_hits + pairs.n_false + n_truths, 1))
    return settings[int(np.argmax(scores))]


def _inside(image: Pixels, blur_px: float) -> Any:
    """Where an image (H, W) is brighter than Otsu's threshold, in regions that no edge cuts."""
    smooth = cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image
    bright = cv2.threshold(smooth, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1] > 0
    labels, _ = ndimage.label(bright)
    edges = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    return bright & ~np.isin(labels, edges[edges > 0])


def _regions(image: Pixels, labels: Any, n: int) -> Found:
    """Centres of mass and sizes of regions that are not mere noise."""
    numbers, sizes = [], []
    areas = np.bincount(labels.ravel(), minlength=n + 1)
    for k, place in enumerate(ndimage.find_objects(labels, n), start=1):
        if place is None or areas[k] < MIN_AREA:
            continue
        y, x = place
        numbers.append(k)
        sizes.append([x.stop - x.start, y.stop - y.start])
    if not numbers:
        return Found(np.zeros((0, 2)), np.zeros((0, 2)))
    centres: Floats = np.array(ndimage.center_of_mass(image.astype(float), labels, numbers))
    return Found(centres[:, ::-1] + 0.5, np.array(sizes, float))
