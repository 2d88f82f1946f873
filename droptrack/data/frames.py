"""A frame: a plain (H, W, 3) uint8 BGR array, and what grey ones are made of."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def negative(frame: Frame) -> Frame:
    """A frame with dark and bright exchanged."""
    plane = grey_plane(frame)
    return 255 - frame if plane is None else grey_frame(255 - plane)


def as_frame(image: NDArray[Any]) -> Frame:
    """Any decoded image as a frame: grey becomes BGR, alpha lies on black, 16 bits become 8."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    elif image.dtype != np.uint8:
        scaled = np.nan_to_num(np.asarray(image, np.float64))
        image = np.clip(scaled * (255 if scaled.max(initial=0) <= 1 else 1), 0, 255).astype(
            np.uint8
        )
    if image.ndim == 2:
        image = image[..., None]
    if image.shape[2] == 1:
        return grey_frame(np.asarray(image[..., 0], np.uint8))
    if image.shape[2] == 2:  # grey with alpha
        return as_frame((image[..., 0] * (image[..., 1] / 255.0)).astype(np.uint8))
    if image.shape[2] == 4:
        return np.asarray(image[..., :3] * (image[..., 3:] / 255.0), np.uint8)
    return np.asarray(image, np.uint8)
