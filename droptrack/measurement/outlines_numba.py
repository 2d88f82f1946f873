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
    min_risen_rings: float
    min_risen: float
    bare: float
    min_peak: float
    first_peak: float
    second: float
    min_fall: float
    look_px: float
    min_widths: float


class Ray(NamedTuple):
    """A ray through the image from x, y px, in steps of one px, and the levels read along it."""

    grey: Pixels
    x: float
    y: float
    step_x: float
    step_y: float
    profile: Floats


_SETTINGS = types.NamedUniTuple(types.float64, 22, Settings)  # type: ignore[no-untyped-call]
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
def _ring_flanks(
    ray: Ray, ends: tuple[int, int, int], scale: Floats, inside: float, s: Settings
) -> tuple[float, float]:
    """The inside and outside flanks, px, of a droplet's ring; see outlines.py.

    `ends`: the first px, the last for the ring, and for a gap behind it.
    """
    first, last, end = ends
    profile, sign = ray.profile, 1.0 if scale[1] > 0 else -1.0
    base = sign * scale[0]
    ring, start, stop = sign * scale[1], first, last
    while start <= last and sign * profile[start] < base + s.first_peak * ring:
        start += 1
    if start > last:
        start = first
    else:  # the first place that is about as high as the ring
        stop = start
        while stop < last and sign * profile[stop + 1] >= base + (1 - s.min_fall) * ring:
            stop += 1
    peak, top = start, -np.inf
    for j in range(start, stop + 1):
        if sign * profile[j] > top:
            peak, top = j, sign * profile[j]
    for half_px in (peak - 0.5, peak + 0.5):
        if start <= half_px <= stop:
            top = max(top, sign * _level(ray, half_px))
    if top - base < s.min_peak * ring:
        return NO_EDGE, NO_EDGE
    half = base + (1 - s.min_fall) * (top - base)
    fall = peak + 1
    while fall <= end and sign * profile[fall] >= half:
        fall += 1
    outer = NO_EDGE
    if fall <= end:
        rise, low = fall, top
        while rise <= end and (rise == fall or sign * profile[rise] < half):
            low = min(low, sign * profile[rise])
            if rise < end:
                low = min(low, sign * _level(ray, rise + 0.5))
            rise += 1
        share = 0.5
        if rise <= end:
            depth = min((top - low) / max(top - base, 1e-9), 1.0)
            share = 1 - depth / (1 + depth**2)
        outer = _crossing(ray, sign, base + share * (top - base), fall - 1, first)
        outer = outer if outer >= first else NO_EDGE
    return _inner_crossing(ray, sign, inside + (top - inside) / 2, peak, first), outer


@njit(**FAST)
def _inner_crossing(ray: Ray, sign: float, limit: float, peak: int, first: int) -> float:
    """Where a ray rises above a limit, px, nearest before `peak` and after `first`; or NO_EDGE."""
    for j in range(peak - 1, first - 1, -1):
        here = sign * ray.profile[j]
        if here < limit:
            half, outer = sign * _level(ray, j + 0.5), sign * ray.profile[j + 1]
            if half < limit:
                return float(j + 0.5 + 0.5 * (limit - half) / (outer - half))
            return float(j + 0.5 * (limit - here) / (half - here))
    return NO_EDGE


@njit(**FAST)
def _with_shared(flanks: Floats, limits: Rows, s: Settings) -> None:
    """Put into `flanks` (K, 2) outside flanks where a ring runs into what is beside it."""
    k = len(flanks)
    widths, n = np.empty(k), 0
    for ray in range(k):
        if flanks[ray, 0] >= 0 and flanks[ray, 1] >= 0:
            widths[n] = flanks[ray, 1] - flanks[ray, 0]
            n += 1
    if n < s.min_widths * k:
        return
    width = np.median(widths[:n])
    for ray in range(k):
        if flanks[ray, 1] < 0 and flanks[ray, 0] >= 0 and limits[ray] != IMAGE:
            flanks[ray, 1] = flanks[ray, 0] + width


