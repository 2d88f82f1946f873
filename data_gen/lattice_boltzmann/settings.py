"""What the simulations' commands share: parameters by name, the device, the solvers."""

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from typing import Any, Literal, TypeVar

from droptrack.errors import DroptrackError

P = TypeVar("P")
Device = Literal["auto", "cpu", "cuda"]
SOLVERS = {"cpu": "solver", "cuda": "cuda_solver"}  # a file of each model's folder


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


def use_threads(n: int) -> None:
    """Run the solvers' loops on n threads of the CPU, 0 for all.

    Raises DroptrackError where there are fewer, or Numba is not installed.
    """
    _numba_module("cpu_threads").use_threads(n)


def solver_class(model: str, device: Device) -> Any:
    """The class Solver of `color_gradient` or `free_energy` for a device, `cpu` or `cuda`."""
    return _numba_module(f"{model}.{SOLVERS[device]}").Solver


def usable_device(device: Device, say: Callable[[str], object]) -> Device:
    """`cpu` or `cuda`, as wanted; for `auto` the GPU where there is one that works.

    `auto` tells `say` why a GPU for which numba-cuda is installed is not used. Raises
    DroptrackError where `cuda` is wanted and not to be had.
    """
    if device == "cpu":
        return device
    simulated = os.environ.get("NUMBA_ENABLE_CUDASIM", "0") != "0"
    if not (simulated or importlib.util.find_spec("numba_cuda")):
        if device == "auto":
            return "cpu"
        raise DroptrackError(
            "--device cuda needs numba-cuda: pip install 'droptrack[simulate-cuda]'"
        )
    try:
        _numba_module("cuda_device").device_name()
    except DroptrackError as error:
        if device == "cuda":
            raise
        say(f"not used: {error}")
        return "cpu"
    return "cuda"


def _numba_module(name: str) -> Any:
    """A module of this package that imports Numba. Raises DroptrackError where that is missing."""
    try:
        importlib.import_module("numba")
    except ImportError:
        raise DroptrackError(
            "simulations need Numba: pip install 'droptrack[simulate]' (or numba)"
        ) from None
    return importlib.import_module(f"data_gen.lattice_boltzmann.{name}")
