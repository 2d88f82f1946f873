"""Grey levels of less than 16 bits that lie one after the other, without unused bits between."""

import numpy as np
from numpy.typing import NDArray


def unpack_10(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Four levels from every five bytes, the highest bits first.

    >>> unpack_10(np.array([0xFF, 0xC0, 0x00, 0x00, 0x01], np.uint8)).tolist()
    [1023, 0, 0, 1]
    """
    a, b, c, d, e = data[: len(data) // 5 * 5].reshape(-1, 5).T.astype(np.uint16)
    levels = [
        a << 2 | b >> 6,
        (b & 0x3F) << 4 | c >> 4,
        (c & 0x0F) << 6 | d >> 2,
        (d & 0x03) << 8 | e,
    ]
    return np.column_stack(levels).ravel()


def unpack_12(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Two levels from every three bytes, the highest bits first.

    >>> unpack_12(np.array([0xFF, 0xF0, 0x01], np.uint8)).tolist()
    [4095, 1]
    """
    a, b, c = data[: len(data) // 3 * 3].reshape(-1, 3).T.astype(np.uint16)
    return np.column_stack([a << 4 | b >> 4, (b & 0x0F) << 8 | c]).ravel()


def unpack(data: NDArray[np.uint8], bits: int, width: int) -> NDArray[np.uint8 | np.uint16]:
    """Whole rows of `width` levels, the highest bits first; each row begins with a byte.

    >>> unpack(np.array([0xF0, 0x12, 0x30, 0x45, 0x60, 0x00], np.uint8), 12, 2).tolist()
    [[3841, 560], [1110, 0]]
    """
    row_bytes = (width * bits + 7) // 8
    rows = data[: len(data) // row_bytes * row_bytes].reshape(-1, row_bytes)
    one_by_one = np.unpackbits(rows, axis=1)[:, : width * bits].reshape(len(rows), width, bits)
    levels = one_by_one @ (1 << np.arange(bits, dtype=np.uint16)[::-1])
    return levels.astype(np.uint8 if bits <= 8 else np.uint16)
