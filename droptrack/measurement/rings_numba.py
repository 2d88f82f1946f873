"""Rings droplet by droplet, compiled: what rings.py says of arrays, in loops."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Bools, Floats, Pixels, Rows

FREE = 0  # of a ray that nothing limits
FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}


class Settings(NamedTuple):
    """The constants of rings.py, by their names there."""

    min_contrast: float
    ring_share: float
    crowded_share: float
    noise: float
    spread: float
    long: float
    min_free: float
    min_free_filled: float
    min_rise: float
    min_risen_rings: float
    min_risen: float
    bare: float
    second: float
    other: float
    beyond: float
    every: float
    every_of_long: float


class Looks(NamedTuple):
    """What was seen along the rays of a droplet, (K,) each."""

    highest: Floats
    at_highest: Floats
    behind_highest: Floats  # the lowest there
    lowest: Floats
    at_lowest: Floats
    behind_lowest: Floats  # the highest there
    end: Floats  # the last level


_SETTINGS = types.NamedUniTuple(types.float64, 17, Settings)  # type: ignore[no-untyped-call]
SIGNATURE = types.void(
    types.Array(types.uint8, 2, "C", readonly=True),
    types.float64[:, ::1],
    types.float64[:, ::1],
    types.int64[:, ::1],
    types.int64[:, :, ::1],
    types.int64[:, ::1],
    types.float64[:, ::1],
    types.float64,
    _SETTINGS,
    types.boolean[::1],
    types.float64[:, ::1],
)


@njit(**FAST)
def _level(grey: Pixels, x: float, y: float) -> float:
    """The grey level at a place, px, between the centres of four pixels."""
    height, width = grey.shape
    u, v = x - 0.5, y - 0.5
    left, top = min(max(int(u), 0), width - 2), min(max(int(v), 0), height - 2)
    s, t = min(max(u - left, 0.0), 1.0), min(max(v - top, 0.0), 1.0)
    above = grey[top, left] * (1 - s) + grey[top, left + 1] * s
    below = grey[top + 1, left] * (1 - s) + grey[top + 1, left + 1] * s
    return float(above * (1 - t) + below * t)


@njit(**FAST)
def _look(grey: Pixels, origin: Floats, steps: Floats, ends: Rows, looks: Looks) -> None:
    """See how high and how low the levels along rays are."""
    for ray in range(len(steps)):
        first, last = ends[ray, 0], ends[ray, 2]
        low, high, behind_low, behind_high = np.inf, -np.inf, -np.inf, np.inf
        at_low = at_high = first
        level = 0.0
        for j in range(first, last + 1):
            level = _level(grey, origin[0] + j * steps[ray, 0], origin[1] + j * steps[ray, 1])
            if level > high:
                high, at_high, behind_high = level, j, level
            if level < low:
                low, at_low, behind_low = level, j, level
            behind_high, behind_low = min(behind_high, level), max(behind_low, level)
        looks.highest[ray], looks.at_highest[ray] = high, at_high
        looks.lowest[ray], looks.at_lowest[ray] = low, at_low
        looks.behind_highest[ray], looks.behind_lowest[ray] = behind_high, behind_low
        looks.end[ray] = level


@njit(**FAST)
def _n_free(ends: Rows, limits: Rows) -> int:
    """How many rays reach the surroundings."""
    n = 0
    for ray in range(len(ends)):
        n += ends[ray, 2] > ends[ray, 0] and limits[ray] == FREE
    return n


@njit(**FAST)
def _along(box: Floats, step: Floats, long: float) -> bool:
    """Whether a ray goes along a droplet that is longer than wide; or it is not."""
    x, y = abs(step[0]) * box[3], abs(step[1]) * box[2]
    if box[2] > long * box[3]:
        return bool(x >= y)
    if box[3] > long * box[2]:
        return bool(y >= x)
    return True


@njit(**FAST)
def _ring_of_free(
    looks: Looks, free: Bools, counted: Bools, middle: float, noise: float, s: Settings
) -> tuple[bool, float, float]:
    """Whether a droplet that stands free on some rays (K,) has a ring; and its scale."""
    k, n, n_ends = len(free), 0, 0
    over_all, under_all, further, ends = np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    for ray in range(k):
        if counted[ray]:
            over_all[n] = looks.highest[ray] - max(middle, looks.behind_highest[ray])
            under_all[n] = min(middle, looks.behind_lowest[ray]) - looks.lowest[ray]
            further[n] = looks.at_highest[ray] - looks.at_lowest[ray]
            n += 1
    over, under = np.median(over_all[:n]), np.median(under_all[:n])
    if max(over, under) - noise < s.min_contrast:
        return False, 0.0, 0.0
    bright = over > under
    if min(over, under) >= max(s.min_contrast + noise, s.second * max(over, under)):
        bright = np.median(further[:n]) > 0  # the outer one of two rings
    rise, n = (over if bright else under), 0
    tops = over_all  # it is done with
    for ray in range(k):
        if free[ray]:
            tops[n] = looks.highest[ray] if bright else looks.lowest[ray]
            if abs(tops[n] - looks.end[ray]) >= s.beyond * rise:  # others end in a wall
                ends[n_ends] = looks.end[ray]
                n_ends += 1
            n += 1
    outside = float(np.median(ends[:n_ends])) if n_ends else middle
    if rise - noise < max(s.min_contrast, s.ring_share * abs(middle - outside)):
        return False, 0.0, 0.0
    return True, outside, np.median(tops[:n]) - outside


@njit(**FAST)
def _surroundings(looks: Looks, counted: Bools, levels: Rows, s: Settings) -> tuple[float, float]:
    """The scale of a long droplet without a ring: surroundings where rays end, or as they were."""
    background, contrast, middle = float(levels[0]), float(levels[1]), float(levels[2])
    outside = float(np.median(looks.end[counted]))
    if abs(outside - background) <= s.other * abs(contrast) or (
        abs(middle - outside) < s.min_contrast
    ):
        return background, contrast
    return outside, middle - outside


@njit(**FAST)
def _ring_in_crowd(
    looks: Looks, some: Bools, levels: Rows, s: Settings, min_risen: float
) -> tuple[bool, float, float]:
    """The same of a droplet between others, by what else is between them on some rays (K,)."""
    k, n, n_risen = len(some), 0, 0
    ends, highest, lowest, further = np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    middle, outside, half = float(levels[2]), float(levels[2]), s.min_rise * abs(levels[1])
    for ray in range(k):
        if not some[ray]:
            continue
        highest[n], lowest[n] = looks.highest[ray], looks.lowest[ray]
        further[n] = looks.at_highest[ray] - looks.at_lowest[ray]
        n += 1
        if levels[1] == 0:
            ends[n_risen] = looks.end[ray]
            n_risen += 1
            continue
        if levels[1] > 0:
            far, end = looks.lowest[ray], looks.behind_lowest[ray]
        else:
            far, end = looks.highest[ray], looks.behind_highest[ray]
        if abs(middle - far) >= half and abs(end - far) >= half:
            ends[n_risen] = end
            n_risen += 1
    if levels[1] != 0:  # rings, if there is something else between them
        if n_risen < min_risen * n:
            return False, 0.0, 0.0
        outside = float(np.quantile(ends[:n_risen], s.bare if levels[1] > 0 else 1 - s.bare))
    top, bottom = np.median(highest[:n]), np.median(lowest[:n])
    over, under = top - max(middle, outside), min(middle, outside) - bottom
    least = max(s.min_contrast, s.crowded_share * abs(middle - outside))
    spread = 0.0
    if min_risen >= s.min_risen:
        spread = float(s.spread * np.median(np.abs(ends[:n_risen] - np.median(ends[:n_risen]))))
    if max(over, under) - spread < least:
        return False, 0.0, 0.0
    bright = over > under
    if min(over, under) >= max(least + spread, s.second * max(over, under)):
        bright = np.median(further[:n]) > 0  # the outer one of two rings
    return True, outside, (top if bright else bottom) - outside


@njit(**FAST)
def _ring(
    looks: Looks,
    box: Floats,
    levels: Rows,
    ends: Rows,
    limits: Rows,
    steps: Floats,
    noise: float,
    s: Settings,
    min_risen: float,
) -> tuple[bool, float, float]:
    """Whether a droplet has a ring, and its scale: surroundings, and how far the ring is off."""
    k, n_some, n_along, n_counted = len(ends), 0, 0, 0
    free, some, counted = np.zeros(k, np.bool_), np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    as_was = False, float(levels[0]), float(levels[1])
    n_free = _n_free(ends, limits)
    for ray in range(k):
        some[ray] = ends[ray, 2] > ends[ray, 0]
        free[ray] = some[ray] and limits[ray] == FREE
        along = _along(box, steps[ray], s.long)
        counted[ray] = free[ray] and along
        n_some, n_along, n_counted = n_some + some[ray], n_along + along, n_counted + counted[ray]
    if n_free >= (s.min_free if levels[1] == 0 else s.min_free_filled) * k:
        if n_counted < s.min_free * n_along:
            for ray in range(k):
                counted[ray] = some[ray] and _along(box, steps[ray], s.long)
        has, base, height = _ring_of_free(
            looks, free, counted, float(levels[2]), s.noise * noise, s
        )
        if has:
            return True, float(base), float(height)
        if n_along == k:
            return as_was
        base, height = _surroundings(looks, counted, levels, s)
        return False, float(base), float(height)
    if n_some < s.min_free * k:
        return as_was
    has, base, height = _ring_in_crowd(looks, some, levels, s, min_risen)
    return (True, float(base), float(height)) if has else as_was


@njit(SIGNATURE, **FAST)
def find_rings(
    grey: Pixels,
    boxes: Floats,
    origins: Floats,
    levels: Rows,
    ends: Rows,
    limits: Rows,
    steps: Floats,
    noise: float,
    s: Settings,
    rings: Bools,
    scales: Floats,
) -> None:
    """Put into `rings` (N,) and `scales` (N, 2) what rings.py says, in its two turns."""
    k, n_free, n_rings = len(steps), 0, 0
    free = np.zeros(len(boxes), np.bool_)
    looks = Looks(
        *(np.empty(k), np.empty(k), np.empty(k)),
        *(np.empty(k), np.empty(k), np.empty(k), np.empty(k)),
    )
    for n in range(len(boxes)):
        free[n] = _n_free(ends[n], limits[n]) >= s.min_free * k
        n_free += free[n]
    for turn in range(2):
        alike = 2 * n_rings > n_free
        min_risen = s.min_risen_rings if alike else s.min_risen
        for n in range(len(boxes)):
            if (free[n] and (rings[n] or not alike)) if turn else not free[n]:
                continue
            box = boxes[n]
            long = max(box[2], box[3]) > s.long * min(box[2], box[3])
            every = int(s.every_of_long if long else s.every)
            to, limit, some = ends[n, ::every], limits[n, ::every], steps[::every]
            _look(grey, origins[n], some, to, looks)
            rings[n], scales[n, 0], scales[n, 1] = _ring(
                looks, box, levels[n], to, limit, some, noise, s, min_risen
            )
            if turn == 0:
                n_rings += rings[n]
