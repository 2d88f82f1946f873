"""Outlines of droplets as signed distances, px: negative inside, on a patch of the canvas.

A patch is a rectangle of pixels, `Patch`. Distances are exact for stadiums, and near the outline
for the other shapes. What is drawn of a droplet is a function of the distance (`appearance`), and
its box is where the distance is zero (`box_of`).
"""

import math
from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Float32s, Floats


@dataclass(frozen=True)
class Patch:
    """The pixels of a canvas under a shape: their slices, and their centres' x (W,) and y (H,)."""

    rows: slice
    columns: slice
    x: Float32s
    y: Float32s

    @property
    def is_empty(self) -> bool:
        """Whether the shape lies beyond the canvas."""
        return not (len(self.x) and len(self.y))


def patch_around(shape: tuple[int, int], centre: Floats, reach: float) -> Patch:
    """The patch of a canvas (height, width) within `reach` px of a centre, in x and in y."""
    low = np.floor(centre - reach).astype(int)
    high = np.ceil(centre + reach).astype(int)
    x0, y0 = np.clip(low, 0, shape[::-1]).tolist()
    x1, y1 = np.clip(high, 0, shape[::-1]).tolist()
    x = np.arange(x0, x1, dtype=np.float32) + np.float32(0.5)
    y = np.arange(y0, y1, dtype=np.float32) + np.float32(0.5)
    return Patch(slice(y0, y1), slice(x0, x1), x, y)


def ellipse_distance(patch: Patch, centre: Floats, a: float, b: float, angle: float) -> Float32s:
    """Distance (H, W) from an ellipse of semi-axes a, b px, a at an angle in radians."""
    c, s = math.cos(angle), math.sin(angle)
    x, y = patch.x - np.float32(centre[0]), patch.y - np.float32(centre[1])
    u = np.add.outer(y * np.float32(s / a), x * np.float32(c / a))
    v = np.add.outer(y * np.float32(c / b), x * np.float32(-s / b))
    scaled = np.sqrt(u * u + v * v)
    slope = np.sqrt((u / np.float32(a)) ** 2 + (v / np.float32(b)) ** 2)
    near = (scaled - 1) * scaled / np.maximum(slope, np.float32(1e-6))
    # in the middle, where that is no distance, as deep as the ellipse is
    return np.asarray(np.maximum(near, np.float32(-min(a, b))), np.float32)


def stadium_distance(
    patch: Patch, centre: Floats, half: Floats, radius: float, angle: float
) -> Float32s:
    """Distance (H, W) from a rectangle of half sizes (2,) px with corners of a radius, turned."""
    c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    x, y = patch.x - np.float32(centre[0]), patch.y - np.float32(centre[1])
    u = np.abs(np.add.outer(s * y, c * x)) - np.float32(half[0] - radius)
    v = np.abs(np.add.outer(c * y, -s * x)) - np.float32(half[1] - radius)
    outside = np.hypot(np.maximum(u, 0), np.maximum(v, 0))
    return np.asarray(outside + np.minimum(np.maximum(u, v), 0) - np.float32(radius), np.float32)


def cell_distance(
    patch: Patch, point: Floats, radius: float, others: Floats, film: float
) -> Float32s:
    """Distance (H, W) from a droplet in a foam: a disc, flat where it meets its neighbours.

    `others` (K, 3): x, y and radius of the neighbours. The walls are those of the power diagram,
    half a `film` px away on each side; corners are rounded (a smooth maximum).
    """
    x, y = patch.x - np.float32(point[0]), patch.y - np.float32(point[1])
    parts = [np.hypot(y[:, None], x[None]) - np.float32(radius)]
    for other_x, other_y, other_radius in others.tolist():
        dx, dy = other_x - point[0], other_y - point[1]
        apart = math.hypot(dx, dy)
        wall = (apart**2 + radius**2 - other_radius**2) / (2 * apart) - film / 2
        along = np.add.outer(y * np.float32(dy / apart), x * np.float32(dx / apart))
        parts.append(along - np.float32(wall))
    sharpness = np.float32(0.12 * radius + 0.5)
    stack = np.stack(parts)
    highest = stack.max(axis=0)
    total = np.exp((stack - highest) / sharpness).sum(axis=0)
    return np.asarray(highest + sharpness * np.log(total), np.float32)


def box_of(patch: Patch, distance: Float32s) -> Floats | None:
    """The box (4,) [left, top, right, bottom] px of where a distance (H, W) is below zero.

    Between pixel centres the distance is taken to be linear; at the patch's edges the box ends
    where the patch does. None where nothing is inside.
    """
    low, high = np.empty(2), np.empty(2)
    for k, (places, axis) in enumerate(((patch.x, 0), (patch.y, 1))):
        depth = distance.min(axis=axis)
        inside = np.flatnonzero(depth < 0)
        if not len(inside):
            return None
        first, last = int(inside[0]), int(inside[-1])
        low[k] = places[first] - (0.5 if first == 0 else _crossing(depth[first], depth[first - 1]))
        end = last == len(depth) - 1
        high[k] = places[last] + (0.5 if end else _crossing(depth[last], depth[last + 1]))
    return np.concatenate([low, high])


def _crossing(inside: float, outside: float) -> float:
    """How far from a place inside towards one outside, a pixel on, the distance is zero."""
    return float(-inside / max(outside - inside, 1e-6))
