"""Boxes -> how far an edge is looked for on each of 64 rays from a droplet's centre.

As far as a droplet in this box can reach, or half way to a neighbour, or to the image's edge.
"""

from types import ModuleType

import numpy as np

from droptrack.compiled import compiled_twin
from droptrack.data.arrays import Bools, Floats, Pixels, Rows
from droptrack.data.region import Region

N_RAYS = 64
ANGLES = np.arange(N_RAYS) * (2 * np.pi / N_RAYS)
DIRECTIONS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])

REACH = 1.35  # how far a ray goes, in units of the box's own side there,
MARGIN_PX = 2.5  # and further
INNER = 0.6  # an edge is looked for from here on, in the same units
CORE = 0.75  # a ray ends in a neighbour, in units of its half sizes,
BEYOND_PX = 1.0  # or, in search of a ring, behind the middle between the two boxes
NESTED = 0.8  # a box's centre within so much of another box: it lies in that one, not beside it
SETTINGS = REACH, MARGIN_PX, INNER, CORE, BEYOND_PX, NESTED
# what limits a ray
FREE, IMAGE, NEIGHBOUR = 0, 1, 2


def load_loops() -> ModuleType | None:
    """The compiled loops, if there are any."""
    return compiled_twin(__name__)


def levels_at(grey: Pixels, places: Floats) -> Floats:
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


def find_ends(
    size: tuple[int, int], boxes: Floats, origins: Floats, neighbours: Rows
) -> tuple[Rows, Rows]:
    """Where an edge is looked for on the rays of boxes (N, 4), from origins (N, 2) in them.

    In an image of a size (width, height); `neighbours` (N, M) are as of
    `centre_of_mass.nearest_boxes`. Ends (N, K, 3) px: the first, the last, the last in search of a
    ring's flank; and limits (N, K, 2): what limits those two.
    """
    if (loops := load_loops()) is None:
        return _find_ends(size, boxes, origins, neighbours)
    ends = np.empty((len(boxes), N_RAYS, 3), np.int64)
    limits = np.empty((len(boxes), N_RAYS, 2), np.int64)
    arrays = (np.ascontiguousarray(one) for one in (boxes, origins, neighbours))
    loops.find_ends(size, *arrays, DIRECTIONS, loops.Settings(*SETTINGS), ends, limits)
    return ends, limits


def end_at_region(ends: Rows, limits: Rows, origins: Floats, region: Region) -> None:
    """Let rays of `find_ends` that leave a region end there, in place, as at the image's edge."""
    far = origins[:, None, None] + ends[:, :, 1:, None] * DIRECTIONS[:, None]
    beyond = ~region.contains(far.reshape(-1, 2)).reshape(far.shape[:-1]).all(axis=2)
    droplet, ray = np.nonzero(beyond)
    if not len(droplet):
        return
    steps = np.arange(int(ends[droplet, ray].max()) + 1)
    places = origins[droplet, None] + steps[:, None] * DIRECTIONS[ray, None]
    out = ~region.contains(places.reshape(-1, 2)).reshape(len(droplet), -1)
    first_out = np.where(out.any(axis=1), out.argmax(axis=1), len(steps))
    last = np.maximum(first_out - 1, 0)[:, None]
    nearer = last < ends[droplet, ray, 1:]
    ends[droplet, ray, 1:] = np.minimum(last, ends[droplet, ray, 1:])
    limits[droplet, ray] = np.where(nearer, IMAGE, limits[droplet, ray])


def _find_ends(
    size: tuple[int, int], boxes: Floats, origins: Floats, neighbours: Rows
) -> tuple[Rows, Rows]:
    low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
    side = np.maximum(_to_sides(origins, low, high), 0)
    ends = np.array([REACH * side + MARGIN_PX] * 2)
    limits = np.full(ends.shape, FREE)
    for other in neighbours.T:
        there = boxes[other]
        until = _until(boxes, there, origins) + np.array([0, BEYOND_PX])[:, None, None]
        beside = (other >= 0) & _beside(boxes, there, origins)
        nearer = beside[:, None] & (until < ends)
        ends, limits = np.where(nearer, until, ends), np.where(nearer, NEIGHBOUR, limits)
    border = _to_sides(origins, np.zeros(2), np.array(size, float))
    outside = border < ends
    ends = np.where(outside, np.maximum(border, 0), ends)
    limits = np.where(outside, IMAGE, limits)
    first = (INNER * side)[..., None]
    last = np.moveaxis(ends, 0, 2)
    return np.concatenate([first, last], axis=2).astype(np.int64), np.moveaxis(limits, 0, 2)


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
