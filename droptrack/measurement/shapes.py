"""Outline -> size and shape of a droplet.

Integrals over the droplet are sums over its N_RAYS rays, by the trapezium rule, which converges
faster than any power for smooth outlines. Lengths in px.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Bools, Floats
from droptrack.measurement.outlines import Outlines
from droptrack.measurement.rays import DIRECTIONS, N_RAYS

Number = TypeVar("Number", bound=np.generic)
COLUMNS = (
    *("area_px2", "diameter_px", "major_px", "minor_px", "angle_rad", "perimeter_px"),
    *("circularity", "deformation", "outline_seen", "at_edge"),
)
# what they are of, for the first lines of a table
DEFINITION = (
    "of the outline at half of the edge's height; of a ring, its outside; films between droplets "
    "belong to none"
)
RAYS = DIRECTIONS @ [1, 1j]  # the directions as complex numbers
PRODUCTS = np.column_stack([DIRECTIONS**2, DIRECTIONS.prod(axis=1)])
AREA, DIAMETER, OUTLINE_SEEN, AT_EDGE = map(
    COLUMNS.index, ("area_px2", "diameter_px", "outline_seen", "at_edge")
)
MIN_SEEN = 0.5  # share of rays that must meet an edge for a droplet to be measured
MAX_GAP = N_RAYS // 6  # rays in a row that may meet none
OUTLIER_RAYS = 4  # an edge that is off those so many rays before and after it is not the droplet's,
OUTLIER, OUTLIER_PX = 0.2, 1.5  # if it is off by this share of the radius, and this much
BEND_RAYS = 2  # how sharply an outline bends inwards is told from so many rays before and after
CURVED = np.radians(28.0)  # by so much a droplet's outline turns anyway, on so many rays
BEND, BEND_PX = np.radians(30.0), 0.5  # angle from which on, and how deep, it is a bend
JAG_RAYS = 4  # an edge so many rays from a bend, or fewer, is dropped where it is off the median
JAG, JAG_PX = 0.06, 0.7  # of as many before and after it by this share of the radius, and this much
MIN_SEEN_OF_CUT = 0.35  # share of the outline from which a whole circle is told
MAX_RESIDUAL, MAX_RESIDUAL_PX = 0.01, 0.1  # of points from that circle, rms


def without_outliers(radii: Floats) -> Floats:
    """Radii (N, K) without those that stick out of, or into, the outline before and after them."""
    with np.errstate(invalid="ignore"):
        before = radii - _turned(radii, OUTLIER_RAYS)
        after = radii - _turned(radii, -OUTLIER_RAYS)
        limit = OUTLIER * radii + OUTLIER_PX
        out = ((before > limit) & (after > limit)) | ((before < -limit) & (after < -limit))
    return np.where(out, np.nan, radii)


def whole_outlines(radii: Floats) -> tuple[Floats, Bools]:
    """Radii (N, K) with gaps bridged, and for which droplets (N,) that may be done."""
    seen = np.isfinite(radii)
    good: Bools = np.asarray(seen.mean(axis=1) >= MIN_SEEN)
    whole = radii.copy()
    places = np.arange(N_RAYS)
    for n in np.flatnonzero(good & ~seen.all(axis=1)).tolist():
        at = np.flatnonzero(seen[n])
        good[n] = np.diff(at, append=at[0] + N_RAYS).max() <= MAX_GAP + 1
        whole[n] = np.interp(places, at, radii[n, at], period=N_RAYS)
    whole[~good] = np.nan
    return whole, good


def smooth_outlines(radii: Floats) -> tuple[Floats, Floats, Bools, Bools]:
    """Outlines without jags, of radii (N, K): where they bend inwards, edges are looked at again.

    Those that are off the ones around them are dropped. Returns the radii that are left; the same
    with gaps bridged; for which droplets (N,) that may be done; and which outlines (N,) had bends:
    of a hollow droplet, or since a part of it is a wall's or a neighbour's.

    >>> rough = np.full((2, N_RAYS), 20.0)
    >>> rough[1, 5:7] = 25
    >>> left, whole, good, bent = smooth_outlines(rough)
    >>> np.isnan(left).sum(axis=1).tolist(), float(whole.max()), good.tolist(), bent.tolist()
    ([0, 2], 20.0, [True, True], [False, True])
    """
    whole, good = whole_outlines(radii)
    bends = _bends(whole)
    bent = np.asarray(bends.any(axis=1))
    if bent.any():
        radii = radii.copy()
        radii[bent] = _without_jags(radii[bent], whole[bent], bends[bent])
        whole[bent], good[bent] = whole_outlines(radii[bent])
    return radii, whole, good, bent


def _bends(radii: Floats) -> Bools:
    """Where whole outlines (N, K) bend inwards sharply; nowhere if they are NaN."""
    chord, turn = _turns(radii)
    deep = turn.imag > BEND_PX * np.abs(chord)
    return np.asarray(deep & (turn.imag > np.tan(BEND) * turn.real))


def _turns(radii: Floats) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Of outlines (N, K), at each ray: the chord from BEND_RAYS before to so many after it.

    And a number whose angle is that by which the outline turns inwards there; both complex.
    """
    places = radii * RAYS
    before = places - _turned(places, BEND_RAYS)
    after = _turned(before, -BEND_RAYS)
    return before + after, before * after.conj()


