"""Closed paths, compiled: what closed_paths.py says of arrays, in loops."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Floats, Pixels, Rows

FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}


class Settings(NamedTuple):
    """The constants of closed_paths.py, by their names there."""

    smallest: float
    apart_px: float
    near_px: float
    min_first: float
    full: float
    min_full: float
    beyond: float
    change: float
    farther: float
    one: float


_SETTINGS = types.NamedUniTuple(types.float64, 10, Settings)  # type: ignore[no-untyped-call]
SIGNATURE = types.void(
    types.Array(types.uint8, 2, "C", readonly=True),
    types.float64[:, ::1],
    types.float64[::1],
    types.int64[:, ::1],
    types.int64[:, ::1],
    types.float64[:, ::1],
    types.int64,
    _SETTINGS,
    types.float64[:, ::1],
)


@njit(**FAST)
def _level(grey: Pixels, x: float, y: float) -> float:
    """The grey level at a place, between the centres of four pixels."""
    height, width = grey.shape
    u, v = x - 0.5, y - 0.5
    left = min(max(int(np.floor(u)), 0), width - 2)
    top = min(max(int(np.floor(v)), 0), height - 2)
    s, t = min(max(u - left, 0.0), 1.0), min(max(v - top, 0.0), 1.0)
    above = grey[top, left] * (1 - s) + grey[top, left + 1] * s
    below = grey[top + 1, left] * (1 - s) + grey[top + 1, left + 1] * s
    return float(above * (1 - t) + below * t)


@njit(**FAST)
def _find_rises(
    grey: Pixels,
    origin: Floats,
    sign: float,
    first: Rows,
    last: Rows,
    steps: Floats,
    radii: Floats,
    s: Settings,
    rises: Floats,
) -> None:
    """Put into `rises` (K, R) how high edges are; -1 where none is looked for."""
    for ray in range(len(steps)):
        dx, dy = steps[ray]
        for place in range(len(radii)):
            rises[ray, place] = -1.0
            if not s.min_first * first[ray] <= radii[place] <= last[ray]:
                continue
            highest = 0.0
            for shift in (-s.near_px, 0.0, s.near_px):
                near = radii[place] + shift - s.apart_px
                far = radii[place] + shift + s.apart_px
                outer = _level(grey, origin[0] + far * dx, origin[1] + far * dy)
                inner = _level(grey, origin[0] + near * dx, origin[1] + near * dy)
                highest = max(highest, sign * (outer - inner))
            rises[ray, place] = highest


@njit(**FAST)
def _find_path(costs: Rows, change: int, path: Rows) -> None:
    """Put into `path` (2 K,) the places of the cheapest way twice around costs (K, R)."""
    n_rays, n = costs.shape
    total, sums = np.zeros(n, np.int64), np.empty(n, np.int64)
    before = np.empty((2 * n_rays, n), np.int64)
    for k in range(2 * n_rays):
        least, at = total[0], 0  # from here, or from below
        for place in range(n):
            least += change if place else 0
            if total[place] < least:
                least, at = total[place], place
            sums[place], before[k, place] = least, at
        least, at = total[n - 1], n - 1  # from above
        for place in range(n - 1, -1, -1):
            least += change if place < n - 1 else 0
            if least < sums[place]:
                sums[place], before[k, place] = least, at
            if total[place] <= least:
                least, at = total[place], place
        for place in range(n):
            total[place] = sums[place] + costs[k % n_rays, place]
    place = int(total.argmin())
    for k in range(2 * n_rays - 1, -1, -1):
        path[k] = place
        place = before[k, place]


@njit(SIGNATURE, **FAST)
def closed_paths(
    grey: Pixels,
    origins: Floats,
    signs: Floats,
    first: Rows,
    last: Rows,
    steps: Floats,
    n_radii: int,
    s: Settings,
    found: Floats,
) -> None:
    """Put into `found` (N, K) the radii of the closed paths around `origins` (N, 2)."""
    k = len(steps)
    rises, path = np.empty((k, n_radii)), np.empty(2 * k, np.int64)
    costs = np.empty((k, n_radii), np.int64)
    change = int(np.rint(s.one * s.change * -np.log(s.smallest) / (n_radii - 1)))
    farther = s.farther * np.linspace(0, 1, n_radii)
    shares = s.smallest ** np.linspace(1, 0, n_radii)
    for n in range(len(origins)):
        radii = last[n].max() * shares
        _find_rises(grey, origins[n], signs[n], first[n], last[n], steps, radii, s, rises)
        highest = np.empty(k)
        for ray in range(k):
            highest[ray] = max(rises[ray].max(), 0.0)
        full = max(s.min_full, s.full * np.median(highest))
        for ray in range(k):
            for place in range(n_radii):
                rise = rises[ray, place]
                share = s.beyond if rise < 0 else 1 - min(rise / full, 1.0)
                costs[ray, place] = int(np.rint(s.one * (share + farther[place])))
        _find_path(costs, change, path)
        for ray in range(k):
            found[n, ray] = radii[path[ray if ray >= k // 2 else ray + k]]
