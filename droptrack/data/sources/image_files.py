"""Single image files."""

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.files import replacing
from droptrack.data.sources.jpeg_images import is_damaged
from droptrack.data.sources.opencv_names import without_log
from droptrack.data.sources.source import Image
from droptrack.errors import DroptrackError

TIFF_SUFFIXES = {".tif", ".tiff", ".btf", ".tf8"}
IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".webp", ".pgm", ".ppm", *TIFF_SUFFIXES}
NUMBERS = re.compile(r"(\d+)", re.ASCII)
MAX_PIXELS = 2**28  # of one image; a few bytes can claim any number, and take minutes
JPEG = b"\xff\xd8\xff"  # first bytes
PLAIN_PNM = (b"P1", b"P2", b"P3")  # first bytes of images in text
ORIENTED = (b"Exif\0\0", b"eXIf", b"EXIF")  # in JPEG, PNG, WebP: the file may say how it is turned


def image_files(folder: Path) -> list[Path]:
    """The images of a folder, in the order of the numbers in their names; no hidden files.

    A link that leads nowhere is one that cannot be read.
    """
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES
        and not path.name.startswith(".")
        and (path.is_file() or (path.is_symlink() and not path.exists()))
    ]

    def order(path: Path) -> list[tuple[int, int, str]]:
        """Numbers in a name count as numbers: frame_2 comes before frame_10."""
        parts = NUMBERS.split(path.name.lower())
        return [(0, int(part), "") if i % 2 else (1, 0, part) for i, part in enumerate(parts)]

    return sorted(files, key=order)


def decode_image(path: Path) -> Image | None:
    """An image file as it is stored, turned as its EXIF data say; None if it cannot be decoded.

    The file is read here, since OpenCV does not open every name. Raises OSError, and DroptrackError
    for one that holds several images.
    """
    content = path.read_bytes()
    if content[:2] in PLAIN_PNM:
        content += b"\n"  # without which OpenCV takes the last number for cut off
    data = np.frombuffer(content, np.uint8)
    if not len(data) or _png_pixels(data) > MAX_PIXELS:
        return None
    if content.startswith(JPEG) and is_damaged(data):  # of which OpenCV would fill a part with grey
        return None
    if (n := _n_animated(content)) > 1:
        raise DroptrackError(
            f"{path}: is an animation of {n} images; save each as a file: magick IN OUT_%04d.png"
        )
    flags = cv2.IMREAD_UNCHANGED
    if path.suffix.lower() not in TIFF_SUFFIXES and any(
        mark in data.tobytes() for mark in ORIENTED
    ):
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR  # turned; OpenCV leaves alpha out then
    try:
        with without_log():
            image = cv2.imdecode(data, flags)
    except cv2.error:  # more pixels than it takes, for one
        return None
    return None if image is None else np.asarray(image)


def write_image_file(path: Path, image: NDArray[np.uint8], quality: int = 95) -> None:
    """Write an image (H, W) or (H, W, 3) BGR in the format of the suffix, whole or not at all.

    `quality`: of JPEG, in %. The file is written here, since OpenCV does not open every name.
    Raises DroptrackError.
    """
    _, data = cv2.imencode(path.suffix, image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    with replacing(path) as partial:
        partial.write_bytes(data.tobytes())


def _png_pixels(data: NDArray[np.uint8]) -> int:
    """The number of pixels that a PNG file claims in its IHDR chunk; 0 of other files."""
    head = data[:24].tobytes()
    if not head.startswith(b"\x89PNG"):
        return 0
    return int.from_bytes(head[16:20], "big") * int.from_bytes(head[20:24], "big")


def _n_animated(content: bytes) -> int:
    """The number of images in an animated PNG (chunk acTL) or WebP (chunks ANMF), else 1."""
    if content.startswith(b"\x89PNG"):
        place = content.find(b"acTL", 0, content.find(b"IDAT"))
        return int.from_bytes(content[place + 4 : place + 8], "big") if place > 0 else 1
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP" and content[12:16] == b"VP8X":
        return max(1, content.count(b"ANMF")) if content[20] & 2 else 1
    return 1
