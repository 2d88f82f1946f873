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
from droptrack.data.region import Region
from droptrack.measurement.closed_paths import closed_paths
from droptrack.measurement.rays import (
    DIRECTIONS,
    FREE,
    IMAGE,
    N_RAYS,
    NEIGHBOUR,
    end_at_region,
    find_ends,
    levels_at,
)
from droptrack.measurement.rings import find_rings

MIN_DEPTH = 0.15  # share of the height by which a film must be darker than its droplets
MIN_RISE = 0.5  # height of what is behind a film
MIN_PEAK = 0.3  # of the ring's height elsewhere that a ray's must have,
FIRST_PEAK = 0.8  # and from which on it is the ring, though what is behind it may be higher;
# of the height of what is filled: as low as that its surroundings are
MIN_FALL = 0.5  # of a ring's height by which a gap behind it must be below it, to be one
LOOK_PX = 2  # how much further a gap before a neighbour is looked for, and how much less the ring
BEHIND, BEHIND_PX = 0.06, 2.0  # of a closed path's radius, and further: no edge is looked for there
BEFORE = 0.75  # of its radius: an edge is looked for from there on
MIN_WIDTHS = 0.125  # share of rays that must show both flanks of a ring, for its width
# a ring thinner than two pixels is not as high in the image as it is: its width at half of its own
# height, px, and by how much its outside flank there lies outside, px; measured of drawn rings with
# widths of 0.4, 0.6, 0.9, 1.1, 1.4, 1.6, 1.9, 2.15, 2.5 and 2.75 px
THIN = np.array(
    [
        [1.297, 1.343, 1.428, 1.526, 1.667, 1.787, 2.006, 2.195, 2.519, 2.759],
        [0.470, 0.391, 0.281, 0.221, 0.135, 0.090, 0.047, 0.024, 0.004, 0.0],
    ]
)
SETTINGS = MIN_DEPTH, MIN_RISE, MIN_PEAK, FIRST_PEAK, MIN_FALL, float(LOOK_PX), MIN_WIDTHS
SAMPLES_AT_ONCE = 2_000_000
UNSEEN, SEEN, CUT = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class Search:
    """Where, and for what, the edges of N droplets are looked for.

    ends (N, N_RAYS, 3), limits (N, N_RAYS, 2): see `rays.find_ends`; rings (N,), scales (N, 2): see
    `rings.find_rings`.
    """

    ends: Rows
    limits: Rows
    rings: Bools
    scales: Floats

    @staticmethod
    def nothing(n: int) -> "Search":
        """That of droplets of which no edge is looked for."""
        return Search(
            ends=np.zeros((n, N_RAYS, 3), np.int64),
            limits=np.zeros((n, N_RAYS, 2), np.int64),
            rings=np.zeros(n, np.bool_),
            scales=np.zeros((n, 2)),
        )

    def __getitem__(self, rows: Rows) -> "Search":
        return Search(
            ends=self.ends[rows],
            limits=self.limits[rows],
            rings=self.rings[rows],
            scales=self.scales[rows],
        )


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


def look_for_edges(
    grey: Pixels,
    boxes: Floats,
    origins: Floats,
    levels: Rows,
    neighbours: Rows,
    region: Region | None = None,
) -> Search:
    """Where, and for what, edges of droplets in boxes (N, 4) of a grey image (H, W) are looked for.

    From origins (N, 2) in them. `levels` (N, 3) are as of `centre_of_mass.centres_and_levels`,
    `neighbours` (N, K) as of `centre_of_mass.nearest_boxes`. Rays end at the border of a region.
    """
    if not len(boxes) or min(grey.shape) < 2:
        return Search.nothing(len(boxes))
    ends, limits = find_ends((grey.shape[1], grey.shape[0]), boxes, origins, neighbours)
    if region is not None:
        end_at_region(ends, limits, origins, region)
    rings, scales = find_rings(grey, boxes, origins, levels, ends, limits)
    return Search(ends=ends, limits=limits, rings=rings, scales=scales)


def look_nearer(
    grey: Pixels, boxes: Floats, origins: Floats, levels: Rows, search: Search, rows: Rows
) -> Search:
    """The same, but of those in `rows` not far beyond the closed paths of the clearest edges."""
    rows = rows[search.scales[rows, 1] != 0]
    if not len(rows):
        return search
    reach = np.where(search.rings[rows, None], search.ends[rows, :, 2], search.ends[rows, :, 1])
    signs = -np.sign(search.scales[rows, 1])
    path = closed_paths(grey, origins[rows], signs, search.ends[rows, :, 0], reach)
    ends, last = search.ends.copy(), np.ceil((1 + BEHIND) * path + BEHIND_PX).astype(np.int64)
    ends[rows, :, 1:] = np.minimum(ends[rows, :, 1:], last[..., None])
    ends[rows, :, 0] = np.minimum(ends[rows, :, 0], (BEFORE * path).astype(np.int64))
    rings, scales = find_rings(grey, boxes, origins, levels, ends, search.limits)
    return Search(ends=ends, limits=search.limits, rings=rings, scales=scales)


