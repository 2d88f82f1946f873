"""From a field to a frame: scale, and the flaws of a camera. The truth stays what it is."""

from dataclasses import dataclass

import cv2
import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.frames import Frame
from droptrack.errors import DroptrackError


@dataclass(frozen=True)
class Camera:
    """Pixels a lattice node; blur's sigma in px; noise's sigma in grey levels; uneven light 0..1.

    Raises DroptrackError for values that make no picture.
    """

    scale: int = 1
    blur_px: float = 0.0
    noise: float = 0.0
    uneven: float = 0.0  # the darkest corner is darker by this share
    seed: int = 0  # of the noise

    def __post_init__(self) -> None:
        if not 1 <= self.scale <= 16:
            raise DroptrackError(f"--scale {self.scale}: should be 1 to 16")
        if self.blur_px < 0 or self.noise < 0 or not 0 <= self.uneven < 1:
            raise DroptrackError("--blur, --noise: 0 or more; --uneven: 0 up to, but below, 1")


def photograph(shade: Floats, camera: Camera, index: int) -> Frame:
    """Frame number `index` of a brightness (H, W) in 0..1 with y up: (H scale, W scale, 3)."""
    image = shade[::-1]
    if camera.scale > 1:
        size = (shade.shape[1] * camera.scale, shade.shape[0] * camera.scale)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), float)
    if camera.blur_px:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), camera.blur_px), float)
    grey = 255 * image.clip(0, 1)
    if camera.uneven:
        y, x = np.mgrid[: grey.shape[0], : grey.shape[1]]
        grey *= 1 - camera.uneven * (x / grey.shape[1] + y / grey.shape[0]) / 2
    if camera.noise:  # its own numbers for every frame, so that a resumed run has the same
        rng = np.random.default_rng([camera.seed, index])
        grey = grey + rng.normal(0, camera.noise, grey.shape)
    return np.repeat(np.round(grey).clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)
