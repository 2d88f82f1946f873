"""Box -> outline of the droplet in it: how far its edge is from a place inside, on 64 rays.

Rays go out from the droplet's centre, and grey levels are read along them, half a pixel apart, as
far as a droplet in this box can reach, or half way to a neighbour. The edge of a droplet that is
unlike its surroundings is where the level passes half of the difference. Where two droplets all but
touch, the film between them is not as dark as the surroundings, and half would lie too far outside:
two edges of the shape (1 - tanh(x/w))/2 whose sum falls by a share d of the height, their film in
the middle, lie where it has fallen to 1 - d/(1 + d^2). The edge of a droplet with a ring is the
ring's outside flank, at half of the ring's height; where the ring runs into a neighbour's, or into
a wall, it is as far from the ring's inside flank as around the rest of the droplet.
"""

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from droptrack.compiled import compiled_twin
from droptrack.data.arrays import Bools, Floats, Pixels, Rows

N_RAYS = 64
ANGLES = np.arange(N_RAYS) * (2 * np.pi / N_RAYS)
DIRECTIONS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])

REACH = 1.2  # how far a ray goes, in units of the box's own side there,
MARGIN_PX = 2.5  # and further
INNER = 0.6  # an edge is looked for from here on, in the same units
CORE = 0.75  # a ray ends in a neighbour, in units of its half sizes,
BEYOND_PX = 1.0  # or, in search of a ring, behind the middle between the two boxes
NESTED = 0.8  # a box's centre within so much of another box: it lies in that one, not beside it
MIN_CONTRAST = 12.0  # grey levels of a ring
RING_SHARE = 0.5  # of the difference of inside and outside that a ring goes beyond them, at least
NOISE = 4.0  # by how many median deviations of what is around the highest of a ray is above it
MIN_FREE = 0.25  # share of rays that must reach the surroundings for a ring to be told by them
MIN_FREE_FILLED = 0.5  # the same where the droplet differs from its surroundings in any case
MIN_DEPTH = 0.15  # share of the height by which a film must be darker than its droplets
MIN_RISE = 0.5  # height of what is behind a film
# share of rays between crowded droplets on which there is something else: where most of the others,
# those that stand free, have rings; and where they have none
MIN_RISEN_RINGS, MIN_RISEN = 0.05, 0.5
BARE = 0.75  # quantile of levels of which some are half on a dark ring: what is between rings
MIN_PEAK = 0.3  # of the ring's height elsewhere that a ray's must have,
FIRST_PEAK = 0.8  # and from which on it is the ring, though what is behind it may be higher
SECOND = 0.5  # of the higher of a bright and a dark ring: the other counts if it lies further out
MIN_FALL = 0.5  # of a ring's height by which a gap behind it must be below it, to be one
LOOK_PX = 2  # how much further a gap before a neighbour is looked for, and how much less the ring
MIN_WIDTHS = 0.125  # share of rays that must show both flanks of a ring, for its width
SETTINGS = (
    *(REACH, MARGIN_PX, INNER, BEYOND_PX, NESTED, CORE, MIN_CONTRAST, RING_SHARE, NOISE),
    *(MIN_FREE, MIN_FREE_FILLED, MIN_DEPTH, MIN_RISE, MIN_RISEN_RINGS, MIN_RISEN, BARE, MIN_PEAK),
    *(FIRST_PEAK, SECOND, MIN_FALL, float(LOOK_PX), MIN_WIDTHS),
)
SAMPLES_AT_ONCE = 2_000_000
# what limits a ray
FREE, IMAGE, NEIGHBOUR = 0, 1, 2
UNSEEN, SEEN, CUT = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class Outlines:
    """The outlines of N droplets.

    origins (N, 2) px; radii (N, N_RAYS) px, from there in the DIRECTIONS to the edge, NaN where it
    is not seen; cut (N, N_RAYS): not seen because the image ends; rings (N,): whether it is a
    ring's.
    """

    origins: Floats
    radii: Floats
    cut: Bools
    rings: Bools

    def __getitem__(self, rows: Rows) -> "Outlines":
        return Outlines(
            origins=self.origins[rows],
            radii=self.radii[rows],
            cut=self.cut[rows],
            rings=self.rings[rows],
        )

    def points(self) -> Floats:
        """The places (N, N_RAYS, 2) px of the edges."""
        return np.asarray(self.origins[:, None] + self.radii[..., None] * DIRECTIONS)


