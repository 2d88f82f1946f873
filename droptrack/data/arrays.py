"""Names for the kinds of arrays that functions take and give; shapes stand in their docstrings."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]
Rows = NDArray[np.int64]  # whole numbers: mostly which rows of another array
Bools = NDArray[np.bool_]
Pixels = NDArray[np.uint8]
