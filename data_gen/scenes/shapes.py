"""Droplet shapes -> anti-aliased pixels and exact boxes.

An image is an (H, W) uint8 canvas of grey levels. Pixel c covers [c, c + 1), so its centre is
c + 0.5. Three kinds of shapes:

ellipses   (N, 5) float64 [cx, cy, a, b, angle]: semi-axes a and b in px, angle of a in radians
contours   a centre (2,) and radii (K,): the droplet reaches radii[k] px at the angle 2 pi k / K
polygons   their corners (K, 2)

A pixel's grey level is the part of it that the shape covers, were the edge straight within the
pixel: a disc's centre of mass is right to 2e-3 px, for a radius of 8 px or more.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Float32s, Floats

Canvas = NDArray[np.uint8]

BLACK, WHITE = 0, 255

REACH = np.float32(np.sqrt(0.5))  # px from its centre to a pixel's corner


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
    """Draw ellipses of one grey level over the canvas, in place.

    The edge goes from one level to the other over `edge_px` pixels. With 1, a pixel gets exactly
    its covered part; the edges of all ellipses are then computed together, which saves time.
    """
    edges = []
    for (cx, cy, a, b, angle), box in zip(
        ellipses.tolist(), ellipse_boxes(ellipses).tolist(), strict=True
    ):
        patch, x, y, corner = _patch(canvas, box, (cx, cy), edge_px)
        c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
        if a == b:
            distance = np.sqrt(np.add.outer(y * y, x * x))
            distance -= np.float32(a)
        else:
            u = np.add.outer(s * y, c * x) / np.float32(a)
            v = np.add.outer(c * y, -s * x) / np.float32(b)
            scaled = np.sqrt(u * u + v * v)
            slope = np.sqrt((u / np.float32(a)) ** 2 + (v / np.float32(b)) ** 2)
            distance = (scaled - 1) * scaled / np.maximum(slope, np.float32(1e-9))
        if edge_px != 1:
            _blend(patch, np.clip(0.5 - distance / np.float32(edge_px), 0, 1), level)
            continue
        row, column = np.nonzero(np.abs(distance) < REACH)
        # the normal of the edge, not of length one
        along = (c * x[column] + s * y[row]) / np.float32(a * a)
        across = (c * y[row] - s * x[column]) / np.float32(b * b)
        normal = (c * along - s * across, s * along + c * across)
        places = (row + corner[1]) * canvas.shape[1] + column + corner[0]
        edges.append((places, distance[row, column], *normal, patch[row, column]))
        patch[distance < 0] = level
    if edges:
        places, distance, normal_x, normal_y, below = map(np.concatenate, zip(*edges, strict=True))
        covered = np.zeros(canvas.size, np.float32)
        np.add.at(covered, places, pixel_coverage(distance, normal_x, normal_y))
        part = np.minimum(covered[places], 1)  # of pixels that two ellipses share
        canvas.reshape(-1)[places] = below + part * (np.float32(level) - below) + np.float32(0.5)


def draw_contour(
    canvas: Canvas, centre: Floats, radii: Floats, level: int, edge_px: float = 1.0
) -> None:
    """Draw one contour of grey level `level` over the canvas, in place."""
    patch, x, y, _ = _patch(
        canvas, contour_box(centre, radii).tolist(), (centre[0], centre[1]), edge_px
    )
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
    if edge_px != 1:
        coverage = np.clip(0.5 - distance / np.float32(edge_px), 0, 1)
    else:
        slope_y, slope_x = np.gradient(distance)
        coverage = pixel_coverage(distance, slope_x, slope_y)
    _blend(patch, coverage, level)


def draw_polygon(canvas: Canvas, points: Floats, level: int, steps: int = 8) -> None:
    """Draw the polygon with corners (K, 2) over the canvas, in place.

    A pixel's covered part is counted on steps x steps places in it.
    """
    low = np.maximum(np.floor(points.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(points.max(axis=0)).astype(int), canvas.shape[::-1])
    columns, rows = np.maximum(high - low, 0)
    if not rows or not columns:
        return
    fine = np.zeros((rows * steps, columns * steps), np.uint8)
    corners = np.round((points - low) * steps - 0.5).astype(np.int32)
    cv2.fillPoly(fine, [corners], WHITE)
    part = cv2.resize(fine / np.float32(WHITE), (columns, rows), interpolation=cv2.INTER_AREA)
    _blend(canvas[low[1] : high[1], low[0] : high[0]], np.asarray(part, np.float32), level)


def pixel_coverage(distance: Float32s, normal_x: Float32s, normal_y: Float32s) -> Float32s:
    """The parts of pixels that lie on the negative side of a straight line.

    distance: signed, of the pixels' centres from the line; normal_x and normal_y: the line's
    normal, of any length. A unit square's projection on the normal (c, s) is a trapezoid, level
    within |c| - |s| over 2 and zero from |c| + |s| over 2 on.
    """
    x, y = np.abs(normal_x), np.abs(normal_y)
    length = np.sqrt(x * x + y * y) + np.float32(1e-12)
    c, s = np.maximum(x, y) / length, np.minimum(x, y) / length
    far = np.abs(distance)
    corner = np.maximum((c + s) / 2 - far, 0) ** 2 / (2 * c * s + np.float32(1e-9))
    outside = np.where(far <= (c - s) / 2, 0.5 - far / (c + np.float32(1e-9)), corner)
    return np.asarray(np.where(distance > 0, outside, 1 - outside), np.float32)


def _patch(
    canvas: Canvas, box: Sequence[float], origin: tuple[float, float], edge_px: float
) -> tuple[Canvas, Float32s, Float32s, tuple[int, int]]:
    """The canvas under a box, its pixel centres' x and y from the origin, and its corner."""
    rows, columns = canvas.shape
    cx, cy, width, height = box
    reach_x, reach_y = width / 2 + edge_px + 1, height / 2 + edge_px + 1
    x0, y0 = max(math.floor(cx - reach_x), 0), max(math.floor(cy - reach_y), 0)
    x1, y1 = min(math.ceil(cx + reach_x), columns), min(math.ceil(cy + reach_y), rows)
    x = np.arange(x0, max(x1, x0)) + (0.5 - origin[0])
    y = np.arange(y0, max(y1, y0)) + (0.5 - origin[1])
    patch = canvas[y0 : y0 + len(y), x0 : x0 + len(x)]
    return patch, x.astype(np.float32), y.astype(np.float32), (x0, y0)


def _blend(patch: Canvas, coverage: Float32s, level: int) -> None:
    below = patch.astype(np.float32)
    patch[...] = below + coverage * (np.float32(level) - below) + np.float32(0.5)  # and truncate
