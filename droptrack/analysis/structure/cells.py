"""Radical Voronoi cells of discs, their areas and edges, and who shares one.

The cells are those of the power diagram, in which a droplet's share of the distance to a neighbour
goes by its size (B. J. Gellatly and J. L. Finney 1982). It is the lower side of the convex hull of
the points (x, y, x² + y² - r²) (F. Aurenhammer 1987).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from droptrack.analysis.structure.window import Window
from droptrack.data.arrays import Bools, Floats, Rows

FAR = 300.0  # extents, to four points that are no droplets and close the diagram
MARGIN = 6.0  # mean spacings beyond a periodic box that its copies reach
SHORTEST = 1e-6  # mean spacings: shorter edges are points where four cells meet


@dataclass(frozen=True, kw_only=True)
class Cells:
    """The cells of K droplets, and E pairs that share an edge.

    first, second (E,); vectors (E, 2) px from the first to the second; lengths (E,) px of the
    edges. areas (K,) px², NaN without a cell; inner (K,): whether the whole cell lies in the window
    and each of its neighbours is within reach.
    """

    first: Rows
    second: Rows
    vectors: Floats
    lengths: Floats
    areas: Floats
    inner: Bools


def cells_of(places: Floats, radii: Floats, window: Window, reach: float = np.inf) -> Cells:
    """The cells of discs at places (K, 2) with radii (K,) px.

    Pairs are no further apart than `reach` times the sum of their radii, or, where these are not
    known (NaN), times the median distance of nearest neighbours.

    >>> x, y = np.meshgrid(np.arange(4.0), np.arange(4.0))
    >>> places = np.column_stack([x.ravel(), y.ravel()]) * 10 + 5
    >>> cells = cells_of(places, np.full(16, 5.0), Window(size=(40, 40), periodic=True))
    >>> cells.areas.round(6).tolist() == [100.0] * 16, len(cells.first)
    (True, 32)
    """
    k = len(places)
    if not k:
        return _none(0)
    points, of = _with_copies(places, window) if window.periodic else (places, np.arange(k))
    known = np.nan_to_num(radii)
    triangles, centres, beside = _triangulated(points, known[of])
    spacing = np.sqrt(max(window.area, 1.0) / k)
    # each edge twice, once from each side: with its triangle on the left, another on the right
    corners = np.roll(triangles, -1, axis=1).ravel(), np.roll(triangles, -2, axis=1).ravel()
    left, right = np.repeat(np.arange(len(triangles)), 3), beside.ravel()
    a, b = corners
    real = (a < len(of)) & (b < len(of)) & (right >= 0)
    limits = _limits(points, known[of], reach)
    near = np.zeros(len(a), bool)
    near[real] = (
        np.hypot(*(points[b[real]] - points[a[real]]).T) <= limits[a[real]] + limits[b[real]]
    )
    broken = ~near.reshape(-1, 3).all(axis=1) | ~window.contains(centres)
    rim = np.zeros(len(of) + 4, bool)
    rim[triangles[broken]] = True
    areas, edges = np.zeros(len(of)), real & (a < k)
    from_left, from_right = centres[left[edges]], centres[right[edges]]
    length = np.hypot(*(from_left - from_right).T)
    one = points[a[edges]]
    areas += np.bincount(a[edges], _cross(from_right - one, from_left - one) / 2, len(of))
    shown = np.bincount(triangles[triangles < len(of)], minlength=len(of))[:k] > 0
    kept = near[edges] & (length > SHORTEST * spacing)
    first, second = a[edges][kept], b[edges][kept]
    once = first < of[second]
    first, second, length = first[once], second[once], length[kept][once]
    whole = shown & ~_open(triangles, len(of))[:k]
    return Cells(
        first=first,
        second=of[second],
        vectors=points[second] - points[first],
        lengths=length,
        areas=np.where(whole, areas[:k], np.nan),
        inner=shown & ~rim[:k],
    )


def _none(k: int) -> Cells:
    no = np.zeros(0, np.int64)
    return Cells(
        first=no, second=no, vectors=np.zeros((0, 2)), lengths=np.zeros(0),
        areas=np.full(k, np.nan), inner=np.zeros(k, bool),
    )  # fmt: skip


def _triangulated(points: Floats, radii: Floats) -> tuple[Rows, Floats, Rows]:
    """The regular triangulation: triangles (F, 3), their power centres (F, 2), what is beside.

    Points from K on are four far away. beside (F, 3): the triangle across from each corner, or -1.
    Corners go round from x to y.
    """
    middle = points.mean(axis=0)
    extent = max(float(np.abs(points - middle).max()), 1.0)
    far = np.array([[-1.0, -1.1], [1.05, -1], [1, 1.15], [-1.1, 1]]) * FAR * extent
    flat = np.concatenate([points - middle, far])
    lift = (flat**2).sum(axis=1) - np.append(radii, np.zeros(4)) ** 2
    hull = ConvexHull(np.column_stack([flat, lift / extent]))
    lower = hull.equations[:, 2] < 0
    number = np.where(lower, np.cumsum(lower) - 1, -1)
    triangles, beside = hull.simplices[lower].astype(np.int64), number[hull.neighbors[lower]]
    normals = hull.equations[lower]
    centres = -normals[:, :2] / normals[:, 2:3] / 2 * extent + middle
    one, two, three = (flat[triangles[:, j]] for j in range(3))
    back = _cross(two - one, three - one) < 0
    triangles[back], beside[back] = triangles[back][:, ::-1], beside[back][:, ::-1]
    return triangles, centres, beside


def _cross(one: Floats, other: Floats) -> Floats:
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def _open(triangles: Rows, n: int) -> Bools:
    """Which of n points have a far point as neighbour."""
    found = np.zeros(n + 4, bool)
    found[triangles[(triangles >= n).any(axis=1)]] = True
    return found[:n]


def _limits(points: Floats, radii: Floats, reach: float) -> Floats:
    """What each of a pair adds to the distance (K,) up to which they are neighbours."""
    if not np.isfinite(reach):
        return np.full(len(points), np.inf)
    if (radii > 0).any():
        return reach * np.where(radii > 0, radii, np.median(radii[radii > 0]))
    if len(points) < 2:
        return np.zeros(len(points))
    nearest = np.asarray(cKDTree(points).query(points, 2)[0])[:, 1]
    return np.full(len(points), reach * float(np.median(nearest)) / 2)


def _with_copies(places: Floats, window: Window) -> tuple[Floats, Rows]:
    """Places in a periodic box and their copies around it, and which each is of.

    The first are the places themselves.
    """
    box = np.array(window.size, float)
    inside = np.mod(places, box)
    margin = min(MARGIN * np.sqrt(window.area / len(places)), float(box.min()))
    points, of = [inside], [np.arange(len(places))]
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            copy = inside + np.array([x, y]) * box
            near = ((copy > -margin) & (copy < box + margin)).all(axis=1)
            if x or y:
                points.append(copy[near])
                of.append(np.flatnonzero(near))
    return np.concatenate(points), np.concatenate(of)
