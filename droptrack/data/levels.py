"""Grey levels of more than 8 bits -> 8: which of them become black and white.

Cameras of 10, 12 or 14 bits write 16; their white is 1023, 4095 or 16383, not 65535. What they use
is said by the file, or seen from some of its images. It holds for a whole video, so that its grey
levels can be compared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.errors import DroptrackError

DEPTHS = (8, 10, 12, 14, 16)  # bits of cameras
MIN_USED = 0.25  # share of a depth below which only the range in use is shown
OUTLIERS_PERCENT = 0.01  # of the pixels, at either end of that range: hot and dead ones

MAX_COUNTED = 1_000_000  # pixels of an image that are sorted for it

Image = NDArray[Any]


@dataclass(frozen=True)
class Levels:
    """The grey levels that become black and white, and how they are known.

    Whole numbers are cut as a camera of 8 bits would: of 0 and 4095, level 16 n becomes n.
    """

    black: float
    white: float
    reason: str

    def __str__(self) -> str:
        return f"{self.black:g} to {self.white:g}, {self.reason}"


EIGHT_BITS = Levels(0, 255, "8 bits")


def levels_of_bits(bits: int) -> Levels:
    """Those of a file that says how many bits it uses."""
    return Levels(0, 2**bits - 1, f"{bits} bits, as the file says")


def given_levels(black: float, white: float) -> Levels:
    """Those that a user wants; raises DroptrackError where they are none."""
    if not (math.isfinite(black) and math.isfinite(white) and black < white):
        raise DroptrackError(f"--levels {black:g} {white:g}: the first should be the lower one")
    return Levels(black, white, "as given")


def levels_in(images: Sequence[Image]) -> Levels:
    """The levels that images (H, W) or (H, W, C) of one type, without alpha, use.

    That is the smallest of the DEPTHS that holds all of them, from 0 on; of fractions, 0 to 1. The
    range in use instead, where that is less than a quarter of it, as over a high dark level, and
    where there are values below 0.

    >>> print(levels_in([np.array([[70, 3000]], np.uint16)]))
    0 to 4095, 12 bits, as its values show
    >>> print(levels_in([np.array([[30_000, 31_000]], np.uint16)]))
    30000 to 31000, the range of its values
    """
    if not images or images[0].dtype in (np.uint8, np.bool_):
        return EIGHT_BITS
    few = [_finite(image.ravel()[:: max(1, image.size // MAX_COUNTED)]) for image in images]
    values = np.concatenate(few)
    if values.dtype == np.float16:  # in which NumPy 2.0 cannot count them
        values = values.astype(np.float32)
    if not len(values):
        return EIGHT_BITS
    limits = [(all_.min(), all_.max()) for one in images if len(all_ := _finite(one.ravel()))]
    lowest, highest = float(min(limits)[0]), float(max(high for _, high in limits))
    low = float(np.percentile(values, OUTLIERS_PERCENT, method="lower"))
    high = float(np.percentile(values, 100 - OUTLIERS_PERCENT, method="higher"))
    if values.dtype.kind == "f" and lowest >= 0 and highest <= 1:
        depth = Levels(0, 1, "fractions")
    else:
        bits = next((bits for bits in DEPTHS if highest < 2**bits), 0)
        depth = Levels(0, 2.0**bits - 1, f"{bits} bits, as its values show")
    whole = values.dtype.kind in "iu"
    uses_depth = lowest >= 0 and highest <= depth.white and high - low >= MIN_USED * depth.white
    uniform = lowest == highest
    if uses_depth or ((uniform or (whole and depth.white == 255)) and 0 <= lowest <= depth.white):
        return depth
    if low == high:
        low, high = lowest, highest
    return Levels(low, high, "the range of its values") if low < high else EIGHT_BITS


def _finite(values: Image) -> Image:
    return values[np.isfinite(values)] if values.dtype.kind == "f" else values


def to_pixels(image: Image, levels: Levels) -> NDArray[np.uint8]:
    """Values of any type as uint8: black and below is 0, white and above 255.

    >>> to_pixels(np.array([0, 160, 4095], np.uint16), levels_of_bits(12)).tolist()
    [0, 10, 255]
    """
    if image.dtype == np.bool_:
        return np.asarray(image * np.uint8(255), np.uint8)
    if image.dtype == np.uint8 and (levels.black, levels.white) == (0, 255):
        return np.asarray(image, np.uint8)
    black, white = levels.black, levels.white
    if image.dtype in (np.uint8, np.uint16):
        return np.asarray(_every_level(np.iinfo(image.dtype).max, black, white)[image])
    whole = image.dtype.kind in "iu"
    values = np.asarray(image, np.float64)
    return _scaled(np.nan_to_num(values, posinf=white, neginf=black), black, white, whole=whole)


@lru_cache(maxsize=4)
def _every_level(highest: int, black: float, white: float) -> NDArray[np.uint8]:
    """What each level from 0 to the highest becomes: a table, the same for all frames."""
    return _scaled(np.arange(highest + 1, dtype=np.float64), black, white, whole=True)


def _scaled(
    values: NDArray[np.float64], black: float, white: float, *, whole: bool
) -> NDArray[np.uint8]:
    """0 to 255; of more than 255 levels of whole numbers, equally many become each of these."""
    if whole and white - black >= 255:
        scaled = np.floor((values - black) * 256 / (white - black + 1))
    else:
        scaled = (values - black) * 255 / (white - black)
    return np.clip(scaled, 0, 255).astype(np.uint8)
