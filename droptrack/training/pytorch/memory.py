"""Memory that a training gets again and again: glibc gives large pieces back to the system at once.

It then maps, and the system fills with zeros, what the next iteration needs: a fifth to a third of
the time of one on a CPU (docs/training.md).
"""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# of glibc's malloc.h, and what it has by default
M_TRIM_THRESHOLD, TRIM_THRESHOLD = -1, 128 * 1024
M_MMAP_MAX, MMAP_MAX = -4, 65536
ALL = 2**31 - 1


@contextmanager
def memory_kept() -> Iterator[None]:
    """Keep what is freed meanwhile for what is asked for next, where glibc manages memory."""
    libc = ctypes.CDLL(None) if sys.platform == "linux" else None
    if libc is None or not hasattr(libc, "mallopt"):
        yield
        return
    libc.mallopt(M_MMAP_MAX, 0)
    libc.mallopt(M_TRIM_THRESHOLD, ALL)
    try:
        yield
    finally:
        libc.mallopt(M_MMAP_MAX, MMAP_MAX)
        libc.mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD)
        libc.malloc_trim(0)
