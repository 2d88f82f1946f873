"""Appearance descriptors: unit vectors that are near to each other for boxes of one droplet.

DeepSORT describes a crop by a network trained on pedestrians. Here it is what can be seen of a
droplet: its grey levels on a small grid over the box, and its size.
"""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats
from droptrack.data.frames import Frame, grey_plane

GRID = 8  # cells a side
SAMPLES = 2  # samples a side of each cell
SIZE_SHARE = 0.5  # of the squared length, for the size
TURN_PER_E = np.pi  # angle by which a droplet e times as large differs
MIN_AREA = 1e-6  # px², so that there is a logarithm
MAX_REMAPPED_ROWS = 32767  # that OpenCV takes at once


class DescriptorExtractor(Protocol):
    """Gives the unit descriptors (N, D) of boxes (N, 4) in a frame (H, W, 3)."""

    def __call__(self, frame: Frame, boxes: Floats) -> Floats:
        """Unit descriptors (N, D)."""


def describe(frame: Frame, boxes: Floats) -> Floats:
    """Unit descriptors (N, GRID² + 2) of boxes (N, 4) in a frame (H, W, 3).

    Outside the frame, its edge is continued, so that any box has a descriptor.
    """
    n = len(boxes)
    if not n:
        return np.zeros((0, GRID * GRID + 2))
    k = GRID * SAMPLES
    steps = (np.arange(k) + 0.5) / k - 0.5
    x = boxes[:, :1] + boxes[:, 2:3] * steps - 0.5  # (N, k), OpenCV counts pixel centres from 0
    y = boxes[:, 1:2] + boxes[:, 3:4] * steps - 0.5
    height, width = frame.shape[:2]
    map_x = np.broadcast_to(np.clip(x, 0, width - 1)[:, None, :], (n, k, k))
    map_y = np.broadcast_to(np.clip(y, 0, height - 1)[:, :, None], (n, k, k))
    grey = _sample(frame, map_x.astype(np.float32), map_y.astype(np.float32))
    patches = grey.reshape(n, GRID, SAMPLES, GRID, SAMPLES).mean(axis=(2, 4)).reshape(n, -1)
    length = np.linalg.norm(patches, axis=1, keepdims=True)
    flat = np.full_like(patches, 1 / GRID)  # a black patch has no direction
    patches = np.where(length > 0, patches / np.where(length > 0, length, 1), flat)
    size = describe_sizes(boxes)
    return np.hstack([patches * np.sqrt(1 - SIZE_SHARE), size * np.sqrt(SIZE_SHARE)])


def describe_nothing(frame: Frame, boxes: Floats) -> Floats:
    """Descriptors (N, 0), for trackers that do not compare them."""
    return np.zeros((len(boxes), 0))


def describe_sizes(boxes: Floats) -> Floats:
    """Unit descriptors (N, 2) of boxes (N, 4) by their size alone, where there is no image."""
    angle = TURN_PER_E * np.log(np.maximum(boxes[:, 2] * boxes[:, 3], MIN_AREA)) / 2
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _sample(frame: Frame, map_x: NDArray[np.float32], map_y: NDArray[np.float32]) -> Floats:
    """Grey levels at (N, k, k) places."""
    n, k = map_x.shape[:2]
    at_once = MAX_REMAPPED_ROWS // k
    plane = grey_plane(frame)
    source = frame if plane is None else plane
    parts = []
    for start in range(0, n, at_once):
        rows = slice(start, start + at_once)
        at_x, at_y = map_x[rows].reshape(-1, k), map_y[rows].reshape(-1, k)
        parts.append(
            cv2.remap(source, at_x, at_y, cv2.INTER_LINEAR).reshape(len(at_x) // k, k, k, -1)
        )
    return np.asarray(np.concatenate(parts).mean(axis=3), np.float64)
