"""Rays -> which droplets have a ring, and how far it is off the surroundings.

A ring is darker, or brighter, than both what it is around and what lies beyond it, on most rays.
Each ray is compared with itself, so that it does not matter that some end in a wall and others in
the surroundings. Of a droplet longer than wide, as a plug, the rays along it count: those across
may see nothing but the gap to a wall. What noise alone makes of a ray is not a ring.
"""

from types import ModuleType

import numpy as np

from droptrack.compiled import compiled_twin
from droptrack.data.arrays import Bools, Floats, Pixels, Rows
from droptrack.measurement.rays import DIRECTIONS, FREE, levels_at

EVERY, EVERY_OF_LONG = 4, 1  # one ray in so many is looked at; and of droplets longer than wide
MIN_CONTRAST = 12.0  # grey levels of a ring
RING_SHARE = 0.33  # of the difference of inside and outside that a ring goes beyond them, at least,
CROWDED_SHARE = 0.5  # and between droplets that touch
NOISE = 2.4  # standard deviations of the noise by which the highest of a ray is above its ends
SPREAD = 4.0  # the same between droplets that touch, in median deviations of what is there
LONG = 1.25  # times as long as wide
MIN_FREE = 0.25  # share of rays that must reach the surroundings for a ring to be told by them
MIN_FREE_FILLED = 0.5  # the same where the droplet differs from its surroundings in any case
MIN_RISE = 0.5  # height of what is behind a film
# share of rays between crowded droplets on which there is something else: where most of the others,
# those that stand free, have rings; and where they have none
MIN_RISEN_RINGS, MIN_RISEN = 0.05, 0.5
BARE = 0.75  # quantile of levels of which some are half on a dark ring: what is between rings
SECOND = 0.5  # of the higher of a bright and a dark ring: the other counts if it lies further out
OTHER = 0.25  # of a droplet's contrast by which surroundings differ that are not the same
BEYOND = 0.5  # of a ring's height by which what it ends in differs from it, if that is no wall
SETTINGS = (
    *(MIN_CONTRAST, RING_SHARE, CROWDED_SHARE, NOISE, SPREAD, LONG, MIN_FREE, MIN_FREE_FILLED),
    *(MIN_RISE, MIN_RISEN_RINGS, MIN_RISEN, BARE, SECOND, OTHER, BEYOND),
    *(float(EVERY), float(EVERY_OF_LONG)),
)
N_FOR_NOISE = 5_000  # pixels
MEDIAN = 0.6745 * np.sqrt(6)  # of the second differences of normal numbers, without their signs


def load_loops() -> ModuleType | None:
    """The compiled loops, if there are any."""
    return compiled_twin(__name__)


def find_rings(
    grey: Pixels, boxes: Floats, origins: Floats, levels: Rows, ends: Rows, limits: Rows
) -> tuple[Bools, Floats]:
    """Which droplets (N,) have a ring; (N, 2): surroundings, how far the ring, or else it, is off.

    Of boxes (N, 4) in a grey image (H, W); `origins` and `levels` as of `trace_outlines`, `ends`
    and `limits` as of `rays.find_ends`.
    """
    rings, scales = np.zeros(len(boxes), bool), levels[:, :2].astype(float)
    rays = ends, limits[..., 1], DIRECTIONS
    noise = noise_of(grey)
    if (loops := load_loops()) is None:
        _find_rings(grey, boxes, origins, levels, *rays, noise, rings, scales)
    else:
        arrays = (np.ascontiguousarray(one) for one in (boxes, origins, levels, *rays))
        loops.find_rings(grey, *arrays, noise, loops.Settings(*SETTINGS), rings, scales)
    return rings, scales


