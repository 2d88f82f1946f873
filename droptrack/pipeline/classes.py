"""Classes of droplets: their names, the votes of each track's frames, counts of droplets.

A network tells the class of every box, and may tell another one in the next frame. Tracks are
linked without regard to it; in the end, the frames of each vote.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats, Rows
from droptrack.data.darknet_dataset import read_names
from droptrack.data.report import Value
from droptrack.data.trajectories import Trajectories
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, yolo_heads
from droptrack.pipeline.encapsulation import NOT_COUNTED, Cells, compared, parse_cells

CLASS_ID, CLASS_NAME = "class_id", "class_name"  # columns
NO_CLASS = -1  # where a gap was bridged


@dataclass(frozen=True)
class Classes:
    """The names of a network's classes, and how many cells a droplet of each has, where given."""

    names: tuple[str, ...]
    cells: tuple[Cells | None, ...] = ()

    def name_of(self, class_id: int) -> str:
        """The name of a class; empty of NO_CLASS."""
        return "" if class_id == NO_CLASS else self.names[class_id]

    def columns(self, found: Floats) -> dict[str, NDArray[Any]]:
        """The columns of a table, of classes (M,), which are NaN where gaps were bridged."""
        ids = np.where(np.isfinite(found), found, NO_CLASS).astype(np.int64)
        named = np.array([*self.names, ""], np.str_)  # the last one is that of NO_CLASS
        return {CLASS_ID: ids, CLASS_NAME: named[ids]}

    def settings(self) -> dict[str, Value]:
        """What is said of them in a report's settings."""
        said: dict[str, Value] = {"classes": list(self.names)}
        cells = [NOT_COUNTED if one is None else str(one) for one in self.cells]
        return {**said, "cells": cells} if cells else said

    def counts(self, class_ids: Iterable[int]) -> dict[str, Value]:
        """How many droplets there are of each class, and of each number of cells: see `compared`.

        >>> Classes(("empty", "full")).counts([0, 1, 0])
        {'n_of_class': ['empty 2', 'full 1']}
        """
        counted = Counter(class_ids)
        numbers = [counted[k] for k in range(len(self.names))]
        said: dict[str, Value] = {
            "n_of_class": [f"{name} {n}" for name, n in zip(self.names, numbers, strict=True)]
        }
        return {**said, **compared(self.cells, numbers)} if self.cells else said


def classes_of(cfg: Cfg, names: Path | None, cells: str | None) -> Classes | None:
    """The classes of a network; None of one that tells nothing but droplets.

    `names`: a .names file, or the obj.data that names one; without, classes are called by their
    numbers. `cells`: see `parse_cells`. Raises DroptrackError where they do not fit the network.
    """
    n = max(head.classes for head in yolo_heads(cfg))
    if n == 1:
        for option, value in (("--names", names), ("--cells", cells)):
            if value is not None:
                raise DroptrackError(f"{option} {value}: {cfg.path} has one class only")
        return None
    found = tuple(map(str, range(n))) if names is None else read_names(names)
    if len(found) != n:
        raise DroptrackError(f"--names {names}: has {len(found)} names, {cfg.path} {n} classes")
    return Classes(found, () if cells is None else parse_cells(cells, n))


@dataclass
class _Votes:
    """Frames for a class, and the sum of their scores."""

    n: int = 0
    scores: float = 0.0


class ClassVotes:
    """The votes of the frames of each track."""

    def __init__(self, classes: Classes) -> None:
        self.classes = classes
        self._votes: dict[int, dict[int, _Votes]] = {}  # by track and class

    def add(self, rows: Trajectories, ids: Rows) -> None:
        """Take rows (M) and their classes (M,); those of bridged gaps do not vote."""
        seen = ids != NO_CLASS
        columns = (rows.track_id, ids, rows.scores)
        for track_id, class_id, score in zip(*(one[seen].tolist() for one in columns), strict=True):
            votes = self._votes.setdefault(track_id, {}).setdefault(class_id, _Votes())
            votes.n += 1
            votes.scores += score

    def of(self, track_id: int) -> tuple[int, float]:
        """The class that most frames of a track are for, and their share.

        Where two have as many, that of the higher scores.
        """
        votes = self._votes[track_id]
        best = max(votes, key=lambda one: (votes[one].n, votes[one].scores))
        return best, votes[best].n / sum(one.n for one in votes.values())

    def row(self, track_id: int) -> dict[str, Value]:
        """What a report's row of a droplet says."""
        class_id, share = self.of(track_id)
        name = self.classes.name_of(class_id)
        return {CLASS_ID: class_id, CLASS_NAME: name, "class_share": share}

    def summary(self) -> dict[str, Value]:
        """Counts of tracks by their classes."""
        return self.classes.counts(self.of(track_id)[0] for track_id in self._votes)
