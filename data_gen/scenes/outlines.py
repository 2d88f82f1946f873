"""Arrangements of droplets: where they lie and how they press on one another, as outlines.

An arrangement yields one `Outline` a droplet; what is drawn of it is decided elsewhere
(`appearance`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from data_gen.scenes.distances import Patch, cell_distance, ellipse_distance, patch_around
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import log_uniform
from droptrack.data.arrays import Float32s, Floats

SHAPE = (HEIGHT, WIDTH)
MAX_NEIGHBOURS = 12  # of a droplet in a foam
MAX_SUSPENDED = 900  # droplets of an image
ROUND = 0.3  # share of packings whose droplets stay round, one rim over the other
MAX_DEFOCUS = 1.1  # of a droplet's radius, above which it is a blur without a label


@dataclass(frozen=True, kw_only=True)
class Outline:
    """One droplet: its patch, and the signed distance (H, W) to its outline.

    `radius` px and `centre` (2,) px; `area` px², also of what lies beyond the image; `rim`: how
    strong the rim is at each pixel; `labelled`: whether it is a droplet, not yet a thread;
    `defocus`: px by which its edges are blurred, beside those of droplets in focus.
    """

    patch: Patch
    distance: Float32s
    radius: float
    centre: Floats
    area: float
    rim: Float32s | float = 1.0
    labelled: bool = True
    defocus: float = 0.0


def margin_of(radius: float) -> float:
    """What may be seen of a droplet of a radius around its outline, px."""
    return 4 + 0.1 * radius


def ellipse(
    rng: np.random.Generator, centre: Floats, radius: float, oblong: float, margin: float = 0.0
) -> Outline:
    """An ellipse as large as a circle of the radius, `oblong` times as long as wide, turned.

    Its patch has `margin` px more around it than any droplet's.
    """
    a, b = radius * np.sqrt(oblong), radius / np.sqrt(oblong)
    patch = patch_around(SHAPE, centre, a + margin_of(radius) + margin)
    angle = float(rng.uniform(0, np.pi))
    distance = ellipse_distance(patch, centre, a, b, angle)
    return Outline(
        patch=patch, distance=distance, radius=radius, centre=centre, area=float(np.pi * a * b)
    )


def scattered(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Droplets here and there, of a typical size or of all sizes, some over others."""
    typical = log_uniform(rng, 5, 120)
    spread = rng.choice([0.03, 0.2, 0.7])
    room = 0.6 * WIDTH * HEIGHT / (np.pi * typical**2) + 2
    n = min(int(rng.integers(1, 120)), int(room))
    apart = 0.55 if rng.random() < 0.3 else 1.03
    placed = np.empty((0, 3))
    for _ in range(6 * n):
        if len(placed) >= n:
            break
        radius = float(np.clip(typical * np.exp(rng.normal(0, spread)), 3, 250))
        centre = rng.uniform(-0.3 * radius, [WIDTH + 0.3 * radius, HEIGHT + 0.3 * radius])
        gaps = np.hypot(*(placed[:, :2] - centre).T) - apart * (placed[:, 2] + radius)
        if (gaps < 0).any():
            continue
        placed = np.vstack([placed, [*centre, radius]])
        oblong = 1.0 if rng.random() < 0.6 else float(rng.uniform(1, 1.8))
        yield ellipse(rng, centre, radius, oblong)


