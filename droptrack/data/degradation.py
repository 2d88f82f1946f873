"""What a bad camera does to a picture; the droplets stay where they are."""

import cv2
import numpy as np
from numpy.typing import NDArray


def photographed(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A picture (H, W) or (H, W, 3) out of focus, unevenly lit, of little contrast, and noisy.

    All by chance. Pictures that are drawn are all alike in this; videos are not.
    """
    blurred = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.1, 3))
    left, right = rng.uniform(0.4, 1, 2)
    light = np.linspace(left, right, picture.shape[1])[:, None]
    contrast = rng.uniform(0.3, 1)
    grain = rng.normal(0, rng.uniform(0, 15), (*picture.shape[:2], 1))
    lit = blurred.reshape(*picture.shape[:2], -1) * light * contrast
    lit += rng.uniform(0, 255 * (1 - contrast)) + grain
    return np.asarray(np.clip(lit, 0, 255), np.uint8).reshape(picture.shape)
