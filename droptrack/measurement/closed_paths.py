"""Where a droplet's edge may be, told by all rays together: the closed path of the clearest edges.

Ray by ray, the edge of a channel's wall is as good as the droplet's. Together they tell: the path
around a droplet goes through edges half as high as those on most rays, or more, rather through
the nearer of two; and its radius changes little from ray to ray, in logarithms, so that an outline
is followed whatever its shape, but going over to a wall and back costs. The best of all paths is
found by dynamic programming (Bellman 1957), which goes around twice, so that it closes.
"""

from types import ModuleType

import numpy as np

from droptrack.compiled import compiled_twin
from droptrack.data.arrays import Floats, Pixels, Rows
from droptrack.measurement.rays import DIRECTIONS, N_RAYS, levels_at

N_RADII = 56  # that a path may have on a ray, in equal steps of the logarithm
SMALLEST = 0.12  # of them, in units of the largest
APART_PX = 1.0  # from an edge, either way, grey levels are compared there,
NEAR_PX = 0.5  # and so far from there, either way
MIN_FIRST = 0.5  # share of the way to where an edge is looked for first, from which on a path runs
FULL = (
    0.35  # share of what rays have at most, in their median, from which on an edge costs nothing,
)
MIN_FULL = 10.0  # and at least so many grey levels
BEYOND = 1.2  # what it costs where no edge is looked for, in units of a ray without an edge
CHANGE = 3.0  # what it costs if the radius changes by a factor of e, in the same units
FARTHER = 0.2  # what the largest radius costs more than the smallest: of two edges, the nearer one
ONE = 1000.0  # such a unit; costs are whole numbers, so that what is equal is equal on any machine
SETTINGS = SMALLEST, APART_PX, NEAR_PX, MIN_FIRST, FULL, MIN_FULL, BEYOND, CHANGE, FARTHER, ONE


def load_loops() -> ModuleType | None:
    """The compiled loops, if there are any."""
    return compiled_twin(__name__)


def closed_paths(grey: Pixels, origins: Floats, signs: Floats, first: Rows, last: Rows) -> Floats:
    """Radii (N, N_RAYS) px of the closed paths of the clearest edges around origins (N, 2).

    In a grey image (H, W). `signs` (N,): 1 where levels rise from the droplet outwards at its edge,
    -1 where they fall. Edges are looked for from `first` to `last` (N, N_RAYS) px.

    A disc of 12 px, 8 px from a wall that is twice as bright:

    >>> y, x = np.mgrid[:80, :80] + 0.5
    >>> grey = np.where(np.hypot(x - 40, y - 40) < 12, 90, 30) + 100 * (y > 60)
    >>> first, last = np.full((2, 1, N_RAYS), [[[6]], [[24]]])
    >>> path = closed_paths(grey.astype(np.uint8), np.full((1, 2), 40.0), -np.ones(1), first, last)
    >>> bool(np.abs(path - 12).max() < 1.5)
    True
    """
    radii = np.empty((len(origins), N_RAYS))
    if (loops := load_loops()) is None:
        for n in range(len(origins)):
            radii[n] = _closed_path(grey, origins[n], float(signs[n]), first[n], last[n])
    else:
        arrays = (np.ascontiguousarray(one) for one in (origins, signs, first, last))
        loops.closed_paths(grey, *arrays, DIRECTIONS, N_RADII, loops.Settings(*SETTINGS), radii)
    return radii


def _closed_path(grey: Pixels, origin: Floats, sign: float, first: Rows, last: Rows) -> Floats:
    """The radii (K,) of one path."""
    radii = last.max() * SMALLEST ** np.linspace(1, 0, N_RADII)
    rises = np.full((N_RAYS, N_RADII), -np.inf)
    for shift in (-NEAR_PX, 0.0, NEAR_PX):
        inner, outer = (
            levels_at(grey, origin + (radii + shift + side)[:, None] * DIRECTIONS[:, None])
            for side in (-APART_PX, APART_PX)
        )
        rises = np.maximum(rises, sign * (outer - inner))
    within = (radii >= MIN_FIRST * first[:, None]) & (radii <= last[:, None])
    rises = np.where(within, np.maximum(rises, 0), 0)
    full = max(MIN_FULL, FULL * float(np.median(rises.max(axis=1))))
    shares = np.where(within, 1 - np.minimum(rises / full, 1), BEYOND)
    costs = np.rint(ONE * (shares + FARTHER * np.linspace(0, 1, N_RADII))).astype(np.int64)
    change = round(ONE * CHANGE * -np.log(SMALLEST) / (N_RADII - 1))
    path = _find_path(costs, change)
    half = N_RAYS // 2  # from its beginning and its end the path is free
    return np.asarray(radii[np.roll(path[half : half + N_RAYS], half)])


def _find_path(costs: Rows, change: int) -> Rows:
    """The places (2 K,) of the cheapest way twice around costs (K, R)."""
    n_rays, n = costs.shape
    places = np.arange(n)
    changes = change * np.abs(places[:, None] - places)
    total, before = np.zeros(n, np.int64), np.empty((2 * n_rays, n), np.int64)
    for k in range(2 * n_rays):
        sums = total[:, None] + changes
        before[k] = sums.argmin(axis=0)
        total = sums.min(axis=0) + costs[k % n_rays]
    place, path = int(total.argmin()), np.empty(2 * n_rays, np.int64)
    for k in range(2 * n_rays - 1, -1, -1):
        path[k] = place
        place = before[k, place]
    return path
