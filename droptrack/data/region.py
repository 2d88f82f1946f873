"""A region of interest: the part of a frame in which droplets count."""

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.arrays import Bools, Floats
from droptrack.errors import DroptrackError

POINT = r"\s*(-?\d+(?:\.\d+)?)\s*,\s*(-?\d+(?:\.\d+)?)\s*"
MAX_PX = 1e7  # that a corner may lie beyond the frame
POLYGON = re.compile(rf"(?:{POINT})(?:[\s;]{POINT})*")


@dataclass(frozen=True)
class Region:
    """The pixels (H, W) of a frame that belong to the region."""

    mask: Bools

    @staticmethod
    def read(text: str, width: int, height: int) -> "Region":
        """The region of frames of width x height px that a text names.

        It is a polygon, the corners' x,y in px one after the other, or the path of an image of the
        frames' size, whose black pixels do not belong to the region. Raises DroptrackError for
        what is neither, and for a region without a pixel.

        >>> region = Region.read("10,10 30,10 30,20 10,20", 100, 50)
        >>> region.contains(np.array([[20.0, 15.0], [20.0, 25.0]])).tolist()
        [True, False]
        """
        if POLYGON.fullmatch(text):
            mask = _polygon_mask(text, width, height)
        else:
            mask = _read_mask(Path(text), width, height)
        if not mask.any():
            raise DroptrackError(
                f"--region {text}: no pixel of the {width} x {height} px frames is in it"
            )
        return Region(mask)

    def contains(self, points: Floats) -> Bools:
        """Whether points (N, 2), x and y px, lie in the region (N,)."""
        height, width = self.mask.shape
        columns, rows = np.floor(points).astype(int).T
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        columns, rows = columns.clip(0, width - 1), rows.clip(0, height - 1)
        return np.asarray(inside & self.mask[rows, columns], bool)


def _polygon_mask(text: str, width: int, height: int) -> Bools:
    """The pixels whose centres lie in a polygon, which may reach beyond the frame."""
    corners = np.array([[float(x), float(y)] for x, y in re.findall(POINT, text)], np.float32)
    if len(corners) < 3:
        raise DroptrackError(f"--region {text}: a polygon has at least three corners, x,y x,y x,y")
    if np.abs(corners).max() > MAX_PX:
        raise DroptrackError(f"--region {text}: a corner is too far away, more than {MAX_PX:g} px")
    mask = np.zeros((height, width), np.uint8)
    # a pixel's centre is at c + 0.5, OpenCV counts centres from 0; in sixteenths of a pixel
    points = np.round((corners - 0.5) * 16).astype(np.int32)
    cv2.fillPoly(mask, [points], 1, shift=4)
    return np.asarray(mask > 0)


def _read_mask(path: Path, width: int, height: int) -> Bools:
    if not path.is_file():
        raise DroptrackError(
            f"--region {path}: is neither a polygon, such as '0,0 200,0 200,90', nor an image file"
        )
    try:
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # of an empty file, or one that claims too many pixels
        image = None
    if image is None:
        raise DroptrackError(f"--region {path}: cannot be decoded as an image")
    if image.shape != (height, width):
        raise DroptrackError(
            f"--region {path}: is {image.shape[1]} x {image.shape[0]} px, the frames {width} x "
            f"{height} px; a mask is of the frames' size"
        )
    return np.asarray(image > 0)
