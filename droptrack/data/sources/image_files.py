"""Single image files."""

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.sources.source import Image

TIFF_SUFFIXES = {".tif", ".tiff", ".btf", ".tf8"}
IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".webp", ".pgm", ".ppm", *TIFF_SUFFIXES}
NUMBERS = re.compile(r"(\d+)", re.ASCII)
MAX_PIXELS = 2**28  # of one image; a few bytes can claim any number, and take minutes
ORIENTED = (b"Exif\0\0", b"eXIf", b"EXIF")  # in JPEG, PNG, WebP: the file may say how it is turned


def image_files(folder: Path) -> list[Path]:
    """The images of a folder, in the order of the numbers in their names; no hidden files."""
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    ]

    def order(path: Path) -> list[tuple[int, int, str]]:
        """Numbers in a name count as numbers: frame_2 comes before frame_10."""
        parts = NUMBERS.split(path.name.lower())
        return [(0, int(part), "") if i % 2 else (1, 0, part) for i, part in enumerate(parts)]

    return sorted(files, key=order)


def decode_image(path: Path) -> Image | None:
    """An image file as it is stored, turned as its EXIF data say; None if it cannot be decoded.

    The file is read here, since OpenCV does not open every name. Raises OSError.
    """
    content = path.read_bytes()
    data = np.frombuffer(content, np.uint8)
    if not len(data) or _png_pixels(data) > MAX_PIXELS:
        return None
    flags = cv2.IMREAD_UNCHANGED
    if path.suffix.lower() not in TIFF_SUFFIXES and any(
        mark in data.tobytes() for mark in ORIENTED
    ):
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR  # turned; OpenCV leaves alpha out then
    try:
        image = cv2.imdecode(data, flags)
    except cv2.error:  # more pixels than it takes, for one
        return None
    return None if image is None else np.asarray(image)


def _png_pixels(data: NDArray[np.uint8]) -> int:
    """The number of pixels that a PNG file claims in its IHDR chunk; 0 of other files."""
    head = data[:24].tobytes()
    if not head.startswith(b"\x89PNG"):
        return 0
    return int.from_bytes(head[16:20], "big") * int.from_bytes(head[20:24], "big")