def noise_of(grey: Pixels) -> float:
    """The standard deviation of the noise of a grey image (H, W), in grey levels.

    From the median of second differences along some of its lines, which edges do not change much.

    >>> levels = np.random.default_rng(0).normal(120, 6, (300, 400))
    >>> round(noise_of(levels.astype(np.uint8)))
    6
    """
    height, width = grey.shape
    if width < 3:
        return 0.0
    step = max(1, min(height, height * width // N_FOR_NOISE))
    lines = grey[step // 2 :: step].astype(np.int16)
    second = np.abs(lines[:, :-2] - 2 * lines[:, 1:-1] + lines[:, 2:]).ravel()
    below = np.cumsum(np.bincount(second)) / len(second)
    middle = int(np.searchsorted(below, 0.5))
    before = float(below[middle - 1]) if middle else 0.0
    share = (0.5 - before) / (float(below[middle]) - before)
    return float(max(middle - 0.5 + share, 0.0) / MEDIAN)


def _find_rings(
    grey: Pixels,
    boxes: Floats,
    origins: Floats,
    levels: Rows,
    ends: Rows,
    limits: Rows,
    steps: Floats,
    noise: float,
    rings: Bools,
    scales: Floats,
) -> None:
    """Put into `rings` and `scales`: first of droplets of which a part stands free.

    Where most of these have rings, less is asked of the others.
    """
    free = ((ends[..., 2] > ends[..., 0]) & (limits == FREE)).mean(axis=1) >= MIN_FREE
    for turn in range(2):
        alike = 2 * int(rings.sum()) > int(free.sum())
        some = np.flatnonzero(~free | (alike & ~rings) if turn else free)
        for n in some.tolist():
            along = _along(boxes[n], steps)
            some_rays = slice(None, None, EVERY if along.all() else EVERY_OF_LONG)
            first, last = ends[n, some_rays, 0], ends[n, some_rays, 2]
            places = np.arange(int(last.max()) + 1)[:, None] * steps[some_rays, None]
            found = _ring(
                *(levels_at(grey, origins[n] + places), first, last, limits[n, some_rays]),
                *(levels[n], along[some_rays], noise),
                min_risen=MIN_RISEN_RINGS if alike else MIN_RISEN,
            )
            if found is not None:
                rings[n], scales[n] = found[0], found[1:]


def _along(box: Floats, steps: Floats) -> Bools:
    """Which rays (K,) go along a droplet that is longer than wide; all, where it is not."""
    x, y = (np.abs(steps) * box[[3, 2]]).T
    if box[2] > LONG * box[3]:
        return np.asarray(x >= y)
    if box[3] > LONG * box[2]:
        return np.asarray(y >= x)
    return np.ones(len(steps), bool)


def _ring(
    profiles: Floats,
    first: Rows,
    last: Rows,
    limits: Rows,
    levels: Rows,
    along: Bools,
    noise: float,
    *,
    min_risen: float,
) -> tuple[bool, float, float] | None:
    """Whether a droplet has a ring, its surroundings, how far the ring, or it, is off.

    None: it has no ring, and what is known of it already holds.

    `profiles` (K, S) are the levels along its rays, every px.
    """
    _, contrast, middle = levels.tolist()
    some = last > first
    free = some & (limits == FREE)
    if free.mean() >= (MIN_FREE if contrast == 0 else MIN_FREE_FILLED):
        counted = free & along  # those that end half way to the next one, where there are no others
        counted = counted if counted.sum() >= MIN_FREE * along.sum() else some & along
        found = _ring_of_free(profiles, first, last, free, counted, middle, NOISE * noise)
        if found is not None or along.all():
            return found
        return _surroundings(_last_of(profiles[counted], last[counted]), levels)
    if some.mean() < MIN_FREE:
        return None
    return _ring_in_crowd(profiles[some], first[some], last[some], levels, min_risen)


def _ring_of_free(
    profiles: Floats,
    first: Rows,
    last: Rows,
    free: Bools,
    counted: Bools,
    middle: float,
    noise: float,
) -> tuple[bool, float, float] | None:
    """The same of a droplet that stands free on some rays (K,), told by those that are counted."""
    steps = np.arange(profiles.shape[1])
    within = (steps >= first[:, None]) & (steps <= last[:, None])
    ends = _last_of(profiles, last)
    tops, places, rises = [], [], []
    for sign in (1, -1):
        heights = np.where(within, sign * profiles, -np.inf)
        place, top = heights.argmax(axis=1), heights.max(axis=1)
        behind = within & (steps >= place[:, None])
        after = np.where(behind, sign * profiles, np.inf).min(axis=1)
        rise = top - np.maximum(sign * middle, after)
        tops.append(top)
        places.append(place)
        rises.append(float(np.median(rise[counted])))
    over, under = rises
    bright = over > under
    if min(over, under) >= max(MIN_CONTRAST + noise, SECOND * max(over, under)):
        bright = bool(np.median((places[0] - places[1])[counted]) > 0)  # the outer one of two rings
    sign, kind = (1, 0) if bright else (-1, 1)
    off = free & (tops[kind] - sign * ends >= BEYOND * rises[kind])  # others end in a wall
    outside = float(np.median(ends[off])) if off.any() else middle
    if rises[kind] - noise < max(MIN_CONTRAST, RING_SHARE * abs(middle - outside)):
        return None
    return True, outside, sign * float(np.median(tops[kind][free])) - outside


def _surroundings(ends: Floats, levels: Rows) -> tuple[bool, float, float] | None:
    """The same of a long droplet without a ring, whose surroundings are where rays (K,) end.

    What is beside a plug, as a wall, may be further off it than these are.
    """
    background, contrast, middle = levels.tolist()
    outside = float(np.median(ends))
    if abs(outside - background) <= OTHER * abs(contrast) or abs(middle - outside) < MIN_CONTRAST:
        return None
    return False, outside, middle - outside


def _ring_in_crowd(
    profiles: Floats, first: Rows, last: Rows, levels: Rows, min_risen: float
) -> tuple[bool, float, float] | None:
    """The same of a droplet between others, from rays (K,): by what else is between them."""
    _, contrast, middle = levels.tolist()
    steps = np.arange(profiles.shape[1])
    within = (steps >= first[:, None]) & (steps <= last[:, None])
    upper, lower = np.where(within, profiles, -np.inf), np.where(within, profiles, np.inf)
    highest, lowest = upper.max(axis=1), lower.min(axis=1)
    at_highest, at_lowest = upper.argmax(axis=1), lower.argmin(axis=1)
    ends = _last_of(profiles, last)
    outside = float(middle)
    if contrast != 0:  # rings, if there is something else between them
        far, half = lowest if contrast > 0 else highest, MIN_RISE * abs(contrast)
        if contrast > 0:
            ends = np.where(steps >= at_lowest[:, None], upper, -np.inf).max(axis=1)
        else:
            ends = np.where(steps >= at_highest[:, None], lower, np.inf).min(axis=1)
        risen = (np.abs(middle - far) >= half) & (np.abs(ends - far) >= half)
        if risen.mean() < min_risen:
            return None
        ends = ends[risen]  # some are half on a ring
        outside = float(np.quantile(ends, BARE if contrast > 0 else 1 - BARE))
    top, bottom = float(np.median(highest)), float(np.median(lowest))
    over, under = top - max(middle, outside), min(middle, outside) - bottom
    spread = SPREAD * float(np.median(np.abs(ends - np.median(ends))))
    if min_risen < MIN_RISEN:
        spread = 0.0
    least = max(MIN_CONTRAST, CROWDED_SHARE * abs(middle - outside))
    if max(over, under) - spread < least:
        return None
    bright = over > under
    if min(over, under) >= max(least + spread, SECOND * max(over, under)):
        bright = bool(np.median(at_highest - at_lowest) > 0)  # the outer one of two rings
    return True, outside, (top if bright else bottom) - outside


def _last_of(profiles: Floats, last: Rows) -> Floats:
    """The levels (K,) of profiles (K, S) at a px of each."""
    return np.asarray(np.take_along_axis(profiles, last[:, None], axis=1)[:, 0])
