"""Box -> sub-pixel centre of mass of the droplet in it, from the grey levels.

The centre of a bounding box is known to a fraction of the network's cells; the intensity-weighted
centre of an anti-aliased droplet to two thousandths of a pixel.

Droplets of about one size are cut out of the frame and worked on together: crops are (N, S, S), and
what needs a picture gets them in a column, one black pixel around each.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]
Rows = NDArray[np.int64]
Bools = NDArray[np.bool_]
T = TypeVar("T", bound=np.generic)

MARGIN = 0.25  # of the box's size, added on each side: boxes are not exact
EDGE_PX = 1.5  # reach of an anti-aliased edge beyond the half-height contour
LEAST_CONTRAST = 12.0  # grey levels between droplet and surroundings
NEIGHBOURS = 8  # boxes that a droplet may touch
SIDE_RATIO = 1.5  # of the largest to the smallest crop in a group, at most
SAMPLES = 32  # lines and columns of a crop that tell the grey levels, if it has as many
PIXELS_AT_ONCE = 4_000_000
# places in a neighbour, in its half sizes, one of which a droplet covers if it runs into it
CORE = 0.4 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])


@dataclass(frozen=True)
class _Crops:
    """N crops of S x S px: grey levels, pixel centres x and y (N, S), and the boxes (N, 4).

    square (N, S, S): squared distance from the box's centre, 1 on the ellipse inscribed in it,
    infinite beyond the crop's own width and height.
    """

    grey: NDArray[np.uint8]
    x: Float32s
    y: Float32s
    boxes: Floats
    square: Float32s


def centres_of_mass(frame: NDArray[np.uint8], boxes: Floats) -> tuple[Floats, Bools]:
    """Centres of mass (N, 2) px of the droplets in boxes (N, 4) of a frame (H, W, 3).

    Also tells (N,) whether each was measured: where the droplet does not stand out from its
    surroundings, the box's centre is given.

    A droplet is the connected region around the box's middle that lies beyond half the contrast
    between droplet and surroundings, dark or bright, and nearer to this box than to any other.
    Pixels weigh by their contrast, so that the edge counts for the part of it that is covered.
    """
    centres = boxes[:, :2].copy()
    measured = np.zeros(len(boxes), bool)
    height, width = frame.shape[:2]
    reach = boxes[:, 2:] * (0.5 + MARGIN) + EDGE_PX
    low = np.clip(np.floor(boxes[:, :2] - reach), 0, [width, height]).astype(np.int64)
    high = np.clip(np.ceil(boxes[:, :2] + reach), 0, [width, height]).astype(np.int64)
    usable = np.flatnonzero((high - low >= 3).all(axis=1))
    if not len(usable):
        return centres, measured
    grey = np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8)
    neighbours = _neighbours(boxes)
    for rows in _groups(usable, (high - low)[usable].max(axis=1)):
        crops = _cut(grey, low[rows], high[rows], boxes[rows])
        weights = _weights(crops, boxes, rows, neighbours[rows])
        total = weights.sum(axis=(1, 2), dtype=np.float64)
        some = np.maximum(total, 1e-9)
        # about the box's centre, where single precision is fine enough
        x = crops.x - boxes[rows, :1].astype(np.float32)
        y = crops.y - boxes[rows, 1:2].astype(np.float32)
        across = np.einsum("nij,nj->n", weights, x, dtype=np.float64)
        down = np.einsum("nij,ni->n", weights, y, dtype=np.float64)
        offset = np.column_stack([across, down]) / some[:, None]
        centre = boxes[rows, :2].astype(np.float32) + offset
        good = (total > 0) & (np.abs(centre - boxes[rows, :2]) < boxes[rows, 2:] / 2).all(axis=1)
        centres[rows[good]] = centre[good]
        measured[rows[good]] = True
    return centres, measured


def _groups(rows: Rows, sides: Rows) -> Iterator[Rows]:
    """Rows of about one size, not too many at once."""
    steps = np.floor(np.log(sides / sides.max()) / np.log(SIDE_RATIO) + 1e-9)
    for step in np.unique(steps):
        mine = steps == step
        n = max(1, PIXELS_AT_ONCE // int(sides[mine].max()) ** 2)
        for start in range(0, int(mine.sum()), n):
            yield rows[mine][start : start + n]


def _neighbours(boxes: Floats) -> Rows:
    """The nearest other boxes (N, K) of each, -1 where there are no more."""
    k = min(NEIGHBOURS + 1, len(boxes))
    _, near = cKDTree(boxes[:, :2]).query(boxes[:, :2], range(1, k + 1))
    near = np.asarray(near, np.int64)
    return np.where(near == np.arange(len(boxes))[:, None], -1, near)


def _cut(grey: NDArray[np.uint8], low: Rows, high: Rows, boxes: Floats) -> _Crops:
    """Cut the pixels from `low` to `high` (N, 2) around boxes (N, 4) out of a picture."""
    height, width = grey.shape
    steps = np.arange((high - low).max())
    columns, lines = low[:, :1] + steps, low[:, 1:] + steps
    pixels = grey[
        np.minimum(lines, height - 1)[:, :, None], np.minimum(columns, width - 1)[:, None, :]
    ]
    x, y = columns.astype(np.float32) + 0.5, lines.astype(np.float32) + 0.5
    u = np.where(columns < high[:, :1], _scaled(x, boxes[:, 0], boxes[:, 2]), np.inf)
    v = np.where(lines < high[:, 1:], _scaled(y, boxes[:, 1], boxes[:, 3]), np.inf)
    square = (v * v)[:, :, None] + (u * u)[:, None, :]
    return _Crops(pixels, x, y, boxes, square.astype(np.float32))


def _scaled(at: Float32s, centre: Floats, size: Floats) -> Float32s:
    """Distances (N, S) from the box's middle, 1 at its edges."""
    scale = (2 / size).astype(np.float32)
    return np.asarray((at - centre[:, None].astype(np.float32)) * scale[:, None], np.float32)


