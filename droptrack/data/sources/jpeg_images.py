"""JPEG images, unless they are damaged.

OpenCV fills what it cannot decode of an image with grey, and says so on stderr only. libjpeg-turbo
itself, through simplejpeg, tells; what it decodes is the same to the last bit, and sooner.
"""

import re

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from droptrack.data.sources.source import Image

EXTRA = re.compile(r"(\d+) extraneous bytes before marker")
MAX_EXTRA = 16  # bytes, as some cameras write after an image that is whole
NO_END = "Premature end of JPEG file"
END = b"\xff\xd9"  # which some cameras leave out


def decode_jpeg(data: NDArray[np.uint8], *, grey: bool) -> Image | None:
    """The image (H, W) of its luma, or (H, W, 3) BGR; None of one that is damaged.

    Raises ValueError for what is no JPEG image, and for a kind that simplejpeg does not decode.
    """
    content, space = data.tobytes(), "GRAY" if grey else "BGR"
    simplejpeg.decode_jpeg_header(content)
    try:
        image = simplejpeg.decode_jpeg(content, space, strict=True)
    except ValueError as error:
        if NO_END in str(error) and not content.endswith(END):
            return decode_jpeg(np.frombuffer(content + END, np.uint8), grey=grey)
        if not is_harmless(str(error)):
            return None
        image = simplejpeg.decode_jpeg(content, space, strict=False)
    return np.asarray(image[..., 0] if grey else image)


def is_damaged(data: NDArray[np.uint8]) -> bool:
    """Whether a JPEG image of a usual kind is damaged; False of what is no such image."""
    try:
        space = simplejpeg.decode_jpeg_header(data.tobytes())[2]
        return space in ("Gray", "YCbCr") and decode_jpeg(data, grey=True) is None
    except ValueError:
        return False


def is_harmless(warning: str) -> bool:
    """Whether an image that has it is whole.

    >>> is_harmless("Corrupt JPEG data: 2 extraneous bytes before marker 0xd9")
    True
    >>> is_harmless("Corrupt JPEG data: premature end of data segment")
    False
    """
    found = EXTRA.search(warning)
    return found is not None and int(found[1]) <= MAX_EXTRA