def load_loops() -> ModuleType | None:
    """The compiled loops, if there are any."""
    return compiled_twin(__name__)


def trace_outlines(
    grey: Pixels, boxes: Floats, origins: Floats, levels: Rows, neighbours: Rows
) -> Outlines:
    """Outlines of the droplets in boxes (N, 4) of a grey image (H, W), from origins (N, 2) in them.

    `levels` (N, 3) are as of `centre_of_mass.centres_and_levels`, `neighbours` (N, K) as of
    `centre_of_mass.nearest_boxes`.
    """
    n = len(boxes)
    radii, states = np.full((n, N_RAYS), np.nan), np.zeros((n, N_RAYS), np.uint8)
    rings = np.zeros(n, np.uint8)
    contiguous = [np.ascontiguousarray(one) for one in (boxes, origins, levels, neighbours)]
    if min(grey.shape) > 1 and (loops := load_loops()) is not None:
        loops.trace(grey, *contiguous, DIRECTIONS, loops.Settings(*SETTINGS), radii, states, rings)
    elif min(grey.shape) > 1 and n:
        radii, states, rings = _trace_all(grey, boxes, origins, levels, neighbours)
    return Outlines(origins=origins, radii=radii, cut=states == CUT, rings=rings.astype(bool))


def _trace_all(
    grey: Pixels, boxes: Floats, origins: Floats, levels: Rows, neighbours: Rows
) -> tuple[Floats, Pixels, Pixels]:
    """Radii, states (N, K) and rings (N,): first of droplets of which a part stands free.

    Where most of these have rings, less is asked of the others.
    """
    n = len(boxes)
    radii, states = np.full((n, N_RAYS), np.nan), np.zeros((n, N_RAYS), np.uint8)
    rings = np.zeros(n, np.uint8)
    first, lasts, limits = _ends(grey, boxes, np.arange(n), origins, neighbours)
    free = ((lasts[1] > first) & (limits[1] == FREE)).sum(axis=1) >= MIN_FREE * N_RAYS
    longest = REACH * np.hypot(boxes[:, 2], boxes[:, 3]) + MARGIN_PX
    at_once = max(1, int(SAMPLES_AT_ONCE / 2 / N_RAYS / longest.max()))
    for turn in range(2):
        alike = 2 * int(rings.sum()) > int(free.sum())
        some = np.flatnonzero(~free | (alike & (rings == 0)) if turn else free)
        for start in range(0, len(some), at_once):
            rows = some[start : start + at_once]
            radii[rows], states[rows], rings[rows] = _trace(
                *(grey, boxes, rows, origins[rows], levels[rows], neighbours[rows]),
                min_risen=MIN_RISEN_RINGS if alike else MIN_RISEN,
            )
    return radii, states, rings


