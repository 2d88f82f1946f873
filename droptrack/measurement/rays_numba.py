"""The ends of rays box by box, compiled: what rays.py says of arrays, in loops."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Floats, Rows

# what limits a ray
FREE, IMAGE, NEIGHBOUR = 0, 1, 2
FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}


class Settings(NamedTuple):
    """The constants of rays.py, by their names there."""

    reach: float
    margin_px: float
    inner: float
    core: float
    beyond_px: float
    nested: float


_SETTINGS = types.NamedUniTuple(types.float64, 6, Settings)  # type: ignore[no-untyped-call]
SIGNATURE = types.void(
    types.UniTuple(types.int64, 2),  # type: ignore[no-untyped-call]
    types.float64[:, ::1],
    types.float64[:, ::1],
    types.int64[:, ::1],
    types.float64[:, ::1],
    _SETTINGS,
    types.int64[:, :, ::1],
    types.int64[:, :, ::1],
)


@njit(**FAST)
def _to_side(origin: float, step: float, low: float, high: float) -> float:
    """How far it is along a ray until it leaves low..high in one coordinate."""
    if step > 0:
        return (high - origin) / step
    if step < 0:
        return (low - origin) / step
    return np.inf


@njit(**FAST)
def _beside(box: Floats, other: Floats, origin: Floats, s: Settings) -> bool:
    """Whether another box is near enough to limit rays, and neither lies within the other."""
    larger, smaller = (other, box) if other[2] * other[3] > box[2] * box[3] else (box, other)
    near = nested = True
    for k in range(2):
        reach = s.reach * box[2 + k] + s.margin_px + other[2 + k] / 2
        near &= abs(other[k] - origin[k]) < reach
        nested &= abs(smaller[k] - larger[k]) < s.nested * larger[2 + k] / 2
    nested &= smaller[2] * smaller[3] < larger[2] * larger[3] / 2
    return near and not nested


@njit(**FAST)
def _first_root(a: float, b: float, c: float) -> float:
    """The smallest positive x with a x^2 + b x + c = 0, or infinity."""
    if abs(a) < 1e-12:
        return -c / b if c * b < 0 else np.inf
    square = b * b - 4 * a * c
    if square < 0:
        return np.inf
    first, second = (-b - np.sqrt(square)) / (2 * a), (-b + np.sqrt(square)) / (2 * a)
    low, high = min(first, second), max(first, second)
    return low if low > 0 else (high if high > 0 else np.inf)


@njit(**FAST)
def _until(
    box: Floats, other: Floats, origin: Floats, step: Floats, core: float
) -> tuple[float, float]:
    """Where along a ray another droplet's core begins, and where its box becomes the nearer one."""
    own_a = own_b = own_c = a = b = c = 0.0
    for k in range(2):
        own, its = 2 / box[2 + k], 2 / other[2 + k]
        own_at, its_at = (origin[k] - box[k]) * own, (origin[k] - other[k]) * its
        own_step, its_step = step[k] * own, step[k] * its
        own_a, a = own_a + own_step**2, a + its_step**2
        own_b, b = own_b + 2 * own_at * own_step, b + 2 * its_at * its_step
        own_c, c = own_c + own_at**2, c + its_at**2
    half_way = np.inf
    if own_c < c:
        half_way = _first_root(own_a - a, own_b - b, own_c - c)
    entry = _first_root(a, b, c - core**2) if c > core**2 else np.inf
    return entry, half_way


@njit(SIGNATURE, **FAST)
def find_ends(
    size: tuple[int, int],
    boxes: Floats,
    origins: Floats,
    neighbours: Rows,
    steps: Floats,
    s: Settings,
    ends: Rows,
    limits: Rows,
) -> None:
    """Put into `ends` (N, K, 3) and `limits` (N, K, 2) where rays from `origins` (N, 2) end."""
    beside = np.empty(neighbours.shape[1], np.int64)
    for n in range(len(boxes)):
        box, origin, n_beside = boxes[n], origins[n], 0
        for other in neighbours[n]:
            if other >= 0 and _beside(box, boxes[other], origin, s):
                beside[n_beside] = other
                n_beside += 1
        for ray in range(len(steps)):
            step = steps[ray]
            side = min(
                _to_side(origin[0], step[0], box[0] - box[2] / 2, box[0] + box[2] / 2),
                _to_side(origin[1], step[1], box[1] - box[3] / 2, box[1] + box[3] / 2),
            )
            side = max(side, 0.0)
            end = end_of_ring = s.reach * side + s.margin_px
            limit = limit_of_ring = FREE
            for m in range(n_beside):
                core, half_way = _until(box, boxes[beside[m]], origin, step, s.core)
                if core < end:
                    end, limit = core, NEIGHBOUR
                if half_way + s.beyond_px < end_of_ring:
                    end_of_ring, limit_of_ring = half_way + s.beyond_px, NEIGHBOUR
            border = min(
                _to_side(origin[0], step[0], 0.0, size[0]),
                _to_side(origin[1], step[1], 0.0, size[1]),
            )
            if border < end:
                end, limit = max(border, 0.0), IMAGE
            if border < end_of_ring:
                end_of_ring, limit_of_ring = max(border, 0.0), IMAGE
            ends[n, ray, 0], ends[n, ray, 1] = int(s.inner * side), int(end)
            ends[n, ray, 2] = int(end_of_ring)
            limits[n, ray, 0], limits[n, ray, 1] = limit, limit_of_ring
