"""Loops that Numba compiles, beside the arrays of the module that they stand for."""

import functools
from collections.abc import Callable
from importlib import import_module
from threading import Timer
from types import ModuleType

NAMES = ("centroid", "detector")
SLOW = 2.0  # seconds; what was compiled before is loaded in one


@functools.cache
def compiled(name: str) -> ModuleType | None:
    """The module ``droptrack.<name>_numba``, which does the same as ``droptrack.<name>`` sooner.

    None where Numba is not installed, or finds no folder to keep what it compiled.
    """
    try:
        return import_module(f"droptrack.{name}_numba")
    except (ImportError, RuntimeError):
        return None


def load_all(say: Callable[[str], object]) -> None:
    """Load all that is compiled, and tell a user who has to wait for it why."""
    waiting = Timer(SLOW, say, ["compiling loops, once after an installation: some ten seconds"])
    waiting.start()
    try:
        for name in NAMES:
            compiled(name)
    finally:
        waiting.cancel()
