"""Centres of mass droplet by droplet, compiled: what centre_of_mass.py says of arrays, in loops.

The results are the same, to the last bit for droplets of up to 300 px.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from droptrack.data.arrays import Bools, Float32s, Floats, Pixels, Rows

# what a pixel of a crop is; numbers from FIRST_REGION on are regions
BARE = 0
OWN = 1  # of the region whose moments are taken
OTHER = 2  # covered, but not of this region
BEYOND = 4  # bare, but nearer to a neighbouring box, or beyond the crop
COVERED = 8
FOREIGN = 9  # covered, but nearer to a neighbouring box
FIRST_REGION = 10
FAST: dict[str, Any] = {"error_model": "numpy", "cache": True, "nogil": True}


class Settings(NamedTuple):
    """The constants of centre_of_mass.py, by their names there."""

    margin: float
    edge_px: float
    min_contrast: float
    neighbours: int
    inside: Floats
    around: Floats
    middle: Floats
    core: Floats


_SETTINGS = types.NamedTuple(  # type: ignore[no-untyped-call]
    (*(types.float64,) * 3, types.int64, *(types.float64[:, ::1],) * 4), Settings
)
# what `measure` takes; frames may be read-only
SIGNATURE = types.void(
    types.Array(types.uint8, 2, "C", readonly=True),
    types.float64[:, ::1],
    _SETTINGS,
    types.float64[:, ::1],
    types.boolean[::1],
    types.int64[:, ::1],
)


class Crop(NamedTuple):
    """A crop of the frame with a rim of one pixel, and the grey levels of the droplet in it."""

    grey: Pixels  # the frame
    state: Pixels  # line after line
    x: int  # the first column and line of the frame, rim included
    y: int
    width: int
    height: int
    background: int
    contrast: int  # below 0 where the droplet is dark


@njit(**FAST)
def _reach(size: float, settings: Settings) -> float:
    """How far a crop goes from the middle of a box of a size, px."""
    return size * (0.5 + settings.margin) + settings.edge_px


@njit(**FAST)
def _histogram(grey: Pixels, box: Floats, places: Floats, counts: Rows) -> int:
    """Count the grey levels (256,) at places of a box; returns how many are in the frame."""
    height, width = grey.shape
    counts[:] = 0
    n = 0
    for place in places:
        x = int(np.floor(box[0] + box[2] / 2 * place[0]))
        y = int(np.floor(box[1] + box[3] / 2 * place[1]))
        if 0 <= x < width and 0 <= y < height:
            counts[grey[y, x]] += 1
            n += 1
    return n


@njit(**FAST)
def _quantile(counts: Rows, start: int, n: int, share: float) -> float:
    """A quantile, interpolated, of the values start to start + n - 1 in order of a histogram."""
    place = share * (n - 1)
    first, second = start + int(np.floor(place)), start + int(np.ceil(place))
    below, level = -1, -1
    seen = 0
    while seen <= second:
        level += 1
        seen += counts[level]
        if below < 0 and seen > first:
            below = level
    return float(below + (place - np.floor(place)) * (level - below))


@njit(**FAST)
def _levels(grey: Pixels, box: Floats, settings: Settings, counts: Rows) -> tuple[int, int, int]:
    """Grey level around a droplet, the droplet's above it or 0 where unclear, of its middle."""
    n_inside = _histogram(grey, box, settings.inside, counts)
    if n_inside == 0:
        return 0, 0, 0
    level = _quantile(counts, 0, n_inside, 0.5)
    middle = int(np.rint(level))
    n_around = _histogram(grey, box, settings.around, counts)
    if n_around == 0:
        return 0, 0, middle
    darkest = _quantile(counts, 0, n_around, 0.1)
    brightest = _quantile(counts, 0, n_around, 0.9)
    bright = level - darkest >= brightest - level
    half = (level + (darkest if bright else brightest)) / 2
    start, n_beyond = 0, 0
    for value in range(256):
        if bright:
            n_beyond += counts[value] if value < half else 0
        else:
            start += counts[value] if value <= half else 0
    if not bright:
        n_beyond = n_around - start
    if n_beyond == 0:
        return 0, 0, middle
    background = int(np.rint(_quantile(counts, start, n_beyond, 0.5)))
    contrast = middle - background
    return background, contrast if abs(contrast) >= settings.min_contrast else 0, middle


