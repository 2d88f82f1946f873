"""Box -> sub-pixel centre of mass of the droplet in it, from the grey levels.

The centre of a bounding box is known to a fraction of the network's cells; the intensity-weighted
centre of an anti-aliased droplet to two thousandths of a pixel.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.detections import xyxy_from_boxes

Floats = NDArray[np.float64]
Grey = NDArray[np.float32]

MARGIN = 0.25  # of the box's size, added on each side: boxes are not exact
EDGE_PX = 1.5  # reach of an anti-aliased edge beyond the half-height contour
LEAST_CONTRAST = 12.0  # grey levels between droplet and surroundings


def centres_of_mass(frame: NDArray[np.uint8], boxes: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Centres of mass (N, 2) px of the droplets in boxes (N, 4) of a frame (H, W, 3).

    Also tells (N,) whether each was measured: where the droplet does not stand out from its
    surroundings, the box's centre is given.

    A droplet is the connected region around the box's middle that lies beyond half the contrast
    between droplet and surroundings, dark or bright, and nearer to this box than to any other.
    Pixels weigh by their contrast, so that the edge counts for the part of it that is covered.
    """
    centres = boxes[:, :2].copy()
    measured = np.zeros(len(boxes), bool)
    height, width = frame.shape[:2]
    reach = boxes[:, 2:] * (0.5 + MARGIN) + EDGE_PX
    low = np.maximum(np.floor(boxes[:, :2] - reach), 0).astype(int)
    high = np.minimum(np.ceil(boxes[:, :2] + reach), [width, height]).astype(int)
    neighbours = _neighbours(boxes, reach)
    for i, (x0, y0, x1, y1) in enumerate(np.hstack([low, high]).tolist()):
        if x1 - x0 < 3 or y1 - y0 < 3:
            continue
        crop = cv2.cvtColor(frame[y0:y1, x0:x1], cv2.COLOR_BGR2GRAY).astype(np.float32)
        x = np.arange(x0, x1, dtype=np.float32) + np.float32(0.5)
        y = np.arange(y0, y1, dtype=np.float32) + np.float32(0.5)
        weights = _weights(crop, x, y, boxes[i], boxes[neighbours[i]])
        if weights is None:
            continue
        total = float(weights.sum())
        centre = np.array([weights.sum(axis=0) @ x, weights.sum(axis=1) @ y]) / total
        if (np.abs(centre - boxes[i, :2]) < boxes[i, 2:] / 2).all():
            centres[i], measured[i] = centre, True
    return centres, measured


def _neighbours(boxes: Floats, reach: Floats) -> list[NDArray[np.int64]]:
    """For each box, the others that its surroundings overlap."""
    around = xyxy_from_boxes(np.hstack([boxes[:, :2], 2 * reach]))
    others = xyxy_from_boxes(boxes)
    overlap = (around[:, None, :2] < others[None, :, 2:]) & (
        around[:, None, 2:] > others[None, :, :2]
    )
    close = overlap[..., 0] & overlap[..., 1] & ~np.eye(len(boxes), dtype=bool)
    return [np.flatnonzero(row) for row in close]


def _weights(crop: Grey, x: Grey, y: Grey, box: Floats, others: Floats) -> Grey | None:
    """How much of each pixel of a crop is covered by the droplet in the box; None if unclear."""
    distance = _ellipse_distance(x, y, box)
    inside = distance < 0.5
    around = (distance > 1.1) & (distance < 2.0)
    if not inside.any() or not around.any():
        return None
    level = float(np.median(crop[inside]))
    ring = crop[around]
    darkest, brightest = np.percentile(ring, (10, 90))
    bright = level - darkest >= brightest - level
    half = (level + (darkest if bright else brightest)) / 2
    outside = ring[ring < half] if bright else ring[ring > half]
    if not len(outside):
        return None
    background = float(np.median(outside))
    contrast = level - background
    if abs(contrast) < LEAST_CONTRAST:
        return None
    coverage = np.clip((crop - np.float32(background)) / np.float32(contrast), 0, 1)
    covered = coverage > 0.5
    region = _region(covered, distance)
    if region is None:
        return None
    distances = [_ellipse_distance(x, y, other) for other in others]
    if any((region & (d < 0.5)).any() for d in distances):  # it runs into a touching droplet
        mine = np.logical_and.reduce([distance <= d for d in distances])
        coverage[~mine] = 0
        region = _region(covered & mine, distance)
        if region is None:
            return None
    return np.asarray(coverage * _with_edge(region, covered & ~region), np.float32)


def _region(mask: NDArray[np.bool_], distance: Grey) -> NDArray[np.bool_] | None:
    """The connected region of the mask that fills most of the middle."""
    n, numbers = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    counts = np.bincount(numbers[distance < 0.8], minlength=n)
    counts[0] = 0
    best = int(counts.argmax())
    return np.asarray(numbers == best) if counts[best] else None


def _with_edge(region: NDArray[np.bool_], others: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The region and what is within EDGE_PX of it and nearer to it than to the others."""
    to_region, to_others = (
        cv2.distanceTransform((~part).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        for part in (region, others)
    )
    return np.asarray((to_region <= EDGE_PX) & (to_region < to_others))


def _ellipse_distance(x: Grey, y: Grey, box: Floats) -> Grey:
    """Distance (h, w) from the box's centre, 1 on the ellipse inscribed in it."""
    u = (x - np.float32(box[0])) * np.float32(2 / box[2])
    v = (y - np.float32(box[1])) * np.float32(2 / box[3])
    return np.asarray(np.sqrt(np.add.outer(v * v, u * u)), np.float32)