def suspension(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Droplets or bubbles of all sizes at all depths: many over others, some out of focus."""
    typical = log_uniform(rng, 4, 25)
    spread = rng.uniform(0.3, 0.9)
    depth = rng.uniform(0, 0.7)
    covered = log_uniform(rng, 0.05, 1.2) * WIDTH * HEIGHT
    n = int(covered / (np.pi * typical**2 * np.exp(2 * spread**2)))
    for _ in range(min(n, MAX_SUSPENDED) + 1):
        radius = float(np.clip(typical * np.exp(rng.normal(0, spread)), 3, 250))
        defocus = radius * abs(rng.normal(0, depth))
        centre = rng.uniform(0, [WIDTH, HEIGHT])
        oblong = 1.0 if rng.random() < 0.7 else float(rng.uniform(1, 1.5))
        droplet = ellipse(rng, centre, radius, oblong, margin=defocus)
        yield replace(droplet, defocus=defocus, labelled=defocus < MAX_DEFOCUS * radius)


def packing(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """A jittered hexagonal packing of about one size that fills a part of the image.

    Pressed flat where droplets meet, or round, and over one another.
    """
    radius = log_uniform(rng, 6, 90)
    spacing = radius * (rng.uniform(1.85, 2.4) if rng.random() < 0.6 else rng.uniform(1.9, 2.05))
    reach = int(WIDTH / spacing) + 2
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    points = np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * spacing
    angle = rng.uniform(0, np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = points @ turn + rng.uniform(0, 1, 2) * [WIDTH, HEIGHT]
    points += rng.normal(0, rng.uniform(0, 0.12) * radius, points.shape)
    radii = radius * np.clip(rng.normal(1, rng.uniform(0, 0.12), len(points)), 0.5, 1.4)
    inside = ((points > -radius) & (points < [WIDTH + radius, HEIGHT + radius])).all(axis=1)
    if rng.random() < 0.6:  # a free surface, or a few gaps
        normal = rng.normal(0, 1, 2)
        normal /= np.hypot(*normal)
        inside &= (points - rng.uniform(0.2, 0.8, 2) * [WIDTH, HEIGHT]) @ normal > 0
    inside &= rng.random(len(points)) > rng.choice([0.0, 0.1, 0.4])
    if rng.random() < ROUND:
        for point, one in zip(points[inside], radii[inside], strict=True):
            yield ellipse(rng, point, float(one), 1.0)
    else:
        yield from _pressed(rng, points[inside], radii[inside])


def foam(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Droplets of many sizes that fill the image, or a part of it, up to thin films."""
    typical = log_uniform(rng, 9, 90)
    spread = rng.uniform(0.05, 0.6)
    n = int(min(1500, 6 * WIDTH * HEIGHT / (np.pi * typical**2) + 20))
    radii = np.sort(np.clip(typical * np.exp(rng.normal(0, spread, n)), 5, 220))[::-1]
    centres = rng.uniform(-40, [WIDTH + 40, HEIGHT + 40], (n, 2))
    kept: list[int] = []
    overlap = rng.uniform(0.7, 0.92)
    for i in range(n):
        others = np.array(kept, int)
        gap = np.hypot(*(centres[others] - centres[i]).T) - overlap * (radii[others] + radii[i])
        if not (gap < 0).any():
            kept.append(i)
    points, sizes = centres[kept], radii[kept]
    # grow each until it meets its neighbours
    far = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) - sizes[None]
    np.fill_diagonal(far, np.inf)
    nearest = np.sort(far, axis=1)[:, : int(rng.integers(2, 6))].mean(axis=1)
    grown = np.clip(nearest, sizes, 2.0 * sizes) if rng.random() < 0.75 else sizes
    yield from _pressed(rng, points, grown)


def _pressed(rng: np.random.Generator, points: Floats, radii: Floats) -> Iterator[Outline]:
    """Droplets (N,) at points (N, 2) that flatten one another where they meet."""
    film = rng.uniform(0.3, 3) if rng.random() < 0.5 else rng.uniform(0, 0.12) * np.median(radii)
    for i in range(len(points)):
        point, radius = points[i], float(radii[i])
        patch = patch_around(SHAPE, point, radius + margin_of(radius))
        if patch.is_empty:
            continue
        apart = np.hypot(*(points - point).T)
        near = np.flatnonzero((apart > 0) & (apart < radius + radii + film))
        near = near[np.argsort(apart[near])][:MAX_NEIGHBOURS]
        others = np.column_stack([points[near], radii[near]])
        distance = cell_distance(patch, point, radius, others, float(film))
        area = max(float((distance < 0).sum()), 1.0)
        beyond = (point < radius) | (point > [WIDTH - radius, HEIGHT - radius])
        if beyond.any():
            area = max(area, 0.75 * np.pi * radius**2)
        yield Outline(patch=patch, distance=distance, radius=radius, centre=point, area=area)