@njit(**FAST)
def _cover(crop: Crop) -> None:
    """Mark the pixels that lie beyond half the contrast."""
    crop.state[: crop.width * crop.height] = BEYOND
    half = abs(crop.contrast) // 2
    limit = np.uint8(crop.background + (half if crop.contrast > 0 else -half))
    for y in range(1, crop.height - 1):
        line = crop.grey[crop.y + y, crop.x + 1 : crop.x + crop.width - 1]
        state = crop.state[y * crop.width + 1 : (y + 1) * crop.width - 1]
        if crop.contrast > 0:
            for x in range(len(line)):
                state[x] = COVERED if line[x] > limit else BARE
        else:
            for x in range(len(line)):
                state[x] = COVERED if line[x] < limit else BARE


@njit(**FAST)
def _fill(crop: Crop, seed: int, number: int, waiting: Rows) -> tuple[int, int, int, int]:
    """Give the connected COVERED pixels around a seed a number, a piece of a line at a time.

    Returns the first column and line, and those after the last.
    """
    state, width = crop.state, crop.width
    left, top, right, bottom = width, crop.height, 0, 0
    waiting[0, 0], waiting[0, 1] = seed, seed + 1
    n_waiting = 1
    while n_waiting:
        n_waiting -= 1
        start, end = waiting[n_waiting, 0], waiting[n_waiting, 1]  # all of it is of one state
        if state[start] != COVERED:
            continue
        while state[start - 1] == COVERED:
            start -= 1
        while state[end] == COVERED:
            end += 1
        state[start:end] = number
        y = start // width
        left, right = min(left, start - y * width), max(right, end - y * width)
        top, bottom = min(top, y), max(bottom, y + 1)
        for side in (-width, width):
            first, last = start + side, end + side
            some = False
            for pixel in state[first:last]:  # all of them, many at once
                some |= pixel == COVERED
            if not some:
                continue
            while state[first] != COVERED:
                first += 1
            while state[last - 1] != COVERED:
                last -= 1
            whole = True
            for pixel in state[first:last]:
                whole &= pixel == COVERED
            waiting[n_waiting, 0], waiting[n_waiting, 1] = first, last if whole else first + 1
            n_waiting += 1
            for at in range(first + 1, first if whole else last):
                if state[at] == COVERED and state[at - 1] != COVERED:
                    waiting[n_waiting, 0], waiting[n_waiting, 1] = at, at + 1
                    n_waiting += 1
    return left, top, right, bottom


@njit(**FAST)
def _pixel(crop: Crop, box: Floats, place: Floats) -> int:
    """The crop's pixel at a place of a box; that of the rim's corner for those beyond."""
    x = int(np.floor(box[0] + place[0] * box[2] / 2)) - crop.x
    y = int(np.floor(box[1] + place[1] * box[3] / 2)) - crop.y
    return y * crop.width + x if 0 <= x < crop.width and 0 <= y < crop.height else 0


@njit(**FAST)
def _region(crop: Crop, box: Floats, middle: Floats, waiting: Rows, extents: Rows) -> int:
    """The connected region of COVERED pixels that fills most of the middle of a box.

    Numbers the regions that it looks at; returns the region's number less FIRST_REGION, which is
    the row of `extents` that says where it is.
    """
    counts = np.zeros(len(middle), np.int64)
    extents[0] = 0  # where there is none
    n_regions = 0
    for place in middle:
        at = _pixel(crop, box, place)
        if crop.state[at] == COVERED:
            extents[n_regions] = _fill(crop, at, FIRST_REGION + n_regions, waiting)
            n_regions += 1
        if crop.state[at] >= FIRST_REGION:
            counts[crop.state[at] - FIRST_REGION] += 1
    return int(np.argmax(counts))


@njit(**FAST)
def _runs_into(crop: Crop, region: int, box: Floats, core: Floats) -> bool:
    """Whether a region covers a place in the core of a neighbouring box."""
    found = False
    for place in core:
        found |= crop.state[_pixel(crop, box, place)] == region
    return found


