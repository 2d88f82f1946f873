"""Outlines ray by ray, compiled: what outlines.py says of arrays, in loops."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Bools, Floats, Pixels, Rows

# what limits a ray
FREE, IMAGE, NEIGHBOUR = 0, 1, 2
NO_EDGE = -1.0
FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}


class Settings(NamedTuple):
    """The constants of outlines.py, by their names there."""

    min_depth: float
    min_rise: float
    min_peak: float
    first_peak: float
    min_fall: float
    look_px: float
    min_widths: float


class Rays(NamedTuple):
    """The rays of a droplet through the image from x, y px, and the levels along each (K, S)."""

    grey: Pixels
    x: float
    y: float
    steps: Floats  # (K, 2) px
    profile: Floats  # where it has been read, every px


_SETTINGS = types.NamedUniTuple(types.float64, 7, Settings)  # type: ignore[no-untyped-call]
SIGNATURE = types.void(
    types.Array(types.uint8, 2, "C", readonly=True),
    types.float64[:, ::1],
    types.int64[:, :, ::1],
    types.int64[:, :, ::1],
    types.boolean[::1],
    types.float64[:, ::1],
    types.int64[:, ::1],
    types.float64[:, ::1],
    _SETTINGS,
    types.float64[:, ::1],
    types.uint8[:, ::1],
    types.float64[::1],
)


@njit(**FAST)
def _level(rays: Rays, ray: int, distance: float) -> float:
    """The grey level so many px along a ray, between the centres of four pixels."""
    grey = rays.grey
    height, width = grey.shape
    u = rays.x + distance * rays.steps[ray, 0] - 0.5
    v = rays.y + distance * rays.steps[ray, 1] - 0.5
    left, top = min(max(int(u), 0), width - 2), min(max(int(v), 0), height - 2)
    s, t = min(max(u - left, 0.0), 1.0), min(max(v - top, 0.0), 1.0)
    above = grey[top, left] * (1 - s) + grey[top, left + 1] * s
    below = grey[top + 1, left] * (1 - s) + grey[top + 1, left + 1] * s
    return float(above * (1 - t) + below * t)


@njit(**FAST)
def _filled_edge(
    rays: Rays, ray: int, ends: Rows, limiting: int, scale: tuple[float, float], s: Settings
) -> float:
    """The edge, px, of a droplet unlike its surroundings; see outlines.py."""
    profile, sign = rays.profile, 1.0 if scale[1] > 0 else -1.0
    base, contrast = sign * scale[0], sign * scale[1]
    first, last = int(ends[0]), int(ends[1])
    gap = first, last
    if limiting == FREE:
        gap = _first_gap(rays, ray, first, last, scale, s)
    lowest = _lowest(rays, ray, sign, gap[0], gap[1])
    place, low = float(lowest), sign * profile[ray, lowest]
    for half in (place - 0.5, place + 0.5):
        if gap[0] <= half <= gap[1]:
            h = sign * _level(rays, ray, half)
            if h < low:
                place, low = half, h
    depth = 1 - max((low - base) / contrast, 0.0)
    if depth < s.min_depth:
        return NO_EDGE
    limit, behind = base + 0.5 * contrast, base + s.min_rise * contrast
    for j in range(lowest, last + 1):
        if sign * profile[ray, j] >= behind:
            limit = base + (1 - depth / (1 + depth**2)) * contrast
            break
    if low >= limit:
        return NO_EDGE
    if sign * profile[ray, lowest] >= limit:
        return place  # a film so thin that both edges are its middle
    return float(_crossing(rays, ray, sign, limit, lowest - 1, first))


@njit(**FAST)
def _first_gap(
    rays: Rays, ray: int, first: int, last: int, scale: tuple[float, float], s: Settings
) -> tuple[int, int]:
    """From where to where, px, a ray is first about as low as the surroundings; else all of it."""
    sign = 1.0 if scale[1] > 0 else -1.0
    base, contrast = sign * scale[0], sign * scale[1]
    low, high = base + (1 - s.first_peak) * contrast, base + s.min_fall * contrast
    for start in range(first, last + 1):
        if sign * rays.profile[ray, start] <= low:
            stop = start
            while stop < last and sign * rays.profile[ray, stop + 1] <= high:
                stop += 1
            return start, stop
    return first, last


@njit(**FAST)
def _lowest(rays: Rays, ray: int, sign: float, first: int, last: int) -> int:
    """The first px of a ray, from `first` to `last`, that is the lowest."""
    lowest, low = first, np.inf
    for j in range(first, last + 1):
        if sign * rays.profile[ray, j] < low:
            lowest, low = j, sign * rays.profile[ray, j]
    return lowest


@njit(**FAST)
def _crossing(rays: Rays, ray: int, sign: float, limit: float, start: int, first: int) -> float:
    """Where a ray passes a limit, px, between `start` + 1 and the droplet; or NO_EDGE.

    From `first` on it has been read already.
    """
    profile = rays.profile
    for j in range(start, -1, -1):
        if j < first:
            profile[ray, j] = _level(rays, ray, float(j))
        h = sign * profile[ray, j]
        if h >= limit:
            half, outer = sign * _level(rays, ray, j + 0.5), sign * profile[ray, j + 1]
            if half >= limit:
                if half == outer:
                    return NO_EDGE
                return float(j + 0.5 + 0.5 * (half - limit) / (half - outer))
            return float(j + 0.5 * (h - limit) / (h - half))
    return NO_EDGE


@njit(**FAST)
def _ring_flanks(
    rays: Rays,
    ray: int,
    ends: tuple[int, int, int],
    scale: tuple[float, float],
    inside: float,
    s: Settings,
) -> tuple[float, float]:
    """The inside and outside flanks, px, of a droplet's ring; see outlines.py.

    `ends`: the first px, the last for the ring, and for a gap behind it.
    """
    first, last, end = ends
    profile, sign = rays.profile, 1.0 if scale[1] > 0 else -1.0
    base = sign * scale[0]
    ring, start, stop = sign * scale[1], first, last
    while start <= last and sign * profile[ray, start] < base + s.first_peak * ring:
        start += 1
    if start > last:
        start = first
    else:  # the first place that is about as high as the ring
        stop = start
        while stop < last and sign * profile[ray, stop + 1] >= base + (1 - s.min_fall) * ring:
            stop += 1
    peak = _lowest(rays, ray, -sign, start, stop)
    top = sign * profile[ray, peak]
    for half_px in (peak - 0.5, peak + 0.5):
        if start <= half_px <= stop:
            top = max(top, sign * _level(rays, ray, half_px))
    if top - base < s.min_peak * ring:
        return NO_EDGE, NO_EDGE
    half = base + (1 - s.min_fall) * (top - base)
    fall = peak + 1
    while fall <= end and sign * profile[ray, fall] >= half:
        fall += 1
    outer = NO_EDGE
    if fall <= end:
        rise, low = fall, top
        while rise <= end and (rise == fall or sign * profile[ray, rise] < half):
            low = min(low, sign * profile[ray, rise])
            if rise < end:
                low = min(low, sign * _level(rays, ray, rise + 0.5))
            rise += 1
        share = 0.5
        if rise <= end:
            depth = min((top - low) / max(top - base, 1e-9), 1.0)
            share = 1 - depth / (1 + depth**2)
        outer = _crossing(rays, ray, sign, base + share * (top - base), fall - 1, first)
        outer = outer if outer >= first else NO_EDGE
    return _inner_crossing(rays, ray, sign, inside + (top - inside) / 2, peak, first), outer


@njit(**FAST)
def _inner_crossing(
    rays: Rays, ray: int, sign: float, limit: float, peak: int, first: int
) -> float:
    """Where a ray rises above a limit, px, nearest before `peak` and after `first`; or NO_EDGE."""
    profile = rays.profile
    for j in range(peak - 1, first - 1, -1):
        here = sign * profile[ray, j]
        if here < limit:
            half, outer = sign * _level(rays, ray, j + 0.5), sign * profile[ray, j + 1]
            if half < limit:
                if half == outer:
                    return NO_EDGE
                return float(j + 0.5 + 0.5 * (limit - half) / (outer - half))
            return float(j + 0.5 * (limit - here) / (half - here))
    return NO_EDGE


@njit(**FAST)
def _with_shared(flanks: Floats, limits: Rows, s: Settings) -> float:
    """Put into `flanks` (K, 2) outside flanks where a ring runs into what is beside it.

    Returns the ring's width, 0 where it is unclear.
    """
    k = len(flanks)
    widths, n = np.empty(k), 0
    for ray in range(k):
        if flanks[ray, 0] >= 0 and flanks[ray, 1] >= 0:
            widths[n] = flanks[ray, 1] - flanks[ray, 0]
            n += 1
    if n < s.min_widths * k:
        return 0.0
    width = float(np.median(widths[:n]))
    for ray in range(k):
        if flanks[ray, 1] < 0 and flanks[ray, 0] >= 0 and limits[ray, 1] != IMAGE:
            flanks[ray, 1] = flanks[ray, 0] + width
    return width


@njit(**FAST)
def _find_edges(
    rays: Rays,
    ends: Rows,
    limits: Rows,
    scale: tuple[float, float],
    flanks: Floats,
    s: Settings,
) -> None:
    """Put into `flanks` (K, 2) the edges of a droplet without a ring."""
    for ray in range(len(ends)):
        flanks[ray, 0] = flanks[ray, 1] = NO_EDGE
        first, last = ends[ray, 0], ends[ray, 1]
        if scale[1] == 0 or last - first < 2:
            continue
        for j in range(first, last + 1):
            rays.profile[ray, j] = _level(rays, ray, float(j))
        flanks[ray, 1] = _filled_edge(rays, ray, ends[ray], limits[ray, 0], scale, s)


@njit(**FAST)
def _find_flanks(
    rays: Rays,
    ends: Rows,
    limits: Rows,
    inside: int,
    scale: tuple[float, float],
    flanks: Floats,
    s: Settings,
) -> None:
    """Put into `flanks` (K, 2) the inside and the outside flanks of a ring."""
    sign = 1.0 if scale[1] > 0 else -1.0
    for ray in range(len(ends)):
        flanks[ray, 0] = flanks[ray, 1] = NO_EDGE
        first, last = ends[ray, 0], ends[ray, 2]
        if scale[1] == 0 or last - first < 2:
            continue
        beyond = int(s.look_px) if limits[ray, 1] == NEIGHBOUR else 0
        first = first * 2 // 3  # it may lie a little further in
        for j in range(first, last + beyond + 1):
            rays.profile[ray, j] = _level(rays, ray, float(j))
        reach = first, max(last - beyond, first), last + beyond
        inner, outer = _ring_flanks(rays, ray, reach, scale, sign * inside, s)
        flanks[ray, 0], flanks[ray, 1] = inner, outer


@njit(SIGNATURE, **FAST)
def trace(
    grey: Pixels,
    origins: Floats,
    ends: Rows,
    limits: Rows,
    rings: Bools,
    scales: Floats,
    levels: Rows,
    steps: Floats,
    s: Settings,
    radii: Floats,
    states: Pixels,
    widths: Floats,
) -> None:
    """Put into `radii`, `states` (N, K) and `widths` (N,) what rays from `origins` (N, 2) meet.

    Widths are those of rings; NaN is there already.
    """
    k, longest = len(steps), int(s.look_px) + 3
    for n in range(len(ends)):
        for ray in range(k):
            longest = max(longest, max(ends[n, ray, 1], ends[n, ray, 2]) + int(s.look_px) + 3)
    profile, flanks = np.empty((k, longest)), np.empty((k, 2))
    for n in range(len(origins)):
        rays = Rays(grey, origins[n, 0], origins[n, 1], steps, profile)
        scale = scales[n, 0], scales[n, 1]
        if rings[n]:
            _find_flanks(rays, ends[n], limits[n], levels[n, 2], scale, flanks, s)
            widths[n] = _with_shared(flanks, limits[n], s)
        else:
            _find_edges(rays, ends[n], limits[n], scale, flanks, s)
        for ray in range(k):
            edge = flanks[ray, 1]
            image = limits[n, ray, 1 if rings[n] else 0] == IMAGE
            radii[n, ray] = edge if edge >= 0 else np.nan
            states[n, ray] = 1 if edge >= 0 else (2 if image else 0)
