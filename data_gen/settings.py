"""What the simulations' commands share: parameters by name, and the compiled engines."""

import importlib
from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any, TypeVar

from droptrack import DroptrackError

P = TypeVar("P")


def changed(params: P, settings: Iterable[str]) -> P:
    """Parameters with `name=value` settings applied, all at once.

    Raises DroptrackError for names that do not exist and values of the wrong kind.
    """
    kinds: dict[str, Any] = {f.name: type(getattr(params, f.name)) for f in fields(params)}  # type: ignore[arg-type]
    values = {}
    for setting in settings:
        name, _, text = setting.partition("=")
        name = name.strip().replace("-", "_")
        if name not in kinds:
            raise DroptrackError(
                f"--set {setting}: no such parameter; there are {', '.join(kinds)}"
            )
        try:
            values[name] = kinds[name](text)
        except ValueError:
            kind = "a whole number" if kinds[name] is int else "a number"
            raise DroptrackError(f"--set {setting}: {name} should be {kind}") from None
    return replace(params, **values)  # type: ignore[type-var]


def compiled(module: str, threads: int = 0) -> Any:
    """A module of compiled kernels. Raises DroptrackError where Numba is not installed."""
    try:
        numba: Any = importlib.import_module("numba")
    except ImportError:
        raise DroptrackError(
            "simulations need Numba: pip install 'droptrack[simulate]' (or numba)"
        ) from None
    if threads:
        most = numba.config.NUMBA_NUM_THREADS
        if threads > most:
            raise DroptrackError(f"--threads {threads}: this machine has {most}")
        numba.set_num_threads(threads)
    return importlib.import_module(f"data_gen.{module}")
