"""The three kinds of training images of the paper's appendix C, and one of deformed droplets.

a   white discs and ellipses of random size and orientation on black
b   a black disc on white with two white discs inside it
c   a few dense clusters of random numbers of white discs on black
d   our addition, what the flows look like once they have deformed the droplets: clusters of
    polygonal droplets with thin dark films, or a sheared shell with one to four cores

Every scene is 1200 x 600 px and drawn at random from `rng`; droplets lie wholly inside and do not
overlap. Sizes are in px.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_gen.scenes.shapes import (
    BLACK,
    WHITE,
    Canvas,
    contour_points,
    draw_ellipses,
    draw_polygon,
    ellipse_boxes,
)
from droptrack.data.arrays import Floats
from droptrack.data.degradation import add_noise, blur, light_unevenly, lower_contrast, to_pixels

WIDTH, HEIGHT = 1200, 600


@dataclass(frozen=True)
class Scene:
    """An image (H, W) and the boxes (N, 4) [cx, cy, w, h] px of the droplets in it, read-only."""

    image: NDArray[np.uint8]
    boxes: Floats

    def __post_init__(self) -> None:
        for array in (self.image, self.boxes):
            array.flags.writeable = False


def scattered_droplets(rng: np.random.Generator) -> Scene:
    """Scene a: 1 to 30 discs and ellipses, semi-axes 8 to 90 px, aspect ratio up to 2."""
    placed: list[list[float]] = []
    n = rng.integers(1, 31)
    typical = _log_uniform(rng, 10, 70)
    for _ in range(10 * n):
        if len(placed) == n:
            break
        a = float(np.clip(typical * _log_uniform(rng, 0.6, 1.6), 8, 90))
        b = a if rng.random() < 0.5 else max(8.0, a * rng.uniform(0.5, 1))
        x, y = rng.uniform(a + 2, WIDTH - a - 2), rng.uniform(a + 2, HEIGHT - a - 2)
        if all((x - p[0]) ** 2 + (y - p[1]) ** 2 > (a + p[2] + 2) ** 2 for p in placed):
            placed.append([x, y, a, b, rng.uniform(0, np.pi)])
    ellipses = np.array(placed)
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    draw_ellipses(canvas, ellipses, WHITE)
    return Scene(canvas, ellipse_boxes(ellipses))


def double_emulsion(rng: np.random.Generator) -> Scene:
    """Scene b: a shell of radius 60 to 280 px with two cores of 0.15 to 0.45 shell radii."""
    shell = _log_uniform(rng, 60, 280)
    x, y = rng.uniform(shell + 4, WIDTH - shell - 4), rng.uniform(shell + 4, HEIGHT - shell - 4)
    cores = np.array([[x, y, 0, 0, 0]]) + _cores_in_a_shell(rng, 2) * shell
    canvas = np.full((HEIGHT, WIDTH), WHITE, np.uint8)
    draw_ellipses(canvas, np.array([[x, y, shell, shell, 0.0]]), BLACK)
    draw_ellipses(canvas, cores, WHITE)
    return Scene(canvas, ellipse_boxes(cores))


def dense_clusters(rng: np.random.Generator) -> Scene:
    """Scene c: 1 to 4 clusters of up to 90 discs each, radius 12 to 40 px, 0 to 4 px apart."""
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    discs = []
    for centre, reach in _cluster_places(rng):
        radius = _log_uniform(rng, 12, min(40, reach / 1.5))
        gap = rng.uniform(0, 4)
        points = _packing(rng, centre, reach - radius, radius, np.ones(2))
        wanted = radius * np.clip(rng.normal(1, rng.uniform(0, 0.15), len(points)), 0.6, 1.3)
        r = _without_overlap(points, np.minimum(wanted, 42), gap)
        discs.append(np.column_stack([points, r, r, np.zeros(len(r))]))
    ellipses = np.concatenate(discs)
    draw_ellipses(canvas, ellipses, WHITE)
    return Scene(canvas, ellipse_boxes(ellipses))


def deformed_droplets(rng: np.random.Generator) -> Scene:
    """Scene d: clusters of polygonal droplets (two in three) or a sheared shell with its cores.

    Blurred by up to 2.5 px; every second one degraded further.
    """
    canvas, boxes = _foam(rng) if rng.random() < 0.67 else _sheared_emulsion(rng)
    sigma_px = rng.uniform(0, 2.5)
    if sigma_px > 0.3:
        canvas = blur(canvas, sigma_px)
    return Scene(_degraded(rng, canvas) if rng.random() < 0.5 else canvas, boxes)


SCENES: dict[str, Callable[[np.random.Generator], Scene]] = {
    "a": scattered_droplets,
    "b": double_emulsion,
    "c": dense_clusters,
    "d": deformed_droplets,
}


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _cores_in_a_shell(rng: np.random.Generator, n: int) -> Floats:
    """Discs (n, 5) inside the unit circle that neither touch it nor each other."""
    cores: list[list[float]] = []
    while len(cores) < n:
        cores = []
        for _ in range(50):
            r = rng.uniform(0.15, 0.45 if n < 3 else 0.33)
            distance, angle = (0.96 - r) * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
            x, y = distance * np.cos(angle), distance * np.sin(angle)
            if all(np.hypot(x - c[0], y - c[1]) > r + c[2] + 0.03 for c in cores):
                cores.append([x, y, r, r, 0.0])
            if len(cores) == n:
                break
    return np.array(cores)


def _cluster_places(rng: np.random.Generator, min_reach: float = 40) -> list[tuple[Floats, float]]:
    """Centres and radii, px, of one to four circles that do not overlap."""
    places: list[tuple[Floats, float]] = []
    n = rng.integers(1, 5)
    for _ in range(20 * n):
        reach = _log_uniform(rng, min_reach, 270)
        centre = np.array(
            [rng.uniform(reach + 4, WIDTH - reach - 4), rng.uniform(reach + 4, HEIGHT - reach - 4)]
        )
        if all(np.hypot(*(centre - c)) > reach + r + 4 for c, r in places):
            places.append((centre, reach))
        if len(places) == n:
            break
    return places


def _packing(
    rng: np.random.Generator, centre: Floats, reach: float, radius: float, stretch: Floats
) -> Floats:
    """Up to 90 points (N, 2), a jittered hexagonal packing of discs that fill a circle.

    With a `stretch` (2,) other than one, the circle becomes an ellipse that fits into it.
    """
    n = int(min(reach / radius + 2, 12))
    row, column = np.mgrid[-n : n + 1, -n : n + 1].reshape(2, -1)
    spacing = 2.02 * radius
    points = np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * spacing
    points += rng.uniform(-0.5, 0.5, 2) * spacing
    points += rng.normal(0, rng.uniform(0, 0.1) * radius, points.shape)
    angle = rng.uniform(0, np.pi)
    c, s = np.cos(angle), np.sin(angle)
    points = points @ np.array([[c, s], [-s, c]])
    outside = np.hypot(points[:, 0] / stretch[0], points[:, 1] / stretch[1])
    order = np.argsort(outside)[: rng.integers(3, 91)]
    kept = order[outside[order] <= reach]
    return np.asarray(centre + points[kept if len(kept) else order[:1]])


def _without_overlap(points: Floats, radii: Floats, gap: float) -> Floats:
    """Shrink radii (N,) until discs at points (N, 2) are at least `gap` px apart."""
    if len(points) < 2:
        return radii
    distance = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) - gap
    np.fill_diagonal(distance, np.inf)
    ratio = distance / (radii[:, None] + radii[None])
    return np.asarray(radii * np.minimum(ratio.min(axis=1), 1))


def _foam(rng: np.random.Generator) -> tuple[Canvas, Floats]:
    """Clusters of polygonal droplets, stretched by up to 2.2 and bent as flow round a corner does.

    Droplets that bending moves out of the image are left out.
    """
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    boxes = []
    for centre, reach in _cluster_places(rng, 80):
        radius = _log_uniform(rng, 14, min(55, reach / 2))
        film = rng.uniform(0.04, 0.22) * radius + 1.0
        oblong = np.array([1.0, rng.uniform(0.3, 1)])[:: rng.choice([-1, 1])]
        points = _packing(rng, centre, reach - radius, radius, oblong)
        points += rng.normal(0, rng.uniform(0, 0.25) * radius, points.shape)
        squeeze = np.array([1.0, _log_uniform(rng, 0.45, 1.0)])[
            :: rng.choice([-1, 1], p=[0.3, 0.7])
        ]
        bend = _bending(rng, radius)
        for place, radii in zip(points, _cells(rng, points, radius, film), strict=True):
            outline = bend(centre + (contour_points(place, radii) - centre) * squeeze)
            low, high = outline.min(axis=0), outline.max(axis=0)
            if (high - low).min() < 8 or low.min() < 0 or (high > [WIDTH, HEIGHT]).any():
                continue
            draw_polygon(canvas, outline, WHITE)
            boxes.append([*(low + high) / 2, *(high - low)])
    return canvas, np.array(boxes).reshape(-1, 4)


def _bending(rng: np.random.Generator, radius: float) -> Callable[[Floats], Floats]:
    """A smooth map of points (N, 2) that bends droplets of this radius, in two clusters of three.

    Two transverse waves of displacement, 4 to 14 radii long, one after the other: each keeps all
    areas, as flow does, and neither folds.
    """
    waves = []
    for strength in rng.uniform(0, 0.7, 2) if rng.random() < 0.67 else ():
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        along, across = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        number = 2 * np.pi / (radius * _log_uniform(rng, 4, 14))
        waves.append((along * number, across * strength / number, phase))

    def bend(points: Floats) -> Floats:
        for along, across, phase in waves:
            points = points + np.sin(points @ along + phase)[:, None] * across
        return points

    return bend


def _cells(rng: np.random.Generator, points: Floats, radius: float, film: float) -> Floats:
    """Radii (N, 128) of the Voronoi cells of the points, less half a film, with round corners.

    Where no neighbour is near, a cell ends in an arc of 0.9 to 1.15 radii. Every second cluster has
    droplets with dents of up to 0.3 radii.
    """
    k = 128
    angles = np.arange(k) * (2 * np.pi / k)
    free = radius * rng.uniform(0.9, 1.15, len(points))
    radii = np.repeat(free[:, None], k, axis=1)
    for i, point in enumerate(points):
        offset = points - point
        distance = np.hypot(offset[:, 0], offset[:, 1])
        near = (distance > 0) & (distance < 2 * free[i] + film)
        if not near.any():
            continue
        towards = np.arctan2(offset[near, 1], offset[near, 0])
        cosine = np.cos(angles[None] - towards[:, None])
        wall = ((distance[near] - film) / 2)[:, None] / np.maximum(cosine, 1e-3)
        radii[i] = np.minimum(radii[i], wall.min(axis=0))
    radii = gaussian_filter1d(radii, rng.uniform(2, 5), axis=1, mode="wrap")
    if rng.random() < 0.5:
        n = (len(radii), 1)
        lobes, phase = rng.integers(1, 5, n), rng.uniform(0, 2 * np.pi, n)
        dents = rng.uniform(0, 0.3, n) * (1 + np.cos(lobes * angles + phase)) / 2
        radii = radii * (1 - dents)
    return np.asarray(radii)


def _degraded(rng: np.random.Generator, canvas: Canvas) -> Canvas:
    """Less contrast, light that falls off to one side, and noise of up to 12 grey levels."""
    dark, bright = rng.uniform(0, 60), rng.uniform(150, 255)
    levels = lower_contrast(canvas.astype(np.float32), (bright - dark) / WHITE, dark)
    x, y = np.linspace(-1, 1, WIDTH, dtype=np.float32), np.linspace(-1, 1, HEIGHT, dtype=np.float32)
    tilt = rng.uniform(-0.15, 0.15, 2).astype(np.float32)
    levels = light_unevenly(levels, 1 + tilt[0] * x[None] + tilt[1] * y[:, None])
    normal = rng.standard_normal(levels.shape, np.float32)
    return to_pixels(add_noise(levels, normal, rng.uniform(0, 12)))


def _sheared_emulsion(rng: np.random.Generator) -> tuple[Canvas, Floats]:
    canvas = np.full((HEIGHT, WIDTH), WHITE, np.uint8)
    shell = _log_uniform(rng, 60, 250)
    stretch = rng.uniform(1, 1.6)
    a, b, angle = shell * np.sqrt(stretch), shell / np.sqrt(stretch), rng.uniform(0, np.pi)
    a, b = a * min(1, 290 / a), b * min(1, 290 / a)
    x, y = rng.uniform(a + 4, WIDTH - a - 4), rng.uniform(a + 4, HEIGHT - a - 4)
    unit = _cores_in_a_shell(rng, int(rng.integers(1, 5)))
    c, s = np.cos(angle), np.sin(angle)
    centres = np.array([x, y]) + unit[:, :2] * [a, b] @ np.array([[c, s], [-s, c]])
    r = unit[:, 2] * b
    oblong = rng.uniform(0.85, 1, len(r))
    cores = np.column_stack([centres, r, r * oblong, rng.uniform(0, np.pi, len(r))])
    draw_ellipses(canvas, np.array([[x, y, a, b, angle]]), BLACK)
    draw_ellipses(canvas, cores, WHITE)
    return canvas, ellipse_boxes(cores)
