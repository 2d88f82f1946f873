"""What a bad camera does to an image: blur, uneven light, less contrast, noise.

Each is one function of an image or of its grey levels, (H, W) or (H, W, C), and the same in all
channels. Levels are floats that may leave 0..255 in between; `to_pixels` comes last. `degrade` is
all of them at random. The droplets stay where they are.
"""

from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Pixels

Levels = NDArray[np.floating[Any]]
Kind = TypeVar("Kind", np.uint8, np.float64)


def blur(image: NDArray[Kind], sigma_px: float) -> NDArray[Kind]:
    """An image out of focus: under a Gaussian with a standard deviation of more than 0 px."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), image.dtype)


def light_unevenly(levels: NDArray[Any], light: Levels) -> Levels:
    """Levels times the light on each pixel, (H, W), or on each column, (W,); 1 changes nothing."""
    return np.asarray(levels * _in_all_channels(light, levels))


def lower_contrast(levels: Levels, contrast: float, black: float) -> Levels:
    """Levels that span `contrast` times their range, from `black` on."""
    lower = levels * contrast
    lower += black
    return lower


def add_noise(levels: Levels, normal: Levels, sigma: float) -> Levels:
    """Levels with noise of standard deviation `sigma`, from standard normal numbers (H, W)."""
    noise = normal * sigma
    return np.asarray(levels + _in_all_channels(noise, levels))


def to_pixels(levels: Levels) -> Pixels:
    """Levels cut off at 0 and 255, their fractions too."""
    return np.asarray(np.clip(levels, 0, 255), np.uint8)


def degrade(image: Pixels, rng: np.random.Generator) -> Pixels:
    """An image (H, W) or (H, W, 3) out of focus, unevenly lit, of little contrast, and noisy.

    Each at random, as drawn images are all alike in this and videos are not.
    """
    blurred = blur(image, rng.uniform(0.1, 3))
    left, right = rng.uniform(0.4, 1, 2)
    contrast = rng.uniform(0.3, 1)
    sigma = rng.uniform(0, 15)
    normal = rng.standard_normal(image.shape[:2])
    black = rng.uniform(0, 255 * (1 - contrast))
    lit = light_unevenly(blurred, np.linspace(left, right, image.shape[1]))
    return to_pixels(add_noise(lower_contrast(lit, contrast, black), normal, sigma))


def _in_all_channels(values: Levels, levels: NDArray[Any]) -> Levels:
    return values if levels.ndim == 2 else values[..., None]