def _weights(crops: _Crops, boxes: Floats, rows: Rows, neighbours: Rows) -> Float32s:
    """How much of each pixel (N, S, S) its droplet covers; all 0 where that is unclear."""
    background, contrast, clear = _levels(crops)
    scale = np.where(clear, 1 / np.where(clear, contrast, 1), 0).astype(np.float32)
    coverage = crops.grey - background.astype(np.float32)[:, None, None]
    coverage *= scale[:, None, None]
    np.clip(coverage, 0, 1, out=coverage)
    coverage[np.isinf(crops.square)] = 0
    covered = coverage > 0.5
    region = _region(covered, crops.square)
    # those that run into a touching droplet end half way to it
    into, other = _run_into(region, crops, boxes, neighbours)
    touching = np.unique(into)
    if len(touching):
        nearer = np.ones((len(touching), *region.shape[1:]), bool)
        place = np.searchsorted(touching, into)
        for i, pixels, box in zip(place, into, boxes[other], strict=True):
            u = _scaled(crops.x[pixels : pixels + 1], box[:1], box[2:3])
            v = _scaled(crops.y[pixels : pixels + 1], box[1:2], box[3:])
            nearer[i] &= crops.square[pixels] <= (v * v)[0, :, None] + (u * u)[0, None, :]
        coverage[touching] *= nearer
        region[touching] = _region(covered[touching] & nearer, crops.square[touching])
    return np.asarray(coverage * _with_edge(region, covered & ~region), np.float32)


