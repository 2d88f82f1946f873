"""What is measured on: a drawn video of many droplets, and drawn images with ground truth."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from data_gen.scenes.dataset import JPEG_QUALITY
from data_gen.scenes.scene_kinds import SCENES
from data_gen.scenes.shapes import WHITE, draw_ellipses
from droptrack.data.degradation import degrade
from droptrack.data.detections import labels
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.evaluation.network_scores import LabelledImage

SIZE = (1200, 600)
DROPLETS = 50
SEED = 2026  # of images that are in no data set


def write_video(path: Path, n_frames: int) -> None:
    """Fifty droplets in five rows that drift and sway, as JPEG images."""
    row, column = np.divmod(np.arange(DROPLETS), 10)
    radii = np.random.default_rng(0).uniform(16, 30, DROPLETS)
    with VideoWriter(path, VideoInfo(*SIZE, 25, n_frames), "MJPG", JPEG_QUALITY) as video:
        for t in range(n_frames):
            x = 60 + 116 * column + 20 * np.sin(0.05 * t + row)
            y = 70 + 115 * row + 20 * np.cos(0.07 * t + column)
            canvas = np.zeros(SIZE[::-1], np.uint8)
            draw_ellipses(canvas, np.column_stack([x, y, radii, radii, 0 * x]), WHITE)
            video.write(np.repeat(canvas[..., None], 3, axis=2))


def drawn_images(
    scene: str, n_images: int, *, seed: int = SEED, degraded: bool = False
) -> Iterator[LabelledImage]:
    """Images of a scene, through JPEG as in a data set, and maybe degraded; their ground truth."""
    for index in range(n_images):
        drawn = SCENES[scene](np.random.default_rng([seed, 2, index]))
        jpeg = cv2.imencode(".jpg", drawn.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
        image = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
        if degraded:
            image = degrade(image, np.random.default_rng([seed, 3, index]))
        yield image, labels(drawn.boxes)
