"""Whether the droplets that a run found look like droplets: what is wrong, and the cure."""

from collections.abc import Collection
from math import hypot

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.network.darknet_cfg import Cfg, yolo_heads
from droptrack.pipeline.paths import DropletPath

MIN_TRACKS = 10  # fewer say little
SHORT = 2  # observations of a track that is hardly one
MANY = 0.5  # share of the tracks
LONG = 20  # frames that a droplet needs to be called at rest
STILL = 0.05  # of its diameter: as far as a droplet at rest may seem to go
MOVING = 0.5  # of its diameter
MIN_SIZES = 20
FEW = 0.02  # share of sizes that may be of the other kind
GRID = 0.9  # how alike places are within a network's cells, from 0 at random to 1


def doubts(paths: Collection[DropletPath], n_frames: int, cfg: Cfg, scale: float) -> list[str]:
    """What makes one doubt the tracks of a video of so many frames, each in one line.

    `scale`: px of the network's input for a px of the frames, see `Canvas`.
    """
    seen = [path for path in paths if path.points]  # not only cut by the frame's edge
    found = (
        _short_tracks(paths, n_frames),
        _still_tracks(seen),
        _regular_grid(np.array([path.start for path in seen]).reshape(-1, 2), cfg, scale),
    )
    return [doubt for doubt in found if doubt]


def mixed_outlines(n_sizes: int, n_rings: int) -> list[str]:
    """Whether sizes have two meanings: `n_rings` of them are those of rings, outside."""
    if n_sizes < MIN_SIZES or not FEW * n_sizes < n_rings < (1 - FEW) * n_sizes:
        return []
    return [
        f"{n_rings} of {n_sizes} sizes are those of rings, measured outside; the others are those "
        "of what is unlike its surroundings, or lies between lines: diameters of both kinds differ "
        "by the width of the rings; look at the outlines of --contours"
    ]


def _short_tracks(paths: Collection[DropletPath], n_frames: int) -> str:
    n_short = sum(path.n_observed <= SHORT for path in paths)
    if n_frames < LONG or n_short < MIN_TRACKS or n_short < MANY * len(paths):
        return ""
    return (
        f"{n_short} of {len(paths)} droplets were seen in {SHORT} frames or fewer: unless they "
        "cross the view that fast, many boxes are false; try --scale or --diameter, a higher "
        "--score, or --region"
    )


def _still_tracks(paths: Collection[DropletPath]) -> str:
    """Droplets that stay where they are, while most others move."""
    moved = [
        hypot(path.x - path.start[0], path.y - path.start[1]) / max(path.diameter_px, 1e-6)
        for path in paths
        if path.n_observed >= LONG
    ]
    n_still, n_moving = (sum(one <= STILL for one in moved), sum(one >= MOVING for one in moved))
    if not n_still or n_moving < max(2, n_still):
        return ""
    return (
        f"{n_still} of {len(paths)} droplets stay where they are while others move: dirt, a "
        "structure of the channel, or droplets that are stuck; --region leaves places out"
    )


def _regular_grid(places: Floats, cfg: Cfg, scale: float) -> str:
    """Whether places (N, 2) px repeat as the cells of the network do."""
    if len(places) < 2 * MIN_TRACKS:
        return ""
    for stride in sorted({head.stride for head in yolo_heads(cfg)}):
        turns = np.exp(2j * np.pi * places * scale / stride)
        if (np.abs(turns.mean(axis=0)) > GRID).all():
            return (
                f"droplets lie on a grid of {stride / scale:.0f} px, as the network's cells do: "
                "the boxes are false; other --weights are needed, or another --scale"
            )
    return ""
