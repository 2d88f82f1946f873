"""What a training frees is there for its next iteration, and goes back when it has ended."""

import ctypes
import subprocess
import sys

import pytest

pytest.importorskip("torch")

# in a process of its own, whose memory no other test has used: minor faults of a second 64 MB after
# a first that was freed, and MB that are resident, meanwhile and afterwards
MEASURED = """
import resource
from pathlib import Path
import numpy as np
from droptrack.training.pytorch.memory import memory_kept

MB = 2**20

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def of_the_second():
    for _ in range(2):
        before = faults()
        piece = np.empty(64 * MB, np.uint8)
        piece[::4096] = 1
        given = faults() - before
        del piece
    return given

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / MB

before = resident()
with memory_kept():
    kept = of_the_second()
    meanwhile = resident() - before
print(kept, meanwhile, resident() - before, of_the_second())
"""


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="needs glibc"
)
def test_what_was_freed_is_used_again_and_goes_back_at_the_end() -> None:
    """64 MB are 16,384 pages of 4 kB, or 32 of 2 MB, where the system has such."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED], capture_output=True, text=True, check=True
    )
    kept, meanwhile, afterwards, usual = map(float, done.stdout.split())
    assert kept < 16
    assert meanwhile > 60
    assert afterwards < 16
    assert usual >= 32