def _without_jags(radii: Floats, whole: Floats, bends: Bools) -> Floats:
    """Radii (N, K) without those near bends (N, K) that are far from the median around them.

    In coordinates in which the outline is as long as wide, so that its ends do not stick out.
    """
    scaled = _as_long_as_wide(whole)
    length = np.hypot(scaled[:, 0], scaled[:, 1])
    off = np.abs(length / np.median(_shifted(length, JAG_RAYS), axis=0) - 1)
    near = _shifted(bends, JAG_RAYS).any(axis=0)
    return np.where(near & (off > JAG) & (off * whole > JAG_PX), np.nan, radii)


def _as_long_as_wide(whole: Floats) -> Floats:
    """The places (N, 2, K) of outlines (N, K), in coordinates in which they are as long as wide."""
    _, middles, (xx, yy, xy) = _moments(np.median(_shifted(whole, 1), axis=0))
    spread = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    points = whole[..., None] * DIRECTIONS - middles[:, None]
    return np.asarray(np.linalg.solve(np.linalg.cholesky(spread), points.swapaxes(1, 2)))


def corners(whole: Floats) -> Floats:
    """By how much outlines (N, K) turn outwards where they do so most sharply, rad.

    On a sixteenth of their length, in coordinates in which they are as long as wide: a circle or an
    ellipse turns by 22.5 degrees everywhere. 0 if they are NaN, or turn by less than CURVED on any
    four rays.

    >>> square = 20 / np.abs(DIRECTIONS).max(axis=1)
    >>> np.degrees(corners(np.stack([np.full(N_RAYS, 20.0), square]))).round().tolist()
    [0.0, 90.0]
    """
    _, turn = _turns(whole)
    turns, known = np.zeros(len(whole)), (-turn.imag > np.tan(CURVED) * turn.real).any(axis=1)
    if not known.any():
        return turns
    places = _as_long_as_wide(whole[known]).swapaxes(1, 2) @ np.array([1, 1j])
    places = np.concatenate([places, places[:, :1]], axis=1)
    along = np.cumsum(np.abs(np.diff(places, prepend=places[:, :1], axis=1)), axis=1)
    along = along / along[:, -1:] * (1 - 1e-12) + np.arange(len(places))[:, None]  # one rising row
    even = np.arange(N_RAYS) / N_RAYS + np.arange(len(places))[:, None]
    spaced = np.interp(even, along.ravel(), places.ravel())
    steps = spaced - _turned(spaced, BEND_RAYS)
    turn = np.angle(_turned(steps, -BEND_RAYS) * steps.conj())
    turns[known] = turn.max(axis=1)
    return turns


def _turned(values: NDArray[Number], rays: int) -> NDArray[Number]:
    """Values (N, K) of the rays so many before each: `np.roll`, in half of its time."""
    return np.concatenate([values[:, -rays:], values[:, :-rays]], axis=1)


def _shifted(values: Floats | Bools, rays: int) -> Floats:
    """Values (N, K) of the rays up to so many before and after each: (2 rays + 1, N, K)."""
    return np.stack([_turned(values, shift) for shift in range(-rays, rays + 1)])