@njit(**FAST)
def _compare(crop: Crop, box: Floats, others: Floats, beyond: Float32s, within: Float32s) -> None:
    """Compare distances of a crop's pixels to its own box and to K others, in their half sizes.

    Pixel (x, y) is nearer to its own than to the k-th where beyond[k, x] <= within[k, y].
    """
    for k, other in enumerate(others):
        for x in range(crop.width):
            own_x = (crop.x - box[0] + (x + 0.5)) * (2 / box[2])
            other_x = (crop.x - other[0] + (x + 0.5)) * (2 / other[2])
            beyond[k, x] = own_x**2 - other_x**2
        for y in range(crop.height):
            own_y = (crop.y - box[1] + (y + 0.5)) * (2 / box[3])
            other_y = (crop.y - other[1] + (y + 0.5)) * (2 / other[3])
            within[k, y] = other_y**2 - own_y**2


@njit(**FAST)
def _leave_to_others(crop: Crop, beyond: Float32s, within: Float32s) -> None:
    """Mark the pixels that are nearer to other boxes, and number no regions any more."""
    own = np.empty(crop.width, np.bool_)
    for y in range(1, crop.height - 1):
        own[:] = True
        for k in range(len(beyond)):
            limit, line = within[k, y], beyond[k]
            for x in range(len(own)):
                own[x] &= line[x] <= limit
        state = crop.state[y * crop.width : (y + 1) * crop.width]
        for x in range(len(own)):
            if state[x] >= COVERED:
                state[x] = COVERED if own[x] else FOREIGN
            elif not own[x]:
                state[x] = BEYOND


@njit(**FAST)
def _mark(crop: Crop, region: int, left: int, top: int, right: int, bottom: int) -> None:
    """Make every pixel of a part of a crop OWN, OTHER, BARE or BEYOND."""
    own, others = np.uint8(region), np.uint8(COVERED)
    for y in range(top, bottom):
        line = crop.state[y * crop.width + left : y * crop.width + right]
        for x in range(len(line)):
            line[x] = OWN if line[x] == own else (OTHER if line[x] >= others else line[x])


@njit(**FAST)
def _moments(crop: Crop, region: int, extent: Rows) -> tuple[int, int, int]:
    """Sums of heights, and of heights times column and line, over a region and its edge.

    The edge is what is BARE at the region's sides and corners and nearer to it than to others.
    """
    left, top = max(extent[0] - 1, 1), max(extent[1] - 1, 1)
    right, bottom = min(extent[2] + 1, crop.width - 1), min(extent[3] + 1, crop.height - 1)
    _mark(crop, region, left - 1, top - 1, right + 1, bottom + 1)
    sign, full = (1, crop.contrast) if crop.contrast > 0 else (-1, -crop.contrast)
    n = right - left
    counted = np.empty(n, np.uint8)
    total, moment_x, moment_y = 0, 0, 0
    for y in range(top, bottom):
        here = y * crop.width + left
        up, down = here - crop.width, here + crop.width
        line = crop.state[here : here + n]
        before, after = crop.state[here - 1 : here - 1 + n], crop.state[here + 1 : here + 1 + n]
        above, below = crop.state[up : up + n], crop.state[down : down + n]
        above_before, above_after = crop.state[up - 1 : up - 1 + n], crop.state[up + 1 : up + 1 + n]
        below_before = crop.state[down - 1 : down - 1 + n]
        below_after = crop.state[down + 1 : down + 1 + n]
        for x in range(n):
            side = above[x] | before[x] | after[x] | below[x]
            corner = above_before[x] | above_after[x] | below_before[x] | below_after[x]
            at_side, at_corner = (side & OWN) != 0, (corner & (OWN | OTHER)) == OWN
            edge = (line[x] == BARE) & ((side & OTHER) == 0) & (at_side | at_corner)
            counted[x] = edge | (line[x] == OWN)
        levels = crop.grey[crop.y + y, crop.x + left : crop.x + right]
        mass, moment = 0, 0
        for x in range(n):
            height = counted[x] * min(max(sign * (levels[x] - crop.background), 0), full)
            mass += height
            moment += height * x
        total += mass
        moment_x += moment + mass * left
        moment_y += mass * y
    return total, moment_x, moment_y


