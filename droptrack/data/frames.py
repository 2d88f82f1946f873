"""A frame: a plain (H, W, 3) uint8 BGR array, and what grey ones are made of."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.levels import Levels, levels_in, to_pixels

Frame = NDArray[np.uint8]


def grey_frame(plane: NDArray[np.uint8]) -> Frame:
    """A grey image (H, W) as a frame (H, W, 3): a view, which takes no memory of its own."""
    return np.broadcast_to(plane[..., None], (*plane.shape, 3))


def grey_plane(frame: Frame) -> NDArray[np.uint8] | None:
    """The image (H, W) that a frame of `grey_frame` shows; None of other frames."""
    return frame[..., 0] if frame.strides[2] == 0 else None


def grey_planes(frames: Sequence[Frame]) -> list[NDArray[np.uint8]] | None:
    """The images (H, W) that frames of `grey_frame` show; None where one is another frame."""
    planes = [plane for frame in frames if (plane := grey_plane(frame)) is not None]
    return planes if len(planes) == len(frames) else None


def as_frame(image: NDArray[Any], levels: Levels | None = None) -> Frame:
    """Any decoded image (H, W) or (H, W, C) as a frame: grey becomes BGR, alpha lies on black.

    `levels`: which of more than 8 bits become black and white; without, those that it uses.

    >>> as_frame(np.array([[0, 160, 4095]], np.uint16))[0, :, 0].tolist()
    [0, 10, 255]
    """
    if image.ndim == 2:
        image = image[..., None]
    alpha = None
    if image.shape[2] in (2, 4):
        full = np.iinfo(image.dtype).max if image.dtype.kind in "iu" else 1.0
        image, alpha = image[..., :-1], np.clip(image[..., -1:] / full, 0, 1)
    pixels = to_pixels(image, levels or levels_in([image]))
    if alpha is not None:
        pixels = (pixels * alpha).astype(np.uint8)
    return grey_frame(pixels[..., 0]) if pixels.shape[2] == 1 else pixels
