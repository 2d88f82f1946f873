"""Droplet shapes -> anti-aliased pixels and exact boxes.

A picture is an (H, W) uint8 canvas of grey levels. Pixel c covers [c, c + 1), so its centre is
c + 0.5. Two kinds of shapes:

ellipses   (N, 5) float64 [cx, cy, a, b, angle]: semi-axes a and b in px, angle of a in radians
contours   a centre (2,) and radii (K,): the droplet reaches radii[k] px at the angle 2 pi k / K

A pixel's grey level is the part of it that the shape covers, were the edge straight within the
pixel: a disc's centre of mass is right to 1e-3 px, which a test counts after.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Canvas = NDArray[np.uint8]
Float32s = NDArray[np.float32]

BLACK, WHITE = 0, 255


def ellipse_boxes(ellipses: Floats) -> Floats:
    """Exact bounding boxes (N, 4) [cx, cy, w, h] of ellipses (N, 5)."""
    a, b, angle = ellipses[:, 2], ellipses[:, 3], ellipses[:, 4]
    c, s = np.cos(angle), np.sin(angle)
    width = 2 * np.hypot(a * c, b * s)
    height = 2 * np.hypot(a * s, b * c)
    return np.column_stack([ellipses[:, :2], width, height])


def contour_points(centre: Floats, radii: Floats) -> Floats:
    """The points (K, 2) of a contour."""
    angles = np.arange(len(radii)) * (2 * np.pi / len(radii))
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(centre + radii[:, None] * directions)


def contour_box(centre: Floats, radii: Floats) -> Floats:
    """The bounding box (4,) [cx, cy, w, h] of a contour."""
    points = contour_points(centre, radii)
    low, high = points.min(axis=0), points.max(axis=0)
    return np.concatenate([(low + high) / 2, high - low])


def draw_ellipses(canvas: Canvas, ellipses: Floats, level: int, edge_px: float = 1.0) -> None:
    """Draw ellipses of grey level `level` over the canvas, in place.

    The edge goes from one level to the other over `edge_px` pixels.
    """
    for (cx, cy, a, b, angle), box in zip(ellipses, ellipse_boxes(ellipses), strict=True):
        patch, x, y = _patch(canvas, box, (cx, cy), edge_px)
        if a == b:
            distance = np.sqrt(np.add.outer(y * y, x * x))
            distance -= np.float32(a)
        else:
            c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
            u = np.add.outer(s * y, c * x) / np.float32(a)
            v = np.add.outer(c * y, -s * x) / np.float32(b)
            scaled = np.sqrt(u * u + v * v)
            slope = np.sqrt((u / np.float32(a)) ** 2 + (v / np.float32(b)) ** 2)
            distance = (scaled - 1) * scaled / np.maximum(slope, np.float32(1e-9))
        _blend(patch, distance, level, edge_px)


def draw_contour(
    canvas: Canvas, centre: Floats, radii: Floats, level: int, edge_px: float = 1.0
) -> None:
    """Draw one contour of grey level `level` over the canvas, in place."""
    patch, x, y = _patch(canvas, contour_box(centre, radii), (centre[0], centre[1]), edge_px)
    n = len(radii)
    position = np.arctan2(y[:, None], x[None, :]) * np.float32(n / (2 * np.pi))
    low = np.floor(position)
    weight = position - low
    index = low.astype(np.int64) % n
    slope = (np.roll(radii, -1) - np.roll(radii, 1)) * (n / (4 * np.pi))
    steepness = (radii / np.hypot(radii, slope)).astype(np.float32)
    ring = radii.astype(np.float32)
    edge = ring[index] * (1 - weight) + ring[(index + 1) % n] * weight
    distance = (np.sqrt(np.add.outer(y * y, x * x)) - edge) * steepness[index]
    _blend(patch, distance, level, edge_px)


def _patch(
    canvas: Canvas, box: Floats, origin: tuple[float, float], edge_px: float
) -> tuple[Canvas, Float32s, Float32s]:
    """The part of the canvas under a box, and its pixel centres' x and y from the origin."""
    rows, columns = canvas.shape
    reach = box[2:] / 2 + edge_px + 1
    x0, y0 = np.maximum(np.floor(box[:2] - reach), 0).astype(int)
    x1, y1 = np.ceil(box[:2] + reach).astype(int)
    x = np.arange(x0, max(min(x1, columns), x0)) + (0.5 - origin[0])
    y = np.arange(y0, max(min(y1, rows), y0)) + (0.5 - origin[1])
    patch = canvas[y0 : y0 + len(y), x0 : x0 + len(x)]
    return patch, x.astype(np.float32), y.astype(np.float32)


def _blend(patch: Canvas, distance: Float32s, level: int, edge_px: float) -> None:
    """Cover a patch where the signed distance (h, w) px to the edge is negative."""
    if edge_px == 1.0:
        coverage = (distance < 0).astype(np.float32)
        edge = np.nonzero(np.abs(distance) < np.sqrt(0.5))
        coverage[edge] = _pixel_coverage(distance, edge)
    else:
        coverage = np.clip(0.5 - distance / np.float32(edge_px), 0, 1)
    below = patch.astype(np.float32)
    coverage *= np.float32(level) - below
    coverage += below
    coverage += np.float32(0.5)
    patch[...] = coverage  # truncates: rounded by the half added above


def _pixel_coverage(distance: Float32s, edge: tuple[NDArray[np.int64], ...]) -> Float32s:
    """The parts of pixels at `edge` on the negative side of a straight line at their distance.

    The line's direction is that of the distance's slope. A unit square's projection on the line's
    normal (c, s) is a trapezoid, level within |c| - |s| over 2 and zero from |c| + |s| over 2 on.
    """
    y, x = edge
    rows, columns = distance.shape
    right, left = np.minimum(x + 1, columns - 1), np.maximum(x - 1, 0)
    below, above = np.minimum(y + 1, rows - 1), np.maximum(y - 1, 0)
    slope_x = np.abs(distance[y, right] - distance[y, left])
    slope_y = np.abs(distance[below, x] - distance[above, x])
    length = np.hypot(slope_x, slope_y) + np.float32(1e-9)
    c, s = np.maximum(slope_x, slope_y) / length, np.minimum(slope_x, slope_y) / length
    d = distance[edge]
    reach = (c + s) / 2
    corner = np.maximum(reach - np.abs(d), 0) ** 2 / (2 * c * s + np.float32(1e-9))
    middle = 0.5 - d / (c + np.float32(1e-9))
    coverage = np.where(np.abs(d) <= (c - s) / 2, middle, np.where(d > 0, corner, 1 - corner))
    return np.asarray(coverage, np.float32)
