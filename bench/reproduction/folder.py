"""The folder of a reproduction: what is done in it, and of which version it is."""

import json
import math
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.reproduction.settings import Settings
from data_gen.lattice_boltzmann.settings import Device
from droptrack.data.files import read_text, write_text
from droptrack.errors import DroptrackError
from droptrack.version import __version__

LAYOUT = 1  # to be raised when a folder of this version cannot be gone on with
STAMP = "reproduction.json"


@dataclass(frozen=True, kw_only=True)
class Given:
    """What a user may have: trained networks, real images with labels, a GPU that simulates."""

    tiny_weights: Path | None = None
    full_weights: Path | None = None
    real: Path | None = None
    device: Device = "auto"


@dataclass(frozen=True)
class Reproduction:
    """A folder, how large everything in it is, and what was given."""

    out: Path
    settings: Settings
    given: Given

    def folder(self, stage: str) -> Path:
        """The folder of a stage."""
        return self.out / stage

    def result(self, stage: str) -> dict[str, Any]:
        """What a stage found. Raises DroptrackError where it was not run."""
        path = self.out / f"{stage}.json"
        if not path.exists():
            raise DroptrackError(f"{path}: is missing; --stage {stage} makes it")
        try:
            found: dict[str, Any] = json.loads(read_text(path))["result"]
        except (ValueError, KeyError):
            raise DroptrackError(f"{path}: is damaged; --stage {stage} makes it again") from None
        return found


@dataclass(frozen=True)
class Stage:
    """One step: `run` writes into its folder and returns what it found.

    `inputs` are options that it depends on; where they change, it runs again.
    """

    name: str
    run: Callable[[Reproduction, Callable[[str], None]], dict[str, Any]]
    inputs: Callable[[Given], Sequence[object]] = lambda _: ()


def run_stages(
    of: Reproduction,
    stages: Sequence[Stage],
    say: Callable[[str], None],
    again_from: str | None = None,
) -> None:
    """Run what is not done yet, one stage after the other; again from a stage on, where named.

    Raises DroptrackError for a folder of another version or with other settings.
    """
    names = [stage.name for stage in stages]
    if again_from is not None and again_from not in names:
        raise DroptrackError(f"--stage {again_from}: should be one of {', '.join(names)}")
    # all before the first stage: a file that is not there is said now, not in half an hour
    needed = [[str(one) for one in stage.inputs(of.given)] for stage in stages]
    claim(of)
    if again_from is not None:
        forget(of, names[names.index(again_from) :])
    for i, (stage, inputs) in enumerate(zip(stages, needed, strict=True)):
        path = of.out / f"{stage.name}.json"
        if path.exists():
            if _inputs_of(path) == inputs:
                say(f"{stage.name}: is there")
                continue
            forget(of, names[i:])
        say(f"{stage.name}: begins")
        start, before = time.perf_counter(), _processor_seconds()
        result = stage.run(of, say)
        seconds = time.perf_counter() - start
        content = {
            "seconds": seconds,
            "processor_seconds": _processor_seconds() - before,
            "inputs": inputs,
            "result": result,
        }
        write_text(path, json.dumps(without_nan(content), indent=1) + "\n")
        say(f"{stage.name}: done in {seconds:.0f} s")


def _processor_seconds() -> float:
    """Processor time of this process and of those that it started and that have ended."""
    return sum(os.times()[:4])


def claim(of: Reproduction) -> None:
    """Make a folder this reproduction's own, or see that it is. Raises DroptrackError."""
    path = of.out / STAMP
    stamp = {
        "droptrack": __version__,
        "layout": LAYOUT,
        "settings": json.loads(json.dumps(asdict(of.settings))),
    }
    if path.exists():
        _refuse_another(path, stamp)
        return
    if of.out.exists() and any(of.out.iterdir()):
        raise DroptrackError(f"{of.out}: is not empty and no reproduction; choose another --out")
    of.out.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(stamp, indent=1) + "\n")


def _refuse_another(path: Path, stamp: Mapping[str, Any]) -> None:
    cure = f"choose another --out, or delete {path.parent}"
    try:
        found = dict(json.loads(read_text(path)))
    except (ValueError, TypeError):
        raise DroptrackError(f"{path}: is damaged; {cure}") from None
    for key in ("droptrack", "layout"):
        if found.get(key) != stamp[key]:
            raise DroptrackError(
                f"{path.parent}: holds results of {key} {found.get(key)}, this is {stamp[key]}; "
                f"{cure}"
            )
    theirs, ours = found.get("settings", {}), stamp["settings"]
    other = [name for name in ours if theirs.get(name) != ours[name]]
    if other:
        scale = theirs.get("scale")
        raise DroptrackError(f"{path.parent}: is a reproduction at --scale {scale}; {cure}")


def forget(of: Reproduction, names: Sequence[str]) -> None:
    """Remove what stages found and wrote."""
    for name in names:
        (of.out / f"{name}.json").unlink(missing_ok=True)
        shutil.rmtree(of.folder(name), ignore_errors=True)


def _inputs_of(path: Path) -> object:
    try:
        return dict(json.loads(read_text(path))).get("inputs")
    except (ValueError, TypeError):
        return None


def without_nan(value: object) -> object:
    """The same with None in the place of what is no finite number, as JSON has no other."""
    if isinstance(value, Mapping):
        return {str(key): without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def defined(value: object) -> bool:
    """Whether a value of a result is a number; None and NaN are not.

    >>> defined(0.5), defined(None), defined(float("nan"))
    (True, False, False)
    """
    return isinstance(value, int | float) and math.isfinite(value)