def _trace(
    grey: Pixels,
    boxes: Floats,
    rows: Rows,
    origins: Floats,
    levels: Rows,
    neighbours: Rows,
    *,
    min_risen: float,
) -> tuple[Floats, Pixels, Bools]:
    """Radii, states (M, K) and rings (M,) of boxes `rows`."""
    first, lasts, limits = _ends(grey, boxes, rows, origins, neighbours)
    halves = np.arange(2 * (int(lasts.max(initial=0)) + LOOK_PX) + 2) / 2
    places = origins[:, None, None] + halves[:, None] * DIRECTIONS[:, None]
    levels_there = _levels_at(grey, places)
    profiles = levels_there[..., ::2]
    rings, scales = _rings(profiles, first, lasts[1], limits[1], levels, min_risen)
    last, limits = (np.where(rings[:, None], both[1], both[0]) for both in (lasts, limits))
    scales = np.where(rings[:, None], scales, levels[:, :2])
    signs = np.where(scales[:, 1] < 0, -1, 1)
    usable = (scales[:, 1] != 0)[:, None] & (last - first >= 2)
    first = np.where(rings[:, None], first * 2 // 3, first)  # a ring may lie a little further in
    radii = np.full(first.shape, np.nan)
    for kind in (rings, ~rings):
        droplet, ray = np.nonzero(usable & kind[:, None])
        if not len(droplet):
            continue
        heights = signs[droplet, None] * levels_there[droplet, ray]
        ends = first[droplet, ray], last[droplet, ray]
        scale = (signs[:, None] * scales)[droplet]
        if kind is rings:
            flanks = np.full((2, *radii.shape), np.nan)
            end = ends[1] + LOOK_PX * (limits[droplet, ray] == NEIGHBOUR)
            inside = signs[droplet] * levels[droplet, 2]
            flanks[:, droplet, ray] = _ring_flanks(heights, *ends, end, scale, inside)
            inner, outer = flanks[0, rings], flanks[1, rings]
            radii[rings] = _with_shared(inner, outer, limits[rings] == IMAGE)
        else:
            radii[droplet, ray] = _filled_edges(heights, *ends, scale)
    states = np.where(np.isfinite(radii), SEEN, np.where(limits == IMAGE, CUT, UNSEEN))
    return radii, states.astype(np.uint8), rings


def _ends(
    grey: Pixels, boxes: Floats, rows: Rows, origins: Floats, neighbours: Rows
) -> tuple[Rows, Rows, Rows]:
    """Where an edge is looked for on each ray: from px (M, K) to px (2, M, K), and what limits it.

    The second of the last px, and of what limits them, is for a ring's flank.
    """
    own = boxes[rows]
    low, high = own[:, :2] - own[:, 2:] / 2, own[:, :2] + own[:, 2:] / 2
    side = np.maximum(_to_sides(origins, low, high), 0)
    ends = np.array([REACH * side + MARGIN_PX] * 2)
    limits = np.full(ends.shape, FREE)
    for other in neighbours.T:
        there = boxes[other]
        until = _until(own, there, origins) + np.array([0, BEYOND_PX])[:, None, None]
        beside = (other >= 0) & _beside(own, there, origins)
        nearer = beside[:, None] & (until < ends)
        ends, limits = np.where(nearer, until, ends), np.where(nearer, NEIGHBOUR, limits)
    border = _to_sides(origins, np.zeros(2), np.array(grey.shape[::-1], float))
    outside = border < ends
    ends = np.where(outside, np.maximum(border, 0), ends)
    limits = np.where(outside, IMAGE, limits)
    return (INNER * side).astype(np.int64), ends.astype(np.int64), limits


def _to_sides(origins: Floats, low: Floats, high: Floats) -> Floats:
    """How far it is on each ray (M, K) until it leaves a rectangle."""
    low, high = (np.broadcast_to(one, origins.shape)[:, None] for one in (low, high))
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.where(DIRECTIONS > 0, high, low) - origins[:, None]
        far = np.where(DIRECTIONS == 0, np.inf, ahead / DIRECTIONS)
    return np.asarray(far.min(axis=2))


def _beside(own: Floats, others: Floats, origins: Floats) -> Bools:
    """Whether the second of two boxes (M, 4) is near, and neither of them lies within the other."""
    area, others_area = own[:, 2] * own[:, 3], others[:, 2] * others[:, 3]
    larger = np.where((others_area > area)[:, None], others, own)
    nested = (np.abs(own[:, :2] - others[:, :2]) < NESTED * larger[:, 2:] / 2).all(axis=1)
    nested &= np.minimum(area, others_area) < np.maximum(area, others_area) / 2
    reach = REACH * own[:, 2:] + MARGIN_PX + others[:, 2:] / 2
    return np.asarray((np.abs(others[:, :2] - origins) < reach).all(axis=1) & ~nested)


def _until(own: Floats, others: Floats, origins: Floats) -> Floats:
    """Where rays (2, M, K) reach another droplet's core, and where its box becomes the nearer one.

    Distances are in units of half sizes; squared they are a r^2 + b r + c on the way.
    """
    squares = []
    for boxes in (own, others):
        scale = 2 / boxes[:, None, 2:]
        at, step = (origins - boxes[:, :2])[:, None] * scale, DIRECTIONS * scale
        squares.append(
            np.array([(step**2).sum(2), 2 * (at * step).sum(2), (at**2 + 0 * step).sum(2)])
        )
    (own_a, own_b, own_c), (a, b, c) = squares
    entry = np.where(c > CORE**2, _first_roots(a, b, c - CORE**2), np.inf)
    half_way = np.where(own_c < c, _first_roots(own_a - a, own_b - b, own_c - c), np.inf)
    return np.array([entry, half_way])


def _first_roots(a: Floats, b: Floats, c: Floats) -> Floats:
    """The smallest positive x with a x^2 + b x + c = 0, or infinity."""
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = np.where(c * b < 0, -c / b, np.inf)
        root = np.sqrt(b * b - 4 * a * c)
        low, high = np.sort([(-b - root) / (2 * a), (-b + root) / (2 * a)], axis=0)
        curved = np.where(low > 0, low, np.where(high > 0, high, np.inf))
        curved = np.where(np.isnan(root), np.inf, curved)
    return np.where(np.abs(a) < 1e-12, straight, curved)


def _levels_at(grey: Pixels, places: Floats) -> Floats:
    """The grey levels at places (..., 2) px, between the centres of four pixels."""
    height, width = grey.shape
    u, v = places[..., 0] - 0.5, places[..., 1] - 0.5
    left = np.clip(np.floor(u), 0, width - 2).astype(np.int64)
    top = np.clip(np.floor(v), 0, height - 2).astype(np.int64)
    s, t = np.clip(u - left, 0, 1), np.clip(v - top, 0, 1)
    flat, corner = grey.ravel(), top * width + left
    above = flat[corner] * (1 - s) + flat[corner + 1] * s
    below = flat[corner + width] * (1 - s) + flat[corner + width + 1] * s
    return np.asarray(above * (1 - t) + below * t)


def _rings(
    profiles: Floats, first: Rows, last: Rows, limits: Rows, levels: Rows, min_risen: float
) -> tuple[Bools, Floats]:
    """Which droplets (M,) have a ring; surroundings, and how far the ring is off them, (M, 2)."""
    steps = np.arange(profiles.shape[2])
    inside = (steps >= first[..., None]) & (steps <= last[..., None])
    rings, scales = np.zeros(len(profiles), bool), np.zeros((len(profiles), 2))
    outer = np.take_along_axis(profiles, last[..., None], axis=2)[..., 0]
    upper, lower = (np.where(inside, profiles, far) for far in (-np.inf, np.inf))
    highest, lowest = upper.max(axis=2), lower.min(axis=2)
    at_highest, at_lowest = upper.argmax(axis=2), lower.argmin(axis=2)
    for m, (_, contrast, middle) in enumerate(levels.tolist()):
        some = last[m] > first[m]
        free = some & (limits[m] == FREE)
        alone = free.sum() >= (MIN_FREE if contrast == 0 else MIN_FREE_FILLED) * N_RAYS
        if not alone:
            free = some
        if free.sum() < MIN_FREE * N_RAYS:
            continue
        ends = outer[m, free]
        outside = float(np.median(ends)) if alone else middle
        if not alone and contrast != 0:  # rings, if there is something else between them
            ends = np.take_along_axis(profiles[m], last[m, :, None] - 1, axis=1)[free, 0]
            far, half = (lowest if contrast > 0 else highest)[m, free], MIN_RISE * abs(contrast)
            risen = (np.abs(middle - far) >= half) & (np.abs(ends - far) >= half)
            if risen.mean() < min_risen:
                continue
            ends = ends[risen]  # some are half on a ring
            outside = float(np.quantile(ends, BARE if contrast > 0 else 1 - BARE))
        top, bottom = float(np.median(highest[m, free])), float(np.median(lowest[m, free]))
        over, under = top - max(middle, outside), min(middle, outside) - bottom
        noise = NOISE * float(np.median(np.abs(ends - np.median(ends))))
        if min_risen < MIN_RISEN and not alone:
            noise = 0.0
        least = max(MIN_CONTRAST, RING_SHARE * abs(middle - outside))
        if max(over, under) - noise < least:
            continue
        bright = over > under
        if min(over, under) >= max(least + noise, SECOND * max(over, under)):
            further = at_highest[m, free] - at_lowest[m, free]
            bright = bool(np.median(further) > 0)  # the outer one of two rings
        rings[m] = True
        scales[m] = outside, (top if bright else bottom) - outside
    return rings, scales


def _filled_edges(heights: Floats, first: Rows, last: Rows, scales: Floats) -> Floats:
    """The edges (R,), px, of droplets unlike their surroundings; NaN where there is none.

    `heights` (R, 2 S) of rays at every half px, `scales` (R, 2): the surroundings' and how far the
    droplet is above. From the lowest place between `first` and `last` inwards.
    """
    base, contrast = scales.T
    lowest, place, low = _lowest(heights, first, last)
    depth = 1 - np.maximum((low - base) / contrast, 0)
    steps = np.arange(heights.shape[1] // 2)
    behind = (steps >= lowest[:, None]) & (steps <= last[:, None])
    risen = behind & (heights[:, ::2] >= (base + MIN_RISE * contrast)[:, None])
    height = np.where(risen.any(axis=1), 1 - depth / (1 + depth**2), 0.5)
    limit = base + height * contrast
    edges = np.where(
        _at(heights, 2 * lowest) >= limit, place, _crossings(heights, lowest - 1, limit)
    )
    return np.where((depth < MIN_DEPTH) | (low >= limit), np.nan, edges)


def _ring_flanks(
    heights: Floats, first: Rows, last: Rows, end: Rows, scales: Floats, inside: Floats
) -> tuple[Floats, Floats]:
    """The inside and outside flanks (R,), px, of droplets' rings; NaN where there is none.

    As `_filled_edges`; a gap behind the ring is looked for up to `end` (R,); `inside` (R,) is the
    height of what the rings are around.
    """
    base, ring = scales.T
    peak, top = _first_peak(heights, first, np.maximum(2 * last - end, first), scales)
    half = base + (1 - MIN_FALL) * (top - base)
    steps, px = np.arange(heights.shape[1] // 2), heights[:, ::2]
    fallen = (steps > peak[:, None]) & (steps <= end[:, None]) & (px < half[:, None])
    fall = np.where(fallen.any(axis=1), fallen.argmax(axis=1), end + 1)
    risen = (steps > fall[:, None]) & (steps <= end[:, None]) & (px >= half[:, None])
    rise = np.where(risen.any(axis=1), risen.argmax(axis=1), end + 1)
    halves = np.arange(heights.shape[1])
    gap = (halves >= 2 * fall[:, None]) & (halves < 2 * rise[:, None])
    gap &= halves <= 2 * end[:, None]
    lowest = np.where(gap, heights, top[:, None]).min(axis=1)
    depth = np.minimum((top - lowest) / np.maximum(top - base, 1e-9), 1)
    share = np.where(rise <= end, 1 - depth / (1 + depth**2), 0.5)
    limit = base + share * (top - base)
    outer = _crossings(heights, np.minimum(fall, end) - 1, limit)
    high = top - base >= MIN_PEAK * ring
    outer = np.where(high & (fall <= end) & (outer >= first), outer, np.nan)
    inner = _inner_crossings(heights, first, peak, inside + (top - inside) / 2)
    return np.where(high, inner, np.nan), outer


def _first_peak(heights: Floats, first: Rows, last: Rows, scales: Floats) -> tuple[Rows, Floats]:
    """The px of rays (R, 2 S) where a ring is the highest, and how high it is there.

    Of the first place that is about as high as the ring, else the highest of all.
    """
    base, ring = scales.T
    steps, px = np.arange(heights.shape[1] // 2), heights[:, ::2]
    within = (steps >= first[:, None]) & (steps <= last[:, None])
    high = within & (px >= (base + FIRST_PEAK * ring)[:, None])
    start = np.where(high.any(axis=1), high.argmax(axis=1), first)
    low = (steps > start[:, None]) & (px < (base + (1 - MIN_FALL) * ring)[:, None])
    low &= high.any(axis=1)[:, None]
    stop = np.where(low.any(axis=1), np.minimum(low.argmax(axis=1) - 1, last), last)
    peak, _, lowest = _lowest(-heights, start, stop)
    return peak, -lowest


def _with_shared(inner: Floats, outer: Floats, ends: Bools) -> Floats:
    """Outside flanks (M, K) of rings, also where they run into what is beside them.

    That is told from the inside flanks and the width of the same ring elsewhere; not where the
    image `ends` (M, K).
    """
    widths = outer - inner
    known = np.isfinite(widths)
    enough = known.mean(axis=1) >= MIN_WIDTHS
    width = np.full(len(inner), np.nan)
    for m in np.flatnonzero(enough).tolist():
        width[m] = np.median(widths[m, known[m]])
    shared = np.isnan(outer) & ~ends
    return np.where(shared, inner + width[:, None], outer)


def _inner_crossings(heights: Floats, first: Rows, peak: Rows, limit: Floats) -> Floats:
    """Where rays (R, 2 S) rise above a limit (R,), px, nearest before `peak` and after `first`."""
    n_steps = heights.shape[1] // 2
    steps = np.arange(n_steps)
    below = (steps >= first[:, None]) & (steps < peak[:, None])
    below &= heights[:, ::2] < limit[:, None]
    step = n_steps - 1 - below[:, ::-1].argmax(axis=1)
    here, half, outer = (
        _at(heights, np.minimum(2 * step + shift, 2 * n_steps - 1)) for shift in (0, 1, 2)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        further = step + 0.5 + 0.5 * (limit - half) / (outer - half)
        nearer = step + 0.5 * (limit - here) / (half - here)
    return np.where(below.any(axis=1), np.where(half < limit, further, nearer), np.nan)


def _lowest(heights: Floats, first: Rows, last: Rows) -> tuple[Rows, Floats, Floats]:
    """The lowest px of rays (R, 2 S), the half px beside it if that is lower, and its height."""
    steps = np.arange(heights.shape[1] // 2)
    inside = (steps >= first[:, None]) & (steps <= last[:, None])
    lowest = np.where(inside, heights[:, ::2], np.inf).argmin(axis=1)
    place, low = lowest.astype(float), _at(heights, 2 * lowest)
    for half in (2 * lowest - 1, 2 * lowest + 1):
        within = (half >= 2 * first) & (half <= 2 * last)
        height = np.where(within, _at(heights, np.maximum(half, 0)), np.inf)
        place, low = np.where(height < low, half / 2, place), np.minimum(low, height)
    return lowest, place, low


def _at(heights: Floats, places: Rows) -> Floats:
    """The heights (R,) of rays (R, S) at a place of each."""
    return np.asarray(np.take_along_axis(heights, places[:, None], axis=1)[:, 0])


def _crossings(heights: Floats, start: Rows, limit: Floats) -> Floats:
    """Where rays (R, 2 S) pass a limit (R,), px, outside the last px up to `start` above it."""
    n_steps = heights.shape[1] // 2
    steps = np.arange(n_steps)
    above = (steps <= start[:, None]) & (heights[:, ::2] >= limit[:, None])
    step = n_steps - 1 - above[:, ::-1].argmax(axis=1)
    here, half, outer = (
        _at(heights, np.minimum(2 * step + shift, 2 * n_steps - 1)) for shift in (0, 1, 2)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        further = step + 0.5 + 0.5 * (half - limit) / (half - outer)
        nearer = step + 0.5 * (here - limit) / (here - half)
    return np.where(above.any(axis=1), np.where(half >= limit, further, nearer), np.nan)
