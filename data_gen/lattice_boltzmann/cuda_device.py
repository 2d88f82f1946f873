"""The GPU of the simulations: whether it works, and what their solvers share on it."""

import math
from typing import Any

import numpy as np
from numba import cuda

from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

BLOCK = (32, 4)  # threads in x and y: those of a warp read nodes that lie side by side


def blocks_of(shape: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """How to launch a kernel with a thread for every node of a grid (H, W)."""
    height, width = shape
    return (math.ceil(width / BLOCK[0]), math.ceil(height / BLOCK[1])), BLOCK


def pinned(shape: tuple[int, ...]) -> Floats:
    """An array of the host that the GPU reads and writes by itself: copies are times faster."""
    return np.asarray(cuda.pinned_array(shape)) if all(shape) else np.empty(shape)


@cuda.jit
def _count(numbers: Any) -> None:
    i = cuda.grid(1)
    if i < len(numbers):
        numbers[i] = i


def device_name() -> str:
    """Name of the GPU, which has run a kernel; raises DroptrackError where none does."""
    try:
        numbers = cuda.to_device(np.zeros(128))
        _count[128, 1](numbers)
        counted = numbers.copy_to_host()
        name: Any = getattr(cuda.current_context().device, "name", "CUDA's simulator")
    except Exception as error:  # noqa: BLE001  each of CUDA's libraries has kinds of its own
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = " ".join(lines).rstrip(" .:") or type(error).__name__
        raise DroptrackError(
            f"CUDA does not work here: {reason} (`nvidia-smi` should list a GPU and a driver of "
            "CUDA 13 or newer; --device cpu does without)"
        ) from None
    if (counted != np.arange(128)).any():
        raise DroptrackError("CUDA does not work here: its results are wrong; give --device cpu")
    return name.decode() if isinstance(name, bytes) else str(name)
