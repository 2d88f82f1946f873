"""Box -> sub-pixel centre of mass of the droplet in it, from the grey levels.

The centre of a bounding box is known to a fraction of the network's cells; the intensity-weighted
centre of an anti-aliased droplet to two thousandths of a pixel.

Droplets of about one size are cut out of the frame and worked on together. Crops (N, S, S) have a
rim of an empty pixel, so that all of them are one image, one below the other, and neighbouring
pixels are shifts in memory.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.compiled import compiled_twin
from droptrack.data.arrays import Bools, Floats, Pixels, Rows
from droptrack.data.frames import Frame, grey_plane

MARGIN = 0.25  # of the box's size, added on each side: boxes are not exact
EDGE_PX = 1.5  # reach of an anti-aliased edge beyond the half-height contour
MIN_CONTRAST = 12.0  # grey levels between droplet and surroundings
NEIGHBOURS = 8  # boxes that a droplet may touch
SIDE_RATIO = 1.5  # of the largest to the smallest crop in a group, at most
PIXELS_AT_ONCE = 600_000
CACHE_LINE = 64  # bytes
NOWHERE = 256  # instead of a grey level, beyond the frame's edge


def _grid(n: int, limit: float, low: float, high: float) -> Floats:
    """Places (P, 2) of an n x n grid over +-limit, `low` to `high` from the middle."""
    steps = (2 * np.arange(n) + 1 - n) * limit / n
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    distance = np.hypot(*places.T)
    return np.asarray(places[(distance > low) & (distance < high)])


# in units of a box's half sizes: where the droplet's grey level is read, that of its surroundings,
INSIDE, AROUND = _grid(10, 0.5, 0, 0.5), _grid(16, 1.5, 1.1, 2)
# where the droplet is looked for, and places that it covers of a neighbour if it runs into it: some
# near the neighbour's edge, since crops end before the middle of droplets that only touch
MIDDLE = _grid(8, 0.8, 0, 0.8)
CORE = np.array([[0, 0], *(r * np.eye(2)[k] for r in (0.4, -0.4, 0.7, -0.7) for k in (0, 1))])
SETTINGS = (MARGIN, EDGE_PX, MIN_CONTRAST, NEIGHBOURS, INSIDE, AROUND, MIDDLE, CORE)


@dataclass(frozen=True)
class _Crops:
    """N crops: how far pixels (N, S, S) rise above the surroundings, `full` (N,) at most.

    Pixel [k, i, j] is the frame's in line corner[k, 1] + i and column corner[k, 0] + j.
    """

    heights: Pixels
    full: Pixels
    corner: Rows  # (N, 2)
    boxes: Floats  # (N, 4)

    def scaled(self, rows: Rows, boxes: Floats) -> tuple[Floats, Floats]:
        """The pixels' x and y (M, S) from the centres of boxes (M, 4), in units of half sizes."""
        steps = np.arange(self.heights.shape[1]) + 0.5
        x, y = (
            (self.corner[rows, k, None] - boxes[:, k, None] + steps) * (2 / boxes[:, 2 + k, None])
            for k in (0, 1)
        )
        return x, y

    def pixels(self, rows: Rows, places: Floats) -> tuple[Rows, Rows]:
        """Lines and columns of places (M, Q, 2) px in crops; on the rim for those beyond."""
        at = np.floor(places).astype(np.int64) - self.corner[rows][:, None]
        np.clip(at, 0, self.heights.shape[1] - 1, out=at)
        return at[..., 1], at[..., 0]


def load_loops() -> ModuleType | None:
    """The compiled loops, if there are any; whoever loads them beforehand need not wait later."""
    return compiled_twin(__name__)


def centres_of_mass(frame: Frame, boxes: Floats) -> tuple[Floats, Bools]:
    """Centres of mass (N, 2) px of the droplets in boxes (N, 4) of a frame (H, W, 3).

    Also tells (N,) whether each was measured: where the droplet does not stand out from its
    surroundings, the box's centre is given.

    A droplet is the connected region around the box's middle that lies beyond half the contrast
    between droplet and surroundings, dark or bright, and nearer to this box than to any other.
    Pixels weigh by their contrast, so that the edge counts for the part of it that is covered.
    """
    centres, measured, _ = centres_and_levels(grey_of(frame), boxes)
    return centres, measured