@njit(**FAST)
def _nearest(boxes: Floats, order: Rows, place: int, found: Rows, squares: Floats) -> int:
    """Put the nearest other boxes of one into `found`, the nearest first; returns how many.

    `order` are the boxes from left to right, and `place` is where this one stands among them.
    """
    row, n = order[place], 0
    for step in (-1, 1):
        at = place + step
        while 0 <= at < len(order):
            other = order[at]
            x, y = boxes[other, 0] - boxes[row, 0], boxes[other, 1] - boxes[row, 1]
            if n == len(found) and x * x >= squares[n - 1]:
                break  # as are all that follow
            square = x * x + y * y
            if n < len(found) or square < squares[n - 1]:
                n = min(n + 1, len(found))
                k = n - 1
                while k > 0 and squares[k - 1] > square:
                    found[k], squares[k] = found[k - 1], squares[k - 1]
                    k -= 1
                found[k], squares[k] = other, square
            at += step
    return n


@njit(SIGNATURE, **FAST)  # compiled when it is imported, not at the first frame
def measure(
    grey: Pixels, boxes: Floats, settings: Settings, centres: Floats, measured: Bools, levels: Rows
) -> None:
    """Put into `centres` (N, 2), `measured` (N,), `levels` (N, 3) what is found in boxes (N, 4)."""
    frame = np.array([grey.shape[1], grey.shape[0]])
    low, high = np.empty((len(boxes), 2), np.int64), np.empty((len(boxes), 2), np.int64)
    max_area, longest = 0, 0
    for row in range(len(boxes)):
        for k in range(2):
            reach = _reach(boxes[row, 2 + k], settings)
            low[row, k] = min(max(np.floor(boxes[row, k] - reach), 0), frame[k])
            high[row, k] = min(max(np.ceil(boxes[row, k] + reach), 0), frame[k])
        width, height = high[row, 0] - low[row, 0] + 2, high[row, 1] - low[row, 1] + 2
        max_area, longest = max(max_area, width * height), max(longest, width, height)
    state, waiting = np.empty(max_area, np.uint8), np.empty((max_area, 2), np.int64)
    extents = np.empty((len(settings.middle), 4), np.int64)
    counts = np.empty(256, np.int64)
    max_near, core_reach = settings.neighbours, settings.core.max()
    near, squares = np.empty(max_near, np.int64), np.empty(max_near)
    others = np.empty((max_near, 4))
    beyond = np.empty((max_near, longest), np.float32)
    within = np.empty((max_near, longest), np.float32)
    order = np.argsort(boxes[:, 0], kind="mergesort")
    for place, row in enumerate(order):
        box = boxes[row]
        width, height = high[row, 0] - low[row, 0] + 2, high[row, 1] - low[row, 1] + 2
        background, contrast, middle = _levels(grey, box, settings, counts)
        levels[row, 0], levels[row, 1], levels[row, 2] = background, contrast, middle
        if width < 5 or height < 5 or contrast == 0:
            continue
        x, y = low[row, 0] - 1, low[row, 1] - 1
        crop = Crop(grey, state, x, y, width, height, background, contrast)
        _cover(crop)
        region = _region(crop, box, settings.middle, waiting, extents)
        touching = False
        n_others = _nearest(boxes, order, place, near, squares)
        for k in range(n_others):
            other = boxes[near[k]]
            others[k] = other
            near_x = abs(other[0] - box[0]) <= _reach(box[2], settings) + core_reach * other[2] / 2
            near_y = abs(other[1] - box[1]) <= _reach(box[3], settings) + core_reach * other[3] / 2
            touching |= (
                near_x and near_y and _runs_into(crop, FIRST_REGION + region, other, settings.core)
            )
        if touching:  # they end half way to it
            _compare(crop, box, others[:n_others], beyond, within)
            _leave_to_others(crop, beyond[:n_others], within)
            region = _region(crop, box, settings.middle, waiting, extents)
        total, moment_x, moment_y = _moments(crop, FIRST_REGION + region, extents[region])
        if total > 0:
            centre_x, centre_y = x + 0.5 + moment_x / total, y + 0.5 + moment_y / total
            if abs(centre_x - box[0]) < box[2] / 2 and abs(centre_y - box[1]) < box[3] / 2:
                centres[row, 0], centres[row, 1] = centre_x, centre_y
                measured[row] = True