@njit(**FAST)
def _n_free(ends: Rows, limits: Rows) -> int:
    """How many rays reach the surroundings."""
    n = 0
    for ray in range(len(ends)):
        n += ends[ray, 2] > ends[ray, 0] and limits[ray, 1] == FREE
    return n


@njit(**FAST)
def _ring(
    profile: Floats, ends: Rows, limits: Rows, levels: Rows, s: Settings, min_risen: float
) -> tuple[bool, float, float]:
    """Whether a droplet has a ring, and its scale: surroundings, and how far the ring is off."""
    k, n_free = len(ends), _n_free(ends, limits)
    alone = n_free >= (s.min_free if levels[1] == 0 else s.min_free_filled) * k
    crowded = not alone and levels[1] != 0
    values = np.empty((4, k))  # at the end of each ray, highest, lowest, how much further out
    n = 0
    for ray in range(k):
        first, last = ends[ray, 0], ends[ray, 2]
        if last <= first or (alone and limits[ray, 1] != FREE):
            continue
        low, high = np.inf, -np.inf
        at_low = at_high = first
        for j in range(first, last + 1):
            level = profile[ray, j]
            if level > high:
                high, at_high = level, j
            if level < low:
                low, at_low = level, j
        values[3, n] = at_high - at_low
        at_end = profile[ray, last - 1] if crowded else profile[ray, last]
        values[0, n], values[1, n], values[2, n] = at_end, high, low
        n += 1
    if n < s.min_free * k:
        return False, 0.0, 0.0
    inside, outer = float(levels[2]), values[0, :n].copy()
    highest, lowest = np.median(values[1, :n]), np.median(values[2, :n])
    if crowded:  # rings, if there is something else between them
        far, half = values[2] if levels[1] > 0 else values[1], s.min_rise * abs(levels[1])
        n_risen = 0
        for ray in range(n):
            if abs(inside - far[ray]) >= half and abs(values[0, ray] - far[ray]) >= half:
                outer[n_risen] = values[0, ray]
                n_risen += 1
        if n_risen < min_risen * n:
            return False, 0.0, 0.0
        outer = outer[:n_risen]
        outside = np.quantile(outer, s.bare if levels[1] > 0 else 1 - s.bare)
    else:
        outside = np.median(outer) if alone else inside
    over, under = highest - max(inside, outside), min(inside, outside) - lowest
    noise = float(s.noise * np.median(np.abs(outer - np.median(outer))))
    if min_risen < s.min_risen and not alone:
        noise = 0.0
    least = max(s.min_contrast, s.ring_share * abs(inside - outside))
    if max(over, under) - noise < least:
        return False, 0.0, 0.0
    bright = over > under
    if min(over, under) >= max(least + noise, s.second * max(over, under)):
        bright = np.median(values[3, :n]) > 0  # the outer one of two rings
    return True, outside, (highest if bright else lowest) - outside


@njit(**FAST)
def _find_ends(
    n: int,
    size: tuple[int, int],
    boxes: Floats,
    origin: Floats,
    neighbours: Rows,
    steps: Floats,
    s: Settings,
    ends: Rows,
    limits: Rows,
) -> None:
    """Put into `ends` (K, 3) the first px of each ray, its last, its last in search of a ring.

    And into `limits` (K, 2) what limits these two.
    """
    box, n_beside = boxes[n], 0
    beside = np.empty(len(neighbours), np.int64)
    for other in neighbours:
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
        limits[ray] = FREE
        for m in range(n_beside):
            core, half_way = _until(box, boxes[beside[m]], origin, step, s.core)
            if core < end:
                end, limits[ray, 0] = core, NEIGHBOUR
            if half_way + s.beyond_px < end_of_ring:
                end_of_ring, limits[ray, 1] = half_way + s.beyond_px, NEIGHBOUR
        border = min(
            _to_side(origin[0], step[0], 0.0, size[0]), _to_side(origin[1], step[1], 0.0, size[1])
        )
        if border < end:
            end, limits[ray, 0] = max(border, 0.0), IMAGE
        if border < end_of_ring:
            end_of_ring, limits[ray, 1] = max(border, 0.0), IMAGE
        ends[ray, 0], ends[ray, 1] = int(s.inner * side), int(end)
        ends[ray, 2] = int(end_of_ring)


