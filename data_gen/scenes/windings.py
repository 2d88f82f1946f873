"""Channels that wind to and fro, as they do where droplets are to be mixed or kept: no droplets."""

import cv2
import numpy as np

from data_gen.scenes.channels import random_walls, wall_lines
from data_gen.scenes.outlines import SHAPE
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import log_uniform
from droptrack.data.arrays import Float32s, Floats


def draw_winding(rng: np.random.Generator, canvas: Float32s) -> None:
    """A channel of up to twelve straight parts side by side, and the bends between them."""
    width = log_uniform(rng, 8, 70)
    course = winding(
        n=int(rng.integers(2, 13)),
        length=log_uniform(rng, 2 * width + 20, 900),
        apart=width * rng.uniform(1.2, 3),
    )
    angle = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)], p=[0.4, 0.35, 0.25]))
    c, s = np.cos(angle), np.sin(angle)
    place = rng.uniform(0, 1, 2) * [WIDTH, HEIGHT]
    distance = distance_from(course @ np.array([[c, s], [-s, c]]) + place, width)
    canvas += wall_lines(distance, random_walls(rng))


def winding(*, n: int, length: float, apart: float) -> Floats:
    """A course (K, 2) px around the origin: `n` parts along x, `apart` px from one to the next.

    Half circles join them.

    >>> course = winding(n=2, length=100, apart=40)
    >>> course.min(axis=0).round().tolist(), course.max(axis=0).round().tolist()
    ([-50.0, -20.0], [70.0, 20.0])
    """
    turn = np.linspace(-np.pi / 2, np.pi / 2, 24)
    points = []
    for part in range(n):
        side, y = (-1) ** part, (part - (n - 1) / 2) * apart
        points.append(np.array([[-side * length / 2, y]]))
        bend = np.column_stack([side * np.cos(turn), np.sin(turn) + 1]) * apart / 2
        end = np.array([side * length / 2, y])
        points.append(end + bend if part < n - 1 else end[None])
    return np.concatenate(points)


def distance_from(course: Floats, width: float) -> Float32s:
    """How far (H, W) px from the walls of a channel along a course (K, 2) each pixel is.

    Negative in the channel; right within a pixel.
    """
    apart = np.full(SHAPE, 255, np.uint8)
    cv2.polylines(apart, [np.round(course * 16 - 8).astype(np.int32)], False, 0, 1, shift=4)
    middle = cv2.distanceTransform(apart, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(middle - np.float32(width / 2), np.float32)
