"""Droplets found in each frame -> trajectories, by what one would pick instead of our trackers."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.data.trajectories import Trajectories, sorted_trajectories

MEMORY = 3  # frames that a droplet may be missed in
TRACKPY = "trackpy.link"
REACH = 0.5  # diameters that a droplet may move in a frame


@dataclass(frozen=True)
class Found:
    """Droplets of one frame: centres (N, 2) and widths and heights (N, 2), px."""

    centres: Floats
    sizes: Floats


Numbered = Sequence[tuple[int, Found]]  # by the frame's number
Linker = Callable[[Numbered, float], Trajectories]  # with the droplets' typical diameter, px


def rows_of(frames: Numbered, ids: Rows | None = None) -> Trajectories:
    """Rows of what was found; identities (M,) in order, or, without, each its own."""
    counts = [len(found.centres) for _, found in frames]
    n = sum(counts)
    numbers = np.repeat(np.array([number for number, _ in frames], np.int64), counts)
    centres = np.concatenate([np.zeros((0, 2)), *(found.centres for _, found in frames)])
    sizes = np.concatenate([np.zeros((0, 2)), *(found.sizes for _, found in frames)])
    return sorted_trajectories(
        frame=numbers,
        track_id=np.arange(1, n + 1, dtype=np.int64) if ids is None else ids,
        x=centres[:, 0],
        y=centres[:, 1],
        boxes=np.hstack([centres, sizes]),
        scores=np.ones(n),
        observed=np.ones(n, bool),
    )


def link_with_trackpy(frames: Numbered, diameter: float) -> Trajectories:
    """trackpy.link with a memory of three frames and a search range of half a diameter.

    Where too many droplets are in reach of each other for it, the range is made smaller.
    """
    import pandas as pd
    import trackpy

    rows = rows_of(frames)
    if not len(rows):
        return rows
    table = pd.DataFrame({"frame": rows.frame, "x": rows.x, "y": rows.y})
    reach = REACH * diameter
    while True:
        try:
            with quiet_trackpy():
                linked: Any = trackpy.link(table, search_range=reach, memory=MEMORY)
            break
        except trackpy.SubnetOversizeException:
            reach *= 0.7
    ids = linked["particle"].sort_index().to_numpy(np.int64) + 1
    return rows_of(frames, ids)


@contextmanager
def quiet_trackpy() -> Iterator[None]:
    """Within, trackpy says nothing of what it finds or not, nor pandas of how trackpy uses it."""
    import trackpy

    trackpy.quiet()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def link_with_norfair(frames: Numbered, diameter: float) -> Trajectories:
    """Norfair: Kalman filters and distances; a track begins with its first detection."""
    import norfair

    tracker = norfair.Tracker("euclidean", REACH * diameter, initialization_delay=0)
    first = np.concatenate([[0], np.cumsum([len(found.centres) for _, found in frames])])
    ids = np.zeros(int(first[-1]), np.int64)
    for k, (_, found) in enumerate(frames):
        seen: list[Any] = [
            norfair.Detection(np.array([centre]), data=int(first[k]) + i)
            for i, centre in enumerate(found.centres)
        ]
        for tracked in tracker.update(seen):
            row = tracked.last_detection.data
            if row >= first[k] and tracked.id is not None:  # of this frame
                ids[row] = tracked.id
    kept = ids > 0
    parts = np.split(kept, first[1:-1])
    some = [
        (number, Found(found.centres[part], found.sizes[part]))
        for (number, found), part in zip(frames, parts, strict=True)
    ]
    return rows_of(some, ids[kept])


def linkers() -> dict[str, Linker]:
    """Those that are installed."""
    found: dict[str, Linker] = {}
    if find_spec("trackpy") is not None:
        found[TRACKPY] = link_with_trackpy
    if find_spec("norfair") is not None:
        found["Norfair"] = link_with_norfair
    return found
