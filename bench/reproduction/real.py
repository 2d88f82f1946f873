"""The stage ``real``: real images with labels, where a folder of them was given."""

from collections.abc import Callable
from dataclasses import asdict
from itertools import takewhile
from pathlib import Path
from typing import Any

from bench.real import SETS, rows_of
from bench.reproduction.folder import Given, Reproduction
from droptrack.errors import DroptrackError

OURS = "droptrack"  # how the names of its rows begin
MODELS = (("footage model", Path("footage")), ("default model", None))


def score_real(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """What both bundled models and the other methods find on each set of images that is there."""
    folder = of.given.real
    if folder is None:
        return {}
    found: dict[str, Any] = {}
    for name in _sets_in(folder):
        say(f"real images: {name}")
        found[name] = _of_set(folder, name)
    return found


def _sets_in(folder: Path) -> list[str]:
    there = [name for name in SETS if (folder / name).is_dir()]
    if not there:
        raise DroptrackError(f"--real {folder}: has none of the folders {', '.join(SETS)}")
    return there


def _of_set(folder: Path, name: str) -> list[dict[str, Any]]:
    """Rows of a set: the scale that the images suggest, the best fixed scale, the alternatives."""
    rows = []
    for model, weights in MODELS:
        scored = rows_of(folder, name, weights)
        if weights is not None:  # and nothing else twice
            scored = takewhile(lambda one: one[0].startswith(OURS), scored)
        every = list(scored)
        ours = [one for one in every if one[0].startswith(OURS)]
        best = max(ours[1:], key=lambda one: one[1].worth)
        for method, scores in (ours[0], best):
            rows.append({"method": f"{method}, {model}", **asdict(scores)})
    return rows + [{"method": method, **asdict(one)} for method, one in every[len(ours) :]]


def depends_on(given: Given) -> list[object]:
    """What the stage depends on: the sets of images that are there.

    Raises DroptrackError where a folder was named and has none.
    """
    return [] if given.real is None else [given.real, *_sets_in(given.real)]