def _moments(radii: Floats) -> tuple[Floats, Floats, Floats]:
    """Areas (N,), centres of mass (N, 2), and second moments (3, N) about them, for an area of 1.

    Of x x, y y and x y, in this order.
    """
    share = 2 * np.pi / N_RAYS
    square = radii**2
    area = square.sum(axis=1) * (share / 2)
    first = np.einsum("nk,kc->nc", square * radii, DIRECTIONS) * (share / 3) / area[:, None]
    second = np.einsum("nk,kc->nc", square * square, PRODUCTS) * (share / 4) / area[:, None]
    squares = np.column_stack([first**2, first.prod(axis=1)])
    return area, first, (second - squares).T


def outline_boxes(origins: Floats, radii: Floats) -> Floats:
    """The boxes (N, 4) px of whole outlines (N, K) around origins (N, 2)."""
    points = _places(radii)
    high, low = _extremes(points), -_extremes(-points)
    return np.hstack([origins + (low + high) / 2, high - low])


def measure_shapes(origins: Floats, radii: Floats) -> tuple[Floats, Floats, Floats]:
    """Quantities (N, 8), the first of COLUMNS, of whole outlines; their centres (N, 2).

    And the places (N, K, 2) of their edges.

    The axes are those of the ellipse with the outline's second moments of area, as in
    scikit-image's regionprops; `angle_rad` is that of the major axis, from x towards y, in
    (-pi/2, pi/2]. Circularity is 4 pi area / perimeter^2, deformation Taylor's
    (major - minor) / (major + minor) (G. I. Taylor 1934). Rows with NaN stay NaN.
    """
    area, first, (xx, yy, xy) = _moments(radii)
    middle, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    major, minor = 4 * np.sqrt(middle + spread), 4 * np.sqrt(np.maximum(middle - spread, 0))
    angle = np.arctan2(2 * xy, xx - yy) / 2
    following = _turned(radii, -1)
    share = 2 * np.pi / N_RAYS
    chords = np.sqrt(radii**2 + following**2 - (2 * np.cos(share)) * radii * following)
    perimeter = chords.sum(axis=1) * (share / 2 / np.sin(share / 2))  # exact of a circle
    columns = np.column_stack(
        [
            *(area, np.sqrt(4 / np.pi * area), major, minor, angle, perimeter),
            *(4 * np.pi * area / perimeter**2, (major - minor) / (major + minor)),
        ]
    )
    return columns, origins + first, origins[:, None] + _places(radii)


def _places(radii: Floats) -> Floats:
    """The places (N, K, 2) of edges, from where the rays begin."""
    return np.stack([radii * DIRECTIONS[:, k] for k in range(2)], axis=2)


def _extremes(points: Floats) -> Floats:
    """The maxima (N, 2) of closed curves (N, K, 2), each by a parabola through three points."""
    at = points.argmax(axis=1)
    row = np.arange(len(points))[:, None]
    before, here, after = (points[row, (at + shift) % N_RAYS, [0, 1]] for shift in (-1, 0, 1))
    bend = 2 * here - before - after
    with np.errstate(divide="ignore", invalid="ignore"):
        above = (after - before) ** 2 / (8 * bend)
    return np.asarray(here + np.where(bend > 1e-9, above, 0))


def whole_circles(outlines: Outlines, boxes: Floats) -> Floats:
    """Centres (N, 2) px of the circles of which outlines show a part; NaN where they show none.

    The circle with the smallest squares (Kasa 1976) through the edges that were seen; it must fit
    them to a hundredth of its radius, and the part that is in the boxes (N, 4).
    """
    centres = np.full((len(outlines.radii), 2), np.nan)
    points, seen = outlines.points(), np.isfinite(outlines.radii)
    for n in np.flatnonzero(seen.mean(axis=1) >= MIN_SEEN_OF_CUT).tolist():
        x, y = (points[n, seen[n]] - outlines.origins[n]).T
        table = np.column_stack([2 * x, 2 * y, np.ones(len(x))])
        solution, *_ = np.linalg.lstsq(table, x * x + y * y, rcond=None)
        radius = np.sqrt(max(solution[2] + solution[0] ** 2 + solution[1] ** 2, 0))
        off = np.hypot(x - solution[0], y - solution[1]) - radius
        fits = np.sqrt((off**2).mean()) <= MAX_RESIDUAL * radius + MAX_RESIDUAL_PX
        side, centre = boxes[n, 2:].max(), outlines.origins[n] + solution[:2]
        if fits and radius <= side and (np.abs(centre - boxes[n, :2]) <= side).all():
            centres[n] = centre
    return centres
