"""Files of Phantom cameras, ``.cine``: grey, uncompressed, 8, 10, 12 or 16 bits.

Vision Research, "Cine File Format" (2011): CINEFILEHEADER, BITMAPINFOHEADER, SETUP, a table of the
images' offsets; before each image an annotation that begins with its own size.
"""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.data.sources.packed_bits import unpack_10, unpack_12
from droptrack.data.sources.source import (
    Image,
    ReadOptions,
    Source,
    random_access,
    refuse_channel,
)
from droptrack.errors import DroptrackError

MAX_SIDE = 65_536  # px
UNPACKED, PACKED_10, PACKED_12 = 0, 256, 1024  # biCompression
# places in SETUP
FRAME_RATE_16, LENGTH, FRAME_RATE, COLOUR_FILTER, REAL_BITS = 0, 142, 768, 808, 896
CONVERT = "save it as TIFF of 16 bits with Phantom Camera Control (PCC), or with ffmpeg"


def open_cine(path: Path, options: ReadOptions) -> Source:
    """A ``.cine`` file as a video; raises DroptrackError for what it cannot be."""
    refuse_channel(str(path), options)
    try:
        return _open(path)
    except (struct.error, OSError, OverflowError) as error:
        raise DroptrackError(f"{path}: cannot be read as .cine: {error}") from None


def _open(path: Path) -> Source:
    data: NDArray[np.uint8] = np.zeros(0, np.uint8)
    if path.stat().st_size:
        data = np.memmap(path, np.uint8, "r")

    def field(kind: str, place: int) -> int:
        size = struct.calcsize(f"<{kind}")
        return int(struct.unpack(f"<{kind}", data[place : place + size].tobytes())[0])

    if data[:2].tobytes() != b"CI":
        raise DroptrackError(f"{path}: is no .cine file; is it cut off, or renamed?")
    compression, n_frames = field("H", 4), field("I", 20)
    image_header, setup, table = field("I", 24), field("I", 28), field("I", 32)
    width, height = field("i", image_header + 4), field("i", image_header + 8)
    bits, packing = field("H", image_header + 14), field("I", image_header + 16)
    if not (0 < width <= MAX_SIDE and 0 < abs(height) <= MAX_SIDE):
        raise DroptrackError(f"{path}: claims to be {width} x {height} px")
    knows_more = field("H", setup + LENGTH) > REAL_BITS
    colour = field("I", setup + COLOUR_FILTER) if knows_more else 0
    known = packing in (PACKED_10, PACKED_12) or (packing == UNPACKED and bits in (8, 16))
    if compression or colour or not known:
        kind = "in colour" if colour or compression == 2 or bits > 16 else "compressed"
        raise DroptrackError(f"{path}: is {kind}, which is not read here; {CONVERT}")
    size = width * abs(height)
    n_bytes = size * {PACKED_10: 5, PACKED_12: 6}.get(packing, bits // 2) // 4
    offsets = np.frombuffer(data[table : table + 8 * n_frames].tobytes()[: 8 * n_frames], np.uint8)
    starts = offsets[: len(offsets) // 8 * 8].view("<u8").tolist()

    def read(number: int) -> Image | None:
        start = starts[number]
        if start + 4 > len(data):
            return None
        start += field("I", start)
        raw = np.asarray(data[start : start + n_bytes])
        if len(raw) < n_bytes:
            return None
        if packing == PACKED_10:
            return unpack_10(raw).reshape(-1, width)
        if packing == PACKED_12:
            return unpack_12(raw).reshape(-1, width)
        image = raw.view("<u2" if bits == 16 else np.uint8).reshape(-1, width)
        return image[::-1] if height > 0 else image  # a bitmap's lowest row comes first

    real_bits = field("I", setup + REAL_BITS) if knows_more else 0
    rate = field("I", setup + FRAME_RATE) if knows_more else field("H", setup + FRAME_RATE_16)
    real_bits = {PACKED_10: 10, PACKED_12: 12}.get(packing, real_bits)
    notes = (f"{path}: its 10 bits are not linear in light",) if packing == PACKED_10 else ()
    return random_access(
        lambda number: read(number) if number < len(starts) else None,
        Source(
            n_frames=min(n_frames, len(data)),
            bits=real_bits if 8 < real_bits <= 16 else 0,
            fps=float(rate),
            notes=notes,
        ),
    )
