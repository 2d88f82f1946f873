"""Makes the .czi files here with Zeiss' own library: pip install pylibCZIrw.

3 times, 2 channels, 12 bits in 16, 16 x 8 px: all levels of time t and channel c are
16 (100 c + 10 t + 1); and 2 times in colour, of B, G, R = 10, 20, 30 and a time more each.
"""

from pathlib import Path

import numpy as np
from pylibCZIrw import czi

HERE = Path(__file__).parent


def write(name: str, images: dict[tuple[int, int], np.ndarray]) -> None:
    """Images by their time and channel."""
    (HERE / name).unlink(missing_ok=True)
    with czi.create_czi(str(HERE / name)) as file:
        for (t, c), image in images.items():
            file.write(data=image, plane={"T": t, "C": c, "Z": 0})
        file.write_metadata("test", scale_x=0.65e-6, scale_y=0.65e-6, scale_z=1e-6)


def grey(level: int) -> np.ndarray:
    """An image of 12 bits."""
    return np.full((8, 16, 1), 16 * level, np.uint16)


write("grey.czi", {(t, c): grey(100 * c + 10 * t + 1) for t in range(3) for c in range(2)})
colour = np.full((8, 16, 3), (10, 20, 30), np.uint8)
write("colour.czi", {(t, 0): colour + np.uint8(t) for t in range(2)})
