"""From a field to a frame: scale, and what a bad camera adds. The ground truth stays the same."""

from dataclasses import dataclass

import cv2
import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.degradation import Levels, add_noise, blur, light_unevenly, to_pixels
from droptrack.data.frames import Frame
from droptrack.errors import DroptrackError


@dataclass(frozen=True, kw_only=True)
class Camera:
    """What frames show of a simulation. Raises DroptrackError for values that make no image."""

    scale: int = 1  # pixels per lattice node
    blur_px: float = 0.0  # standard deviation
    noise: float = 0.0  # standard deviation in grey levels
    uneven: float = 0.0  # the share by which the darkest corner is darker
    seed: int = 0  # of the noise

    def __post_init__(self) -> None:
        if not 1 <= self.scale <= 16:
            raise DroptrackError(f"--scale {self.scale}: should be 1 to 16")
        if self.blur_px < 0 or self.noise < 0 or not 0 <= self.uneven < 1:
            raise DroptrackError("--blur, --noise: 0 or more; --uneven: 0 up to, but below, 1")


def capture(shade: Floats, camera: Camera, index: int) -> Frame:
    """Frame number `index` of a brightness (H, W) in 0..1 with y up: (H scale, W scale, 3)."""
    image = shade[::-1]
    if camera.scale > 1:
        size = (shade.shape[1] * camera.scale, shade.shape[0] * camera.scale)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), float)
    if camera.blur_px:
        image = blur(image, camera.blur_px)
    levels: Levels = 255 * image.clip(0, 1)
    if camera.uneven:
        y, x = np.mgrid[: levels.shape[0], : levels.shape[1]]
        light = 1 - camera.uneven * (x / levels.shape[1] + y / levels.shape[0]) / 2
        levels = light_unevenly(levels, light)
    if camera.noise:  # its own numbers for every frame, so that a resumed run has the same
        rng = np.random.default_rng([camera.seed, index])
        levels = add_noise(levels, rng.standard_normal(levels.shape), camera.noise)
    return np.repeat(to_pixels(np.round(levels))[..., None], 3, axis=2)
