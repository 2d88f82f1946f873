"""What one would pick instead of a network: each method finds boxes with scores in a grey image.

Each has a few settings, of which the bench takes the best on each set: more than a user can do.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from itertools import product

import cv2
import numpy as np
from scipy import ndimage

from droptrack.data.arrays import Floats, Pixels
from droptrack.data.detections import Detections

Finder = Callable[[Pixels], Detections]


def finders() -> Iterator[tuple[str, Finder]]:
    """Every method with every setting, by the method's name; trackpy's where it is installed."""
    for bright, seeds in product((False, True), (0.3, 0.5, 0.7)):
        yield "threshold, watershed", partial(watershed, bright=bright, seeds=seeds)
    for radius, votes in product((10, 25, 60), (15, 30, 50)):
        yield "Hough circles", partial(hough, radius=radius, votes=votes)
    if find_spec("trackpy") is None:
        return
    for diameter, dark in product((11, 21, 41, 81), (False, True)):
        yield "trackpy.locate", partial(trackpy_locate, diameter=diameter, dark=dark)


def watershed(image: Pixels, bright: bool, seeds: float) -> Detections:
    """Otsu's threshold, then a watershed from where the distance to the edge is above a share."""
    kind = cv2.THRESH_BINARY if bright else cv2.THRESH_BINARY_INV
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    _, mask = cv2.threshold(smooth, 0, 255, kind | cv2.THRESH_OTSU)
    filled = ndimage.binary_fill_holes(mask > 0).astype(np.uint8)
    depth = cv2.distanceTransform(filled, cv2.DIST_L2, 5)
    peaks = (depth > seeds * cv2.dilate(depth, np.ones((15, 15)))) & (depth > 2)
    markers, n = ndimage.label(peaks)
    markers = markers.astype(np.int32) + 1
    markers[(filled > 0) & ~peaks] = 0
    cv2.watershed(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), markers)
    boxes = []
    for found in ndimage.find_objects(np.where(markers > 1, markers - 1, 0), n):
        if found is not None:
            rows, columns = found
            boxes.append([columns.start, rows.start, columns.stop, rows.stop])
    return _detections(np.array(boxes, float).reshape(-1, 4))


def hough(image: Pixels, radius: int, votes: int) -> Detections:
    """OpenCV's Hough transform for circles from half to twice a radius, px."""
    circles = cv2.HoughCircles(
        cv2.medianBlur(image, 5), cv2.HOUGH_GRADIENT, 1.5, radius, param1=100, param2=votes,
        minRadius=radius // 2, maxRadius=2 * radius,
    )  # fmt: skip
    found = np.zeros((0, 3)) if circles is None else np.asarray(circles, float).reshape(-1, 3)
    reach = found[:, 2:]
    return _detections(np.hstack([found[:, :2] - reach, found[:, :2] + reach]))


def trackpy_locate(image: Pixels, diameter: int, dark: bool) -> Detections:
    """Crocker and Grier's locator as trackpy has it; boxes of the given diameter."""
    import trackpy

    trackpy.quiet()
    found = trackpy.locate(255 - image if dark else image, diameter)
    centres = found[["x", "y"]].to_numpy(float) + 0.5
    mass = found["mass"].to_numpy(float)
    half = diameter / 2
    boxes = np.hstack([centres - half, centres + half])
    return _detections(boxes, mass / max(mass.max(initial=0), 1e-9))


def _detections(boxes_xyxy: Floats, scores: Floats | None = None) -> Detections:
    """Boxes (N, 4) [left, top, right, bottom]; without scores, large ones first."""
    size = boxes_xyxy[:, 2:] - boxes_xyxy[:, :2]
    area = size.prod(axis=1)
    if scores is None:
        scores = 0.5 + 0.5 * area / max(area.max(initial=0), 1)
    boxes = np.hstack([(boxes_xyxy[:, :2] + boxes_xyxy[:, 2:]) / 2, size])
    kept = (size > 0).all(axis=1)
    return Detections(boxes[kept], scores[kept], np.zeros(int(kept.sum()), np.int64))
