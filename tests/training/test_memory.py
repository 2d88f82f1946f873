"""What a training frees is there for its next iteration, and goes back when it has ended."""

import ctypes
import sys
from pathlib import Path

import numpy as np
import pytest

resource = pytest.importorskip("resource")
pytest.importorskip("torch")

from droptrack.training.pytorch.memory import memory_kept

MB = 2**20
needs_glibc = pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="needs glibc"
)


def faults_of_an_iteration() -> int:
    """Pages that the system has to give for 64 MB, once such a piece was freed before."""
    pages = []
    for _ in range(2):
        before = minor_faults()
        piece = np.empty(64 * MB, np.uint8)
        piece[::4096] = 1
        pages.append(minor_faults() - before)
        del piece
    return pages[1]


def minor_faults() -> int:
    return int(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)


def resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / MB


@needs_glibc
def test_what_was_freed_is_used_again() -> None:
    """64 MB are 16,384 pages of 4 kB, unless the system has larger ones: then fewer, as before."""
    with memory_kept():
        assert faults_of_an_iteration() < 16


@needs_glibc
def test_it_goes_back_to_the_system_at_the_end() -> None:
    before = resident_mb()
    with memory_kept():
        faults_of_an_iteration()
        assert resident_mb() > before + 48
    assert resident_mb() < before + 16
    usual = faults_of_an_iteration()
    assert usual >= 32  # of 2 MB, if the system has such pages: given anew each time
