"""Drawn videos of droplets in a channel whose every part is known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data_gen.scenes.shapes import draw_ellipses
from droptrack.adaptation.footage import Shot
from droptrack.adaptation.trust import Seen
from droptrack.data.arrays import Floats, Pixels
from droptrack.data.frames import grey_frame
from droptrack.data.video import VideoInfo, VideoWriter

WIDTH, HEIGHT = 320, 160
RADIUS = 22.0
NOISE = 3.0


def empty_channel() -> Floats:
    """Grey levels (H, W) of a channel with two walls, unevenly lit."""
    levels = np.full((HEIGHT, WIDTH), 25.0) + np.linspace(0, 15, WIDTH)
    levels[36:40] = levels[120:124] = 70
    return levels


def discs_at(frame: int) -> Floats:
    """Where the droplets of a frame are: (N, 2), in single file, 9 px further in each frame."""
    x = (np.arange(0, 480, 80) + 9.0 * frame) % 480 - 80
    y = np.where(np.arange(6) % 2, 86.0, 74.0)
    return np.column_stack([x, y])[(x > -RADIUS) & (x < WIDTH + RADIUS)]


def boxes_at(frame: int) -> Floats:
    """Their boxes (N, 4), cut at the image's edges."""
    centres = discs_at(frame)
    low = np.clip(centres - RADIUS, 0, [WIDTH, HEIGHT])
    high = np.clip(centres + RADIUS, 0, [WIDTH, HEIGHT])
    boxes = np.column_stack([(low + high) / 2, high - low])
    return boxes[(boxes[:, 2:] > 3).all(axis=1)]


def channel_image(frame: int, rng: np.random.Generator, *, droplets: bool = True) -> Pixels:
    """An image (H, W): bright droplets in the channel, and noise."""
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    if droplets:
        ellipses = np.array([[x, y, RADIUS, RADIUS, 0.0] for x, y in discs_at(frame)])
        draw_ellipses(canvas, ellipses, 255)
    levels = empty_channel() + canvas * (170 / 255) + rng.normal(0, NOISE, canvas.shape)
    return np.clip(np.round(levels), 0, 255).astype(np.uint8)


def write_video(path: Path, frames: Sequence[int], *, droplets: bool = True) -> Path:
    """A video of the frames with these numbers."""
    rng = np.random.default_rng(1)
    info = VideoInfo(WIDTH, HEIGHT, 25, len(frames))
    with VideoWriter(path, info, "MJPG") as video:
        for frame in frames:
            image = channel_image(frame, rng, droplets=droplets)
            video.write(np.repeat(image[..., None], 3, axis=2))
    return path


def shot_of(image: Pixels, number: int = 0) -> Shot:
    """An image (H, W) as a shot."""
    return Shot(number=number, size=(image.shape[1], image.shape[0]), frame=grey_frame(image))


def seen_of(image: Pixels, boxes: Floats, number: int = 0) -> Seen:
    """An image (H, W) whose droplets are known."""
    return Seen(shot=shot_of(image, number), trusted=boxes, doubtful=np.zeros((0, 4)))
