"""A page of a TIFF file as OpenCV would have it: BGR, upright, white bright."""

from typing import Any

import numpy as np
import tifffile

from droptrack.data.sources.packed_bits import unpack
from droptrack.data.sources.source import Image
from droptrack.errors import DroptrackError

# YCbCr is RGB once its JPEG is decoded
KNOWN = (
    *(tifffile.PHOTOMETRIC.MINISWHITE, tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB),
    *(tifffile.PHOTOMETRIC.PALETTE, tifffile.PHOTOMETRIC.SEPARATED),
)
JPEG = (6, 7)  # compressions


def is_packed(page: Any) -> bool:
    """Whether a page's grey levels lie bit by bit, not in bytes, and uncompressed."""
    bits = page.bitspersample
    alone = page.samplesperpixel == 1 and not page.is_tiled and page.compression == 1
    return bool(alone and isinstance(bits, int) and bits < 16 and bits != 8)


def unpack_page(page: Any) -> Image | None:
    """The grey levels of a page that `is_packed`; None where it is cut off."""
    first = page.keyframe
    strips = page.parent.filehandle.read_segments(page.dataoffsets, page.databytecounts)
    data = b"".join(strip for strip, _ in strips if strip is not None)
    height, width, bits = first.imagelength, first.imagewidth, first.bitspersample
    levels = unpack(np.frombuffer(data, np.uint8), bits, width)
    return levels[:height] if len(levels) >= height else None


def as_bgr(image: Image, page: Any, axes: str) -> Image:
    """The values of a page (its `keyframe`): samples last, BGR, turned, white bright.

    Raises DroptrackError for colours that are no RGB.
    """
    if page.photometric not in KNOWN and page.compression not in JPEG:
        name = getattr(page.photometric, "name", page.photometric)
        raise DroptrackError(
            f"{page.parent.filehandle.path}: its colours are {name}, which is not read here; "
            "magick IN -colorspace sRGB OUT.tif"
        )
    if image.ndim == 3 and image.shape[0] in (3, 4) and "S" in axes and axes[-1] != "S":
        image = np.moveaxis(image, 0, -1)
    image = image.reshape(image.shape[:2]) if image.ndim == 3 and image.shape[2] == 1 else image
    if page.photometric == tifffile.PHOTOMETRIC.SEPARATED:
        image = _rgb_of_inks(image)
    if image.ndim == 3 and image.shape[2] >= 3:
        image = image[..., [2, 1, 0, *range(3, min(4, image.shape[2]))]]
    bits = page.bitspersample
    if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE and image.dtype.kind == "u":
        image = 2**bits - 1 - image
    if page.photometric == tifffile.PHOTOMETRIC.PALETTE and not page.parent.is_imagej:
        image = np.moveaxis(page.colormap[::-1, image] >> 8, 0, -1).astype(np.uint8)
    elif isinstance(bits, int) and 1 < bits < 8 and image.dtype == np.uint8:
        image = (image.astype(np.uint16) * 255 // (2**bits - 1)).astype(np.uint8)
    orientation = page.tags.get("Orientation")
    return turned(image, int(orientation.value) if orientation is not None else 1)


def _rgb_of_inks(image: Image) -> Image:
    """Cyan, magenta, yellow, black (H, W, 4) on white paper as RGB, as Pillow has it."""
    if image.ndim != 3 or image.shape[2] != 4 or image.dtype.kind != "u":
        raise ValueError(f"four inks expected, not {image.shape} of {image.dtype}")
    white = np.iinfo(image.dtype).max
    paper = white - image.astype(np.float64)
    return np.rint(paper[..., :3] * paper[..., 3:] / white).astype(image.dtype)


def turned(image: Image, orientation: int) -> Image:
    """An image turned upright, as its orientation tag (1 to 8, TIFF 6.0 page 36) says."""
    if orientation >= 5:
        image = image.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1]
    if orientation in (3, 4, 7, 8):
        image = image[::-1]
    return np.ascontiguousarray(image)