@njit(**FAST)
def _find_edges(
    grey: Pixels,
    origin: Floats,
    steps: Floats,
    levels: Rows,
    s: Settings,
    ends: Rows,
    limits: Rows,
    profile: Floats,
    flanks: Floats,
    min_risen: float,
) -> bool:
    """Put into `flanks` (K, 2) the inside flanks of a ring, and edges; whether there is a ring."""
    k = len(steps)
    for ray in range(k):
        one = Ray(grey, origin[0], origin[1], steps[ray, 0], steps[ray, 1], profile[ray])
        for j in range(ends[ray, 0], max(ends[ray, 1], ends[ray, 2]) + 1):
            profile[ray, j] = _level(one, float(j))
    ring, base, height = _ring(profile, ends, limits, levels, s, min_risen)
    scale = np.array([base, height]) if ring else levels[:2].astype(np.float64)
    sign = 1.0 if scale[1] > 0 else -1.0
    for ray in range(k):
        flanks[ray] = NO_EDGE
        first, last = ends[ray, 0], ends[ray, 2 if ring else 1]
        if scale[1] == 0 or last - first < 2:
            continue
        one = Ray(grey, origin[0], origin[1], steps[ray, 0], steps[ray, 1], profile[ray])
        if not ring:
            flanks[ray, 1] = _filled_edge(one, first, last, scale, s)
            continue
        beyond = int(s.look_px) if limits[ray, 1] == NEIGHBOUR else 0
        for j in range(max(ends[ray, 1], last) + 1, last + beyond + 1):
            profile[ray, j] = _level(one, float(j))
        for j in range(first * 2 // 3, first):  # it may lie a little further in
            profile[ray, j] = _level(one, float(j))
        first = first * 2 // 3
        reach = first, max(last - beyond, first), last + beyond
        flanks[ray] = _ring_flanks(one, reach, scale, sign * levels[2], s)
    if ring:
        _with_shared(flanks, limits[:, 1], s)
    return bool(ring)


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
    """Put into `radii` and `states` (N, K), `rings` (N,) what rays from `origins` (N, 2) meet.

    In two turns, as outlines.py has them.
    """
    s, k = settings, len(steps)
    size = grey.shape[1], grey.shape[0]
    longest = 2
    for box in boxes:
        reach = s.reach * np.hypot(box[2], box[3]) + s.margin_px + s.look_px
        longest = max(longest, int(reach) + 3)
    profile, flanks = np.empty((k, longest)), np.empty((k, 2))
    ends, limits = np.empty((k, 3), np.int64), np.empty((k, 2), np.int64)
    free = np.zeros(len(boxes), np.bool_)
    n_free = n_rings = 0
    for turn in range(2):
        alike = 2 * n_rings > n_free
        min_risen = s.min_risen_rings if alike else s.min_risen
        for n in range(len(boxes)):
            if turn == 1 and free[n] and (rings[n] or not alike):
                continue
            origin = origins[n]
            _find_ends(n, size, boxes, origin, neighbours[n], steps, s, ends, limits)
            if turn == 0:
                free[n] = _n_free(ends, limits) >= s.min_free * k
                if not free[n]:
                    continue
            ring = _find_edges(
                grey, origin, steps, levels[n], s, ends, limits, profile, flanks, min_risen
            )
            rings[n] = ring
            if turn == 0:
                n_free, n_rings = n_free + 1, n_rings + ring
            for ray in range(k):
                edge = flanks[ray, 1]
                image = limits[ray, 1 if ring else 0] == IMAGE
                radii[n, ray] = edge if edge >= 0 else np.nan
                states[n, ray] = 1 if edge >= 0 else (2 if image else 0)