def grey_of(frame: Frame) -> Pixels:
    """The grey levels (H, W) of a frame (H, W, 3), in one piece."""
    plane = grey_plane(frame)
    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if plane is None else plane
    return np.ascontiguousarray(grey, np.uint8)


def centres_and_levels(grey: Pixels, boxes: Floats) -> tuple[Floats, Bools, Rows]:
    """As `centres_of_mass` of a grey image (H, W), and the grey levels (N, 3) that it went by.

    Those are the level around each droplet, the droplet's above it, 0 where that is unclear, and
    the level of the box's middle.
    """
    centres = boxes[:, :2].copy()
    measured = np.zeros(len(boxes), bool)
    boxes = np.ascontiguousarray(boxes)
    if (loops := load_loops()) is not None:
        grey.ravel()[::CACHE_LINE].max()  # it comes into the cache sooner than bit by bit
        levels = np.zeros((len(boxes), 3), np.int64)
        loops.measure(grey, boxes, loops.Settings(*SETTINGS), centres, measured, levels)
        return centres, measured, levels
    levels = _levels(grey, boxes)
    background, contrast = levels[:, 0], levels[:, 1]
    height, width = grey.shape
    reach = boxes[:, 2:] * (0.5 + MARGIN) + EDGE_PX
    low = np.clip(np.floor(boxes[:, :2] - reach), 0, [width, height]).astype(np.int64)
    high = np.clip(np.ceil(boxes[:, :2] + reach), 0, [width, height]).astype(np.int64)
    size = high - low
    usable = np.flatnonzero((size >= 3).all(axis=1))
    if not len(usable):
        return centres, measured, levels
    neighbours = nearest_boxes(boxes)
    for rows in _groups(usable, size[usable].max(axis=1)):
        heights, full = _cut(grey, low[rows], size[rows], background[rows], contrast[rows])
        crops = _Crops(heights, full, low[rows] - 1, boxes[rows])
        total, moment = _moments(_alone(crops, boxes, neighbours[rows]))
        centre = crops.corner + 0.5 + moment / np.maximum(total, 1)[:, None]
        good = (total > 0) & (np.abs(centre - boxes[rows, :2]) < boxes[rows, 2:] / 2).all(axis=1)
        centres[rows[good]] = centre[good]
        measured[rows[good]] = True
    return centres, measured, levels


