"""Outlines ray by ray, compiled: what outlines.py says of arrays, in loops."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Floats, Pixels, Rows

# what limits a ray
FREE, IMAGE, NEIGHBOUR = 0, 1, 2
NO_EDGE = -1.0
FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}


class Settings(NamedTuple):
    """The constants of outlines.py, by their names there."""

    reach: float
    margin_px: float
    inner: float
    beyond_px: float
    nested: float
    core: float
    min_contrast: float
    ring_share: float
    noise: float
    min_free: float
    min_free_filled: float
    min_depth: float
    min_rise: float
    min_risen: float
    min_peak: float


class Ray(NamedTuple):
    """A ray through the image from x, y px, in steps of one px, and the levels read along it."""

    grey: Pixels
    x: float
    y: float
    step_x: float
    step_y: float
    profile: Floats


_SETTINGS = types.NamedUniTuple(types.float64, 15, Settings)  # type: ignore[no-untyped-call]
SIGNATURE = types.void(
    types.Array(types.uint8, 2, "C", readonly=True),
    types.float64[:, ::1],
    types.float64[:, ::1],
    types.int64[:, ::1],
    types.int64[:, ::1],
    types.float64[:, ::1],
    _SETTINGS,
    types.float64[:, ::1],
    types.uint8[:, ::1],
    types.uint8[::1],
)


@njit(**FAST)
def _level(ray: Ray, distance: float) -> float:
    """The grey level so many px along a ray, between the centres of four pixels."""
    grey = ray.grey
    height, width = grey.shape
    u, v = ray.x + distance * ray.step_x - 0.5, ray.y + distance * ray.step_y - 0.5
    left = min(max(int(np.floor(u)), 0), width - 2)
    top = min(max(int(np.floor(v)), 0), height - 2)
    s, t = min(max(u - left, 0.0), 1.0), min(max(v - top, 0.0), 1.0)
    above = grey[top, left] * (1 - s) + grey[top, left + 1] * s
    below = grey[top + 1, left] * (1 - s) + grey[top + 1, left + 1] * s
    return float(above * (1 - t) + below * t)


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


@njit(**FAST)
def _filled_edge(ray: Ray, first: int, last: int, scale: Floats, s: Settings) -> float:
    """The edge, px, of a droplet unlike its surroundings; see outlines.py."""
    profile, sign = ray.profile, 1.0 if scale[1] > 0 else -1.0
    base, contrast = sign * scale[0], sign * scale[1]
    lowest, low = first, np.inf
    for j in range(first, last + 1):
        if sign * profile[j] < low:
            lowest, low = j, sign * profile[j]
    place = float(lowest)
    for half in (lowest - 0.5, lowest + 0.5):
        if first <= half <= last:
            h = sign * _level(ray, half)
            if h < low:
                place, low = half, h
    depth = 1 - max((low - base) / contrast, 0.0)
    if depth < s.min_depth:
        return NO_EDGE
    limit, behind = base + 0.5 * contrast, base + s.min_rise * contrast
    for j in range(lowest, last + 1):
        if sign * profile[j] >= behind:
            limit = base + (1 - depth / (1 + depth**2)) * contrast
    if low >= limit:
        return NO_EDGE
    if sign * profile[lowest] >= limit:
        return place  # a film so thin that both edges are its middle
    return float(_crossing(ray, sign, limit, lowest - 1, first))


@njit(**FAST)
def _crossing(ray: Ray, sign: float, limit: float, start: int, first: int) -> float:
    """Where a ray passes a limit, px, between `start` + 1 and the droplet; or NO_EDGE.

    From `first` on it has been read already.
    """
    for j in range(start, -1, -1):
        if j < first:
            ray.profile[j] = _level(ray, float(j))
        h = sign * ray.profile[j]
        if h >= limit:
            half, outer = sign * _level(ray, j + 0.5), sign * ray.profile[j + 1]
            if half >= limit:
                return float(j + 0.5 + 0.5 * (half - limit) / (half - outer))
            return float(j + 0.5 * (h - limit) / (h - half))
    return NO_EDGE


@njit(**FAST)
def _ring_edge(ray: Ray, first: int, last: int, beside: bool, scale: Floats, s: Settings) -> float:
    """The outside flank, px, of a droplet's ring; see outlines.py."""
    profile, sign = ray.profile, 1.0 if scale[1] > 0 else -1.0
    base = sign * scale[0]
    peak, height = first, -np.inf
    for j in range(first, last + 1):
        if sign * profile[j] > height:
            peak, height = j, sign * profile[j]
    place = float(peak)
    for half in (peak - 0.5, peak + 0.5):
        if first <= half <= last:
            h = sign * _level(ray, half)
            if h > height:
                place, height = half, h
    if height - base < s.min_peak * sign * scale[1]:
        return NO_EDGE
    limit = base + (height - base) / 2
    if sign * profile[last] >= limit:
        return place if beside and first < peak < last else NO_EDGE
    edge = _crossing(ray, sign, limit, last - 1, first)
    return edge if edge >= first else NO_EDGE


