"""Loops that Numba compiles: a module ``x`` may have a twin ``x_numba``, the same but faster."""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from threading import Timer
from types import ModuleType

SLOW = 2.0  # seconds; what was compiled before is loaded in one


@functools.cache
def compiled_twin(module: str) -> ModuleType | None:
    """The twin of a module, by the module's name.

    None where Numba is not installed, or finds no folder to keep what it compiled. Constants of the
    module go to its twin as arguments: Numba keeps what it compiled until the twin's own file
    changes, so that a constant which the twin imported would be the old one.
    """
    try:
        return import_module(f"{module}_numba")
    except (ImportError, RuntimeError):
        return None


@contextmanager
def explained(say: Callable[[str], object]) -> Iterator[None]:
    """Tell who has to wait for twins to be loaded why."""
    waiting = Timer(SLOW, say, ["compiling loops, once after an installation: some ten seconds"])
    waiting.start()
    try:
        yield
    finally:
        waiting.cancel()