def trace_outlines(grey: Pixels, origins: Floats, levels: Rows, search: Search) -> Outlines:
    """Outlines of the droplets around origins (N, 2) in a grey image (H, W).

    `levels` and `search` are those of `look_for_edges`.
    """
    n = len(origins)
    radii, states = np.full((n, N_RAYS), np.nan), np.zeros((n, N_RAYS), np.uint8)
    widths = np.full(n, np.nan)
    ends, limits, rings, scales = search.ends, search.limits, search.rings, search.scales
    if scales[:, 1].any():
        if (loops := load_loops()) is not None:
            loops.trace(
                *(grey, np.ascontiguousarray(origins), ends, limits, rings, scales),
                *(np.ascontiguousarray(levels), DIRECTIONS, loops.Settings(*SETTINGS)),
                *(radii, states, widths),
            )
        else:
            at_once = max(1, int(SAMPLES_AT_ONCE / 2 / N_RAYS / (ends.max() + LOOK_PX)))
            for start in range(0, n, at_once):
                some = slice(start, start + at_once)
                radii[some], states[some], widths[some] = _trace(
                    *(grey, origins[some], ends[some], limits[some], rings[some], scales[some]),
                    levels[some],
                )
    return Outlines(
        origins=origins,
        radii=_of_thin_rings(radii, widths),
        cut=states == CUT,
        rings=np.isfinite(widths),
    )


def _of_thin_rings(radii: Floats, widths: Floats) -> Floats:
    """Radii (N, K), further in by what thin rings seem to be too large; `widths` (N,) of rings.

    Widths are along the rays, which are oblique to rings that are not round.
    """
    rows = np.flatnonzero((widths > 0) & (widths < 2 * THIN[0, -1]))
    if not len(rows):
        return radii
    some = radii[rows]
    slopes = (np.roll(some, -1, axis=1) - np.roll(some, 1, axis=1)) * (N_RAYS / 4 / np.pi)
    cosines = some / np.hypot(some, slopes)
    cosines[np.isnan(cosines)] = 1
    excess = np.interp(widths[rows] * np.median(cosines, axis=1), *THIN)
    radii[rows] -= excess[:, None] / cosines
    return radii


