"""Loops that Numba compiles, beside the arrays of the module that they stand for."""

import functools
from importlib import import_module
from types import ModuleType


@functools.cache
def compiled(name: str) -> ModuleType | None:
    """The module ``droptrack.<name>_numba``, which does the same as ``droptrack.<name>`` sooner.

    None where Numba is not installed, or finds no folder to keep what it compiled.
    """
    try:
        return import_module(f"droptrack.{name}_numba")
    except (ImportError, RuntimeError):
        return None
