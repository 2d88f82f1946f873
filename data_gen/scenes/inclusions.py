"""Cells, beads and inner drops, in droplets and in the liquid around plugs: none has a label."""

import numpy as np

from data_gen.scenes.distances import ellipse_distance, patch_around
from data_gen.scenes.outlines import Outline
from droptrack.data.arrays import Float32s, Floats

MAX_CELLS = 50  # in a droplet
MAX_CELL = 0.16  # of a droplet's radius
MAX_SPREAD_PX = 60.0  # radius of a droplet, from which on what is in it grows no more


def paint_inside(
    canvas: Float32s, outline: Outline, cell_px: float, rng: np.random.Generator
) -> None:
    """A few small things inside a droplet, and sometimes a large one, in place.

    Or, where `cell_px` is above zero and they fit, up to MAX_CELLS cells of about that radius.
    Nothing in a droplet beyond the canvas.
    """
    if outline.patch.is_empty:
        return
    if 0 < cell_px < MAX_CELL * outline.radius:
        _paint_cells(canvas, outline, cell_px, rng)
        return
    radius = min(outline.radius, MAX_SPREAD_PX)
    sizes = radius * rng.uniform(0.04, 0.3, int(rng.integers(1, 6)))
    if rng.random() < 0.3:  # an inner drop, a large cell, a reflection
        sizes[0] = outline.radius * rng.uniform(0.3, 0.75)
    tone = float(rng.normal(0, 45))
    corner = np.array([outline.patch.x[0], outline.patch.y[0]], float)
    for size in sizes.tolist():
        place = _place(outline.distance, 1.1 * size, rng)
        if place is not None:
            _paint(canvas, corner + place, size, tone * rng.uniform(0.5, 1.5), rng)


def _paint_cells(canvas: Float32s, outline: Outline, size: float, rng: np.random.Generator) -> None:
    tone = float(rng.choice([-1, -1, 1])) * rng.uniform(30, 120)
    corner = np.array([outline.patch.x[0], outline.patch.y[0]], float)
    for _ in range(int(np.exp(rng.uniform(0, np.log(MAX_CELLS))))):
        place = _place(outline.distance, 1.1 * size, rng)
        if place is not None:
            one = size * rng.uniform(0.85, 1.15)
            _paint(canvas, corner + place, one, tone * rng.uniform(0.7, 1.2), rng)


def paint_suspended(
    canvas: Float32s, distance: Float32s, width: float, rng: np.random.Generator
) -> None:
    """Cells or beads in the liquid of channels `width` px wide, some in clusters, in place.

    `distance` (H, W) px from the channels' walls, negative in them. What is painted over them later
    is what they are in.
    """
    size = width * float(np.exp(rng.uniform(*np.log([0.02, 0.16]))))
    tone = float(rng.choice([-1, 1])) * rng.uniform(15, 110)
    for _ in range(int(rng.integers(2, 25))):
        place = _place(distance, 1.2 * size, rng)
        if place is None:
            return
        cluster = np.zeros((1 if rng.random() < 0.7 else int(rng.integers(2, 5)), 2))
        angles = rng.uniform(0, 2 * np.pi, len(cluster) - 1)
        cluster[1:] = (
            2 * size * np.cumsum(np.column_stack([np.cos(angles), np.sin(angles)]), axis=0)
        )
        for x, y in np.round(place + cluster).astype(int).tolist():
            inside = 0 <= y < distance.shape[0] and 0 <= x < distance.shape[1]
            if inside and distance[y, x] < -size:
                at, one = np.array([x, y]) + 0.5, size * rng.uniform(0.7, 1.3)
                _paint(canvas, at, one, tone * rng.uniform(0.6, 1.2), rng)


def _place(distance: Float32s, depth: float, rng: np.random.Generator) -> Floats | None:
    """A pixel (2,) x, y that is as deep inside, at random; None where there is none."""
    for _ in range(20):
        row, column = (int(rng.integers(n)) for n in distance.shape)
        if distance[row, column] < -depth:
            return np.array([column, row], float)
    return None


def _paint(
    canvas: Float32s, centre: Floats, size: float, tone: float, rng: np.random.Generator
) -> None:
    """A disc of a radius `size` px: a ring, what is in it, and often a second ring around it."""
    patch = patch_around((canvas.shape[0], canvas.shape[1]), centre, 1.8 * size + 4)
    if patch.is_empty:
        return
    long = max(size, 0.8) * rng.uniform(1.0, 1.25)
    distance = ellipse_distance(patch, centre, long, max(size, 0.8), rng.uniform(0, np.pi))
    width = np.float32(max(1.2, size * rng.uniform(0.05, 0.25)))
    levels = np.exp(-((distance / width) ** 2))
    inside = np.clip(np.float32(0.5) - distance, 0, 1)
    levels += inside * np.float32(rng.choice([0.3, rng.uniform(-0.8, 1.2)]))
    if rng.random() < 0.4:
        levels -= np.exp(-(((distance - 2 * width) / width) ** 2)) * np.float32(0.6)
    canvas[patch.rows, patch.columns] += levels * np.float32(tone)
