"""What the simulations' commands share: parameters by name, the device, the compiled engines."""

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from typing import Any, Literal, TypeVar

from droptrack.errors import DroptrackError

P = TypeVar("P")
Device = Literal["auto", "cpu", "cuda"]
ENGINES = {"cpu": "engine", "cuda": "cuda_engine"}  # a file of each model's folder


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
    return importlib.import_module(f"data_gen.lattice_boltzmann.{module}")


def engine(model: str, device: Device) -> Any:
    """The Engine class of `color_gradient` or `free_energy` for a device, `cpu` or `cuda`."""
    return compiled(f"{model}.{ENGINES[device]}").Engine


def usable_device(device: Device, say: Callable[[str], None]) -> Device:
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
        compiled("cuda_device").device_name()
    except DroptrackError as error:
        if device == "cuda":
            raise
        say(f"not used: {error}")
        return "cpu"
    return "cuda"