def _levels(crops: _Crops) -> tuple[Floats, Floats, Bools]:
    """Grey level around each droplet (N,), the droplet's above it, and where that is clear."""
    step = max(1, crops.grey.shape[1] // SAMPLES)
    grey, square = crops.grey[:, ::step, ::step], crops.square[:, ::step, ::step]
    inside = _histograms(grey, square < 0.25)
    ring = _histograms(grey, (square > 1.1**2) & (square < 4.0))
    level = _quantile(inside, 0.5)
    darkest, brightest = _quantile(ring, 0.1), _quantile(ring, 0.9)
    bright = level - darkest >= brightest - level
    half = (level + np.where(bright, darkest, brightest)) / 2
    levels = np.arange(256)
    beyond = np.where(bright[:, None], levels < half[:, None], levels > half[:, None])
    outside = ring * beyond
    background = _quantile(outside, 0.5)
    contrast = level - background
    enough = inside.any(axis=1) & outside.any(axis=1)
    return background, contrast, enough & (np.abs(contrast) >= LEAST_CONTRAST)


def _histograms(grey: NDArray[np.uint8], chosen: Bools) -> Rows:
    """How often each grey level is among the chosen pixels of each crop: (N, 256)."""
    n = len(grey)
    count = chosen.sum(axis=(1, 2))
    crop = np.repeat(np.arange(n) * 256, count)
    return np.bincount(crop + grey[chosen], minlength=n * 256).reshape(n, 256)


def _quantile(histograms: Rows, share: float) -> Floats:
    """Quantiles (N,) of grey levels, interpolated; 255 where a histogram is empty."""
    sums = histograms.cumsum(axis=1)
    place = share * np.maximum(sums[:, -1] - 1, 0)
    below = (sums <= np.floor(place)[:, None]).sum(axis=1)
    above = (sums <= np.ceil(place)[:, None]).sum(axis=1)
    return np.asarray(np.minimum(below + (place - np.floor(place)) * (above - below), 255))


def _column(crops: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Crops (N, S, S) in one picture, one below the other, with a black pixel around each."""
    n, s, _ = crops.shape
    picture = np.zeros((n, s + 2, s + 2), np.uint8)
    picture[:, 1:-1, 1:-1] = crops
    return picture.reshape(n * (s + 2), s + 2)


def _crops_of(picture: NDArray[T], n: int) -> NDArray[T]:
    """The crops (N, S, S) in a picture made by `_column`."""
    side = picture.shape[1]
    return picture.reshape(n, side, side)[:, 1:-1, 1:-1]


def _region(mask: Bools, square: Float32s) -> Bools:
    """The connected region (N, S, S) of each mask that fills most of the middle."""
    n = len(mask)
    n_labels, labels = cv2.connectedComponents(_column(mask), connectivity=4)
    numbers = _crops_of(np.asarray(labels, np.int32), n)
    middle = (square < 0.64) & mask
    found, crop = numbers[middle], np.repeat(np.arange(n), middle.sum(axis=(1, 2)))
    counts = np.bincount(found, minlength=n_labels)
    crop_of = np.zeros(n_labels, np.int64)
    crop_of[found] = crop
    best = np.full(n, -1)
    order = np.argsort(counts, kind="stable")
    order = order[counts[order] > 0]
    best[crop_of[order]] = order  # the last one, with the most, stays
    return np.asarray(numbers == best[:, None, None])


def _run_into(region: Bools, crops: _Crops, boxes: Floats, neighbours: Rows) -> tuple[Rows, Rows]:
    """Crops and the boxes beside them that are all to be told apart: their regions touch one."""
    crop, k = np.nonzero(neighbours >= 0)
    other = neighbours[crop, k]
    places = boxes[other, None, :2] + CORE * boxes[other, None, 2:] / 2  # (P, C, 2)
    corner = np.stack([crops.x[crop, 0], crops.y[crop, 0]], axis=1)[:, None] - 0.5
    at = np.floor(places - corner).astype(np.int64)
    side = region.shape[1]
    there = ((at >= 0) & (at < side)).all(axis=2)
    at = np.clip(at, 0, side - 1)
    hit = (region[crop[:, None], at[..., 1], at[..., 0]] & there).any(axis=1)
    touching = np.zeros(len(region), bool)
    touching[crop[hit]] = True
    return crop[touching[crop]], other[touching[crop]]


def _with_edge(region: Bools, others: Bools) -> Bools:
    """The region and what is within EDGE_PX of it and nearer to it than to the others.

    Within 1.5 px are the pixel itself, those beside it, and those at its corners.
    """
    n = len(region)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
    square = np.ones((3, 3), np.uint8)
    beside, at_corner, others_beside, others_near = (
        _crops_of(np.asarray(cv2.dilate(_column(part), kernel), bool), n)
        for part, kernel in (
            (region, cross),
            (region, square),
            (others, cross),
            (others, square),
        )
    )
    return np.asarray(region | (beside & ~others_beside) | (at_corner & ~others_near))