@njit(**FAST)
def _ring(
    profile: Floats, ends: Rows, limits: Rows, levels: Rows, s: Settings
) -> tuple[bool, float, float]:
    """Whether a droplet has a ring, and its scale: surroundings, and how far the ring is off."""
    k = len(ends)
    n_free = n_usable = 0
    for ray in range(k):
        usable = ends[ray, 2] > ends[ray, 0]
        n_usable += usable
        n_free += usable and limits[ray] == FREE
    alone = n_free >= (s.min_free if levels[1] == 0 else s.min_free_filled) * k
    n = n_free if alone else n_usable
    if n_usable < s.min_free * k:
        return False, 0.0, 0.0
    values = np.empty((3, n))  # at the end of each ray, highest, lowest
    n = 0
    for ray in range(k):
        first, last = ends[ray, 0], ends[ray, 2]
        if last <= first or (alone and limits[ray] != FREE):
            continue
        low, high = np.inf, -np.inf
        for j in range(first, last + 1):
            low, high = min(low, profile[ray, j]), max(high, profile[ray, j])
        values[0, n], values[1, n], values[2, n] = profile[ray, last], high, low
        n += 1
    inside = float(levels[2])
    crowded = not alone and levels[1] != 0
    if crowded:  # rings, if there is something else between them
        far, half = values[2] if levels[1] > 0 else values[1], s.min_rise * abs(levels[1])
        n_risen = 0
        for ray in range(n):
            n_risen += abs(inside - far[ray]) >= half and abs(values[0, ray] - far[ray]) >= half
        if n_risen < s.min_risen * n:
            return False, 0.0, 0.0
    outside = np.median(values[0]) if alone or crowded else inside
    highest, lowest = np.median(values[1]), np.median(values[2])
    over, under = highest - max(inside, outside), min(inside, outside) - lowest
    noise = s.noise * np.median(np.abs(values[0] - np.median(values[0])))
    if max(over, under) - noise < max(s.min_contrast, s.ring_share * abs(inside - outside)):
        return False, 0.0, 0.0
    return True, outside, (highest if over > under else lowest) - outside


@njit(SIGNATURE, **FAST)
def trace(
    grey: Pixels,
    boxes: Floats,
    origins: Floats,
    levels: Rows,
    neighbours: Rows,
    steps: Floats,
    settings: Settings,
    radii: Floats,
    states: Pixels,
    rings: Pixels,
) -> None:
    """Put into `radii` and `states` (N, K), `rings` (N,) what rays from `origins` (N, 2) meet."""
    s, k = settings, len(steps)
    height, width = grey.shape
    longest = 2
    for box in boxes:
        reach = s.reach * np.hypot(box[2], box[3]) + s.margin_px
        longest = max(longest, int(reach) + 3)
    profile = np.empty((k, longest))
    # the first px of a ray, its last, its last in search of a ring; and what limits these two
    ends, limits = np.empty((k, 3), np.int64), np.empty((k, 2), np.int64)
    scale, beside = np.empty(2), np.empty(neighbours.shape[1], np.int64)
    for n in range(len(boxes)):
        box, origin = boxes[n], origins[n]
        n_beside = 0
        for other in neighbours[n]:
            if other >= 0 and _beside(box, boxes[other], origin, s):
                beside[n_beside] = other
                n_beside += 1
        for ray in range(k):
            step = steps[ray]
            side = min(
                _to_side(origin[0], step[0], box[0] - box[2] / 2, box[0] + box[2] / 2),
                _to_side(origin[1], step[1], box[1] - box[3] / 2, box[1] + box[3] / 2),
            )
            side = max(side, 0.0)
            end = end_of_ring = s.reach * side + s.margin_px
            limits[ray] = FREE
            for m in range(n_beside):
                core, half_way = _until(box, boxes[beside[m]], origin, step, s.core)
                if core < end:
                    end, limits[ray, 0] = core, NEIGHBOUR
                if half_way + s.beyond_px < end_of_ring:
                    end_of_ring, limits[ray, 1] = half_way + s.beyond_px, NEIGHBOUR
            border = min(
                _to_side(origin[0], step[0], 0.0, width), _to_side(origin[1], step[1], 0.0, height)
            )
            if border < end:
                end, limits[ray, 0] = max(border, 0.0), IMAGE
            if border < end_of_ring:
                end_of_ring, limits[ray, 1] = max(border, 0.0), IMAGE
            ends[ray, 0] = int(s.inner * side)
            ends[ray, 1] = int(end)
            ends[ray, 2] = int(end_of_ring)
            one = Ray(grey, origin[0], origin[1], step[0], step[1], profile[ray])
            for j in range(ends[ray, 0], max(ends[ray, 1], ends[ray, 2]) + 1):
                profile[ray, j] = _level(one, float(j))
        ring, scale[0], scale[1] = _ring(profile, ends, limits[:, 1], levels[n], s)
        rings[n] = ring
        if not ring:
            scale[0], scale[1] = levels[n, 0], levels[n, 1]
        for ray in range(k):
            edge = NO_EDGE
            first, last = ends[ray, 0], ends[ray, 2 if ring else 1]
            if scale[1] != 0 and last - first >= 2:
                step = steps[ray]
                one = Ray(grey, origin[0], origin[1], step[0], step[1], profile[ray])
                if ring:  # it may lie a little further in
                    for j in range(first * 2 // 3, first):
                        profile[ray, j] = _level(one, float(j))
                    first = first * 2 // 3
                edge = (
                    _ring_edge(one, first, last, limits[ray, 1] == NEIGHBOUR, scale, s)
                    if ring
                    else _filled_edge(one, first, last, scale, s)
                )
            radii[n, ray] = edge if edge >= 0 else np.nan
            image = limits[ray, 1 if ring else 0] == IMAGE
            states[n, ray] = 1 if edge >= 0 else (2 if image else 0)
