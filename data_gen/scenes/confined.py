"""Foams and packings between the walls of a channel, on which the outer droplets flatten."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from data_gen.scenes.channels import Channel, draw_structures, draw_walls, random_walls
from data_gen.scenes.outlines import Outline, foam, packing
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import log_uniform
from droptrack.data.arrays import Float32s

MIN_LEFT = 0.35  # of a droplet, that the walls leave for it to be drawn


def confined(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """A foam or a packing in a straight channel: droplets have the wall for one of their sides."""
    angle = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)], p=[0.45, 0.25, 0.3]))
    channel = Channel(
        centre=rng.uniform(0.3, 0.7, 2) * [WIDTH, HEIGHT],
        angle=angle,
        width=log_uniform(rng, 90, 900),
    )
    if rng.random() < 0.5:
        draw_structures(rng, canvas)
    inside = rng.normal(0, 25) if rng.random() < 0.6 else 0.0
    draw_walls(canvas, [[channel]], random_walls(rng), inside)
    walls = channel.distance() + np.float32(rng.uniform(0, 3))
    seen = 1.0 if rng.random() < 0.4 else float(rng.uniform(0, 1))  # of the rims at the walls
    arrangement = foam if rng.random() < 0.6 else packing
    for outline in arrangement(rng, canvas):
        held = within_walls(outline, walls, seen)
        if held is not None:
            yield held


def within_walls(outline: Outline, walls: Float32s, seen: float) -> Outline | None:
    """A droplet within walls (H, W), negative between them; None where they leave too little.

    Its rim has `seen` of its strength where it lies on a wall.
    """
    if outline.patch.is_empty:
        return None
    wall = walls[outline.patch.rows, outline.patch.columns]
    if wall.max() < -3:
        return outline
    sharpness = np.float32(0.06 * outline.radius + 0.4)  # rounds the corners at the wall
    both = sharpness * np.logaddexp(outline.distance / sharpness, wall / sharpness)
    left = float((both < 0).sum())
    if left < MIN_LEFT * outline.area:
        return None
    beside = np.clip(wall / np.float32(0.3 * outline.radius) + 1, 0, 1)
    rim = np.asarray(outline.rim * (1 - (1 - np.float32(seen)) * beside), np.float32)
    return replace(outline, distance=np.asarray(both, np.float32), area=left, rim=rim)