def _trace(
    grey: Pixels,
    origins: Floats,
    ends: Rows,
    limits: Rows,
    rings: Bools,
    scales: Floats,
    levels: Rows,
) -> tuple[Floats, Pixels, Floats]:
    """Radii, states (M, K) and rings' widths (M,) of some droplets; 0: unclear, NaN: no ring."""
    first = ends[..., 0]
    halves = np.arange(2 * (int(ends.max(initial=0)) + LOOK_PX) + 2) / 2
    levels_there = levels_at(grey, origins[:, None, None] + halves[:, None] * DIRECTIONS[:, None])
    last = np.where(rings[:, None], ends[..., 2], ends[..., 1])
    limit = np.where(rings[:, None], limits[..., 1], limits[..., 0])
    signs = np.where(scales[:, 1] < 0, -1, 1)
    usable = (scales[:, 1] != 0)[:, None] & (last - first >= 2)
    first = np.where(rings[:, None], first * 2 // 3, first)  # a ring may lie a little further in
    radii, widths = np.full(first.shape, np.nan), np.full(len(first), np.nan)
    for kind in (rings, ~rings):
        droplet, ray = np.nonzero(usable & kind[:, None])
        if not len(droplet):
            continue
        heights = signs[droplet, None] * levels_there[droplet, ray]
        between = first[droplet, ray], last[droplet, ray]
        scale = (signs[:, None] * scales)[droplet]
        if kind is rings:
            flanks = np.full((2, *radii.shape), np.nan)
            end = between[1] + LOOK_PX * (limit[droplet, ray] == NEIGHBOUR)
            inside = signs[droplet] * levels[droplet, 2]
            flanks[:, droplet, ray] = _ring_flanks(heights, *between, end, scale, inside)
            inner, outer = flanks[0, rings], flanks[1, rings]
            radii[rings], widths[rings] = _with_shared(inner, outer, limit[rings] == IMAGE)
        else:
            free = limit[droplet, ray] == FREE
            radii[droplet, ray] = _filled_edges(heights, *between, scale, free)
    states = np.where(np.isfinite(radii), SEEN, np.where(limit == IMAGE, CUT, UNSEEN))
    widths[rings & np.isnan(widths)] = 0
    return radii, states.astype(np.uint8), widths


def _filled_edges(heights: Floats, first: Rows, last: Rows, scales: Floats, free: Bools) -> Floats:
    """The edges (R,), px, of droplets unlike their surroundings; NaN where there is none.

    `heights` (R, 2 S) of rays at every half px, `scales` (R, 2): the surroundings' and how far the
    droplet is above. Inwards from the lowest place between `first` and `last`; where no neighbour
    limits a ray, `free` (R,), from that in the first gap that is about as low as the surroundings:
    what is behind it may be a wall.
    """
    base, contrast = scales.T
    start, stop = _first_high(-heights, first, last, np.column_stack([-base - contrast, contrast]))
    gap = np.where(free, start, first), np.where(free, stop, last)
    lowest, place, low = _lowest(heights, *gap)
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
    reach = _first_high(heights, first, np.maximum(2 * last - end, first), scales)
    peak, _, lowest = _lowest(-heights, *reach)
    top = -lowest
    half = base + (1 - MIN_FALL) * (top - base)
    steps, px = np.arange(heights.shape[1] // 2), heights[:, ::2]
    fallen = (steps > peak[:, None]) & (steps <= end[:, None]) & (px < half[:, None])
    fall = np.where(fallen.any(axis=1), fallen.argmax(axis=1), end + 1)
    risen = (steps > fall[:, None]) & (steps <= end[:, None]) & (px >= half[:, None])
    rise = np.where(risen.any(axis=1), risen.argmax(axis=1), end + 1)
    halves = np.arange(heights.shape[1])
    gap = (halves >= 2 * fall[:, None]) & (halves < 2 * rise[:, None])
    gap &= halves <= 2 * end[:, None]
    deepest = np.where(gap, heights, top[:, None]).min(axis=1)
    depth = np.minimum((top - deepest) / np.maximum(top - base, 1e-9), 1)
    share = np.where(rise <= end, 1 - depth / (1 + depth**2), 0.5)
    limit = base + share * (top - base)
    outer = _crossings(heights, np.minimum(fall, end) - 1, limit)
    high = top - base >= MIN_PEAK * ring
    outer = np.where(high & (fall <= end) & (outer >= first), outer, np.nan)
    inner = _inner_crossings(heights, first, peak, inside + (top - inside) / 2)
    return np.where(high, inner, np.nan), outer


def _first_high(heights: Floats, first: Rows, last: Rows, scales: Floats) -> tuple[Rows, Rows]:
    """The px (R,) from where to where rays (R, 2 S) are first about as high as the scale says.

    From `first` to `last` where they never are.
    """
    base, full = scales.T
    steps, px = np.arange(heights.shape[1] // 2), heights[:, ::2]
    within = (steps >= first[:, None]) & (steps <= last[:, None])
    high = within & (px >= (base + FIRST_PEAK * full)[:, None])
    start = np.where(high.any(axis=1), high.argmax(axis=1), first)
    low = (steps > start[:, None]) & (px < (base + (1 - MIN_FALL) * full)[:, None])
    low &= high.any(axis=1)[:, None]
    return start, np.where(low.any(axis=1), np.minimum(low.argmax(axis=1) - 1, last), last)


def _with_shared(inner: Floats, outer: Floats, ends: Bools) -> tuple[Floats, Floats]:
    """Outside flanks (M, K) of rings, also where they run into what is beside them; widths (M,).

    That is told from the inside flanks and the width of the same ring elsewhere; not where the
    image `ends` (M, K). Widths that are unclear are 0.
    """
    widths = outer - inner
    known = np.isfinite(widths)
    width = np.zeros(len(inner))
    for m in np.flatnonzero(known.mean(axis=1) >= MIN_WIDTHS).tolist():
        width[m] = np.median(widths[m, known[m]])
    shared = np.isnan(outer) & ~ends & (width > 0)[:, None]
    return np.where(shared, inner + width[:, None], outer), width


def _inner_crossings(heights: Floats, first: Rows, peak: Rows, limit: Floats) -> Floats:
    """Where rays (R, 2 S) rise above a limit (R,), px, nearest before `peak` and after `first`.

    NaN where they do not, or are level there.
    """
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
    further[half == outer] = np.nan
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
    """Where rays (R, 2 S) pass a limit (R,), px, outside the last px up to `start` above it.

    NaN where they do not, or are level there.
    """
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
    further[half == outer] = np.nan
    return np.where(above.any(axis=1), np.where(half >= limit, further, nearer), np.nan)