def _groups(rows: Rows, sides: Rows) -> Iterator[Rows]:
    """Rows of about one size, not too many at once."""
    steps = np.floor(np.log(sides / sides.max()) / np.log(SIDE_RATIO) + 1e-9)
    for step in np.unique(steps):
        mine = steps == step
        n = max(1, PIXELS_AT_ONCE // int(sides[mine].max()) ** 2)
        for start in range(0, int(mine.sum()), n):
            yield rows[mine][start : start + n]


def nearest_boxes(boxes: Floats) -> Rows:
    """The nearest other boxes (N, K) of each, -1 where there are no more."""
    if not len(boxes):
        return np.zeros((0, 1), np.int64)
    from scipy.spatial import cKDTree  # of runs that need it

    k = min(NEIGHBOURS + 1, len(boxes))
    _, near = cKDTree(boxes[:, :2]).query(boxes[:, :2], range(1, k + 1))
    near = np.asarray(near, np.int64)
    return np.where(near == np.arange(len(boxes))[:, None], -1, near)


def _levels(grey: Pixels, boxes: Floats) -> Rows:
    """Grey levels (N, 3): around each droplet, the droplet's above it or 0, and of its middle."""
    inside, n_inside = _samples(grey, boxes, INSIDE)
    around, n_around = _samples(grey, boxes, AROUND)
    level = _quantile(inside, 0, n_inside, 0.5)
    darkest, brightest = (_quantile(around, 0, n_around, share) for share in (0.1, 0.9))
    bright = level - darkest >= brightest - level
    half = (level + np.where(bright, darkest, brightest))[:, None] / 2
    n_below, n_not_above = (around < half).sum(axis=1), (around <= half).sum(axis=1)
    start = np.where(bright, 0, n_not_above)
    n_beyond = np.where(bright, n_below, n_around - n_not_above)
    background = np.rint(_quantile(around, start, n_beyond, 0.5)).astype(np.int64)
    middle = np.rint(level).astype(np.int64)
    contrast = middle - background
    clear = (n_inside > 0) & (n_beyond > 0) & (np.abs(contrast) >= MIN_CONTRAST)
    return np.column_stack([background, np.where(clear, contrast, 0), middle])


def _samples(grey: Pixels, boxes: Floats, places: Floats) -> tuple[NDArray[np.int16], Rows]:
    """Sorted grey levels (N, P) at places of boxes, and how many of each row are in the frame."""
    height, width = grey.shape
    x, y = (
        np.floor(boxes[:, [k]] + boxes[:, [2 + k]] / 2 * places[:, k]).astype(np.int64)
        for k in (0, 1)
    )
    there = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    levels = grey.ravel()[np.where(there, y * width + x, 0)].astype(np.int16)
    levels[~there] = NOWHERE
    return np.sort(levels, axis=1), there.sum(axis=1)


def _quantile(ordered: NDArray[np.int16], start: Rows | int, n: Rows, share: float) -> Floats:
    """Quantiles (N,), interpolated, of the values start to start + n - 1 of ordered rows."""
    row = np.arange(len(ordered))
    place = share * np.maximum(n - 1, 0)
    last = ordered.shape[1] - 1
    first = np.minimum(start + np.floor(place).astype(np.int64), last)
    second = np.minimum(start + np.ceil(place).astype(np.int64), last)
    below, above = ordered[row, first], ordered[row, second]
    return np.asarray(below + (place - np.floor(place)) * (above - below))


def _cut(
    grey: Pixels, low: Rows, size: Rows, background: Rows, contrast: Rows
) -> tuple[Pixels, Pixels]:
    """Heights (N, S, S) and the droplets' (N,), of crops from `low` (N, 2), `size` (N, 2) px large.

    Dark droplets are turned bright.
    """
    side = int(size.max()) + 2
    turn = np.where(contrast < 0, 255, 0).astype(np.uint8)[:, None, None]
    heights = np.full((len(low), side, side), turn)
    for crop, (x, y), (width, height) in zip(heights, low.tolist(), size.tolist(), strict=True):
        crop[1 : height + 1, 1 : width + 1] = grey[y : y + height, x : x + width]
    heights ^= turn
    # NumPy is fast where both arrays are whole
    base = np.full(heights.shape, background.astype(np.uint8)[:, None, None] ^ turn)
    np.maximum(heights, base, out=heights)
    heights -= base
    full = np.abs(contrast).astype(np.uint8)
    return np.minimum(heights, np.full(heights.shape, full[:, None, None])), full


def _alone(crops: _Crops, boxes: Floats, neighbours: Rows) -> Pixels:
    """The heights (N, S, S) of each crop's own droplet."""
    everyone = np.arange(len(crops.boxes))
    heights = crops.heights
    covered = heights > (crops.full // 2)[:, None, None]
    region = _region(covered, crops, everyone)
    # those that run into a touching droplet end half way to it
    touching = _run_into(region, crops, boxes, neighbours)
    if len(touching):
        nearer = _nearer(crops, touching, boxes, neighbours[touching])
        region[touching] = _region(covered[touching] & nearer, crops, touching)
        heights = heights.copy()
        heights[touching] *= nearer
    return heights * _with_edge(region, covered & ~region).view(np.uint8)


def _region(mask: Bools, crops: _Crops, rows: Rows) -> Bools:
    """The connected region of each mask (M, S, S) of crops that fills most of the middle."""
    image = mask.view(np.uint8).reshape(-1, mask.shape[2])
    n_labels, labels = cv2.connectedComponents(image, connectivity=4)
    labels = np.asarray(labels, np.int32).reshape(mask.shape)
    boxes = crops.boxes[rows]
    line, column = crops.pixels(rows, boxes[:, None, :2] + MIDDLE * boxes[:, None, 2:] / 2)
    found = labels[np.arange(len(rows))[:, None], line, column]
    counts = np.bincount(found.ravel(), minlength=n_labels)
    counts[0] = 0
    most = found[np.arange(len(found)), counts[found].argmax(axis=1)]
    return np.asarray(labels == np.where(most > 0, most, -1)[:, None, None])


def _run_into(region: Bools, crops: _Crops, boxes: Floats, neighbours: Rows) -> Rows:
    """Crops whose regions cover a place in the core of a neighbouring box."""
    crop, k = np.nonzero(neighbours >= 0)
    there = boxes[neighbours[crop, k]]
    here = crops.boxes[crop]
    reach = here[:, 2:] * (0.5 + MARGIN) + EDGE_PX + CORE.max() * there[:, 2:] / 2
    near = (np.abs(there[:, :2] - here[:, :2]) <= reach).all(axis=1)
    crop, there = crop[near], there[near]
    line, column = crops.pixels(crop, there[:, None, :2] + CORE * there[:, None, 2:] / 2)
    return np.unique(crop[region[crop[:, None], line, column].any(axis=1)])


def _nearer(crops: _Crops, rows: Rows, boxes: Floats, neighbours: Rows) -> Bools:
    """Pixels (M, S, S) of crops `rows` nearer to their own box than to the neighbours (M, K).

    Distances are in units of the boxes' half sizes.
    """
    x, y = crops.scaled(rows, crops.boxes[rows])
    nearer = np.ones((len(rows), *crops.heights.shape[1:]), bool)
    for other in neighbours.T:
        other_x, other_y = crops.scaled(rows, boxes[other])
        beyond_x = np.where(other[:, None] < 0, -np.inf, x**2 - other_x**2).astype(np.float32)
        within_y = (other_y**2 - y**2).astype(np.float32)
        nearer &= beyond_x[:, None, :] <= within_y[:, :, None]
    return nearer


def _with_edge(region: Bools, others: Bools) -> Bools:
    """The region and what is within EDGE_PX of it and nearer to it than to the others.

    Within 1.5 px are the pixel itself, those beside it, and those at its corners.
    """
    whole = _grown(region, corners=True)
    crowded = np.flatnonzero(others.reshape(len(others), -1).any(axis=1))
    if len(crowded):
        own, others = region[crowded], others[crowded]
        beside = _grown(own, corners=False) & ~_grown(others, corners=False)
        whole[crowded] &= ~_grown(others, corners=True)
        whole[crowded] |= own | beside
    return whole


def _grown(masks: Bools, *, corners: bool) -> Bools:
    """Masks (M, S, S), empty on their rims, and the pixels beside them or at their corners too."""
    flat, line = masks.ravel(), masks.shape[2]
    grown = flat.copy()
    grown[1:] |= flat[:-1]
    grown[:-1] |= flat[1:]
    lines = grown.copy() if corners else flat
    grown[line:] |= lines[:-line]
    grown[:-line] |= lines[line:]
    return grown.reshape(masks.shape)


def _moments(heights: Pixels) -> tuple[Floats, Floats]:
    """Sums (N,) of heights (N, S, S), and of heights times column and line (N, 2), exactly.

    Without products of matrices, whose threads would wait for each other beside other stages.
    """
    n, side, _ = heights.shape
    flat, steps = heights.reshape(-1, side), np.arange(side, dtype=np.float32)
    lines = cv2.reduce(flat, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).reshape(n, side).astype(float)
    by_column = np.einsum("ij,j->i", flat.astype(np.float32), steps)  # integers below 2^24
    column = by_column.reshape(n, side).sum(axis=1, dtype=float)
    return lines.sum(axis=1), np.column_stack([column, np.einsum("ij,j->i", lines, steps)])
