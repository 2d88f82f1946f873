"""Droplets that coalesce or break up, and bystanders: paths with exact truth of what happened."""

from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

CELL = 6.0  # diameters of a cell with one pair in its middle, and one bystander in its corner
APPROACH = 0.06  # diameters a frame, of each parent
WANDER = 0.01  # diameters a frame, of a bystander


@dataclass(frozen=True, kw_only=True)
class PairEvent:
    """What happened in a frame, the first after it, at x, y px, between droplets by their ids."""

    frame: int
    parents: tuple[int, ...]
    children: tuple[int, ...]
    x: float
    y: float


def merging_pairs(
    rng: np.random.Generator, n: int, diameter: float, n_frames: int, size: tuple[float, float]
) -> tuple[Floats, Floats, list[PairEvent]]:
    """Paths (N, T, 2) px, NaN where a droplet is not; diameters (N, T); and n coalescences.

    The parents are 0.8 to 1.2 diameters large and meet in the middle half of the time; areas add
    up. Identities count from 1. Raises DroptrackError where n cells have no room in the image.
    """
    cell = CELL * diameter
    columns, lines = int(size[0] / cell), int(size[1] / cell)
    if columns * lines < n:
        raise DroptrackError(
            f"no room for {n} events of four droplets: at most {4 * columns * lines} --droplets, "
            "or a smaller --diameter"
        )
    t = np.arange(n_frames)
    paths, sizes, events = [], [], []
    for k in rng.permutation(columns * lines)[:n].tolist():
        corner = np.array([k % columns, k // columns]) * cell
        meet = int(rng.integers(n_frames // 4, 3 * n_frames // 4))
        one, other = rng.uniform(0.8, 1.2, 2) * diameter
        child = float(np.hypot(one, other))
        angle = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(angle), np.sin(angle)])
        middle = corner + cell / 2
        apart = (one + other) / 2 + np.maximum(meet - t, 0) * 2 * APPROACH * diameter
        apart = np.minimum(apart, cell / 2)
        share = other**2 / child**2  # of the distance from the first to the common centre
        first = middle - (apart * share)[:, None] * way
        second = middle + (apart * (1 - share))[:, None] * way
        drift = rng.normal(0, WANDER * diameter, 2)
        bystander = corner + 0.6 * diameter + np.abs(drift) * t[:, None]
        common = np.repeat(middle[None], n_frames, axis=0)
        for path, there, wide in (
            (first, t < meet, one),
            (second, t < meet, other),
            (common, t >= meet, child),
            (bystander, t >= 0, rng.uniform(0.8, 1.2) * diameter),
        ):
            paths.append(np.where(there[:, None], path, np.nan))
            sizes.append(np.full(n_frames, wide))
        base = len(paths) - 3
        events.append(
            PairEvent(
                frame=meet,
                parents=(base, base + 1),
                children=(base + 2,),
                x=float(middle[0]),
                y=float(middle[1]),
            )
        )
    return np.array(paths), np.array(sizes), events


def splitting_pairs(
    rng: np.random.Generator, n: int, diameter: float, n_frames: int, size: tuple[float, float]
) -> tuple[Floats, Floats, list[PairEvent]]:
    """As `merging_pairs`, backwards in time: n break-ups."""
    paths, sizes, events = merging_pairs(rng, n, diameter, n_frames, size)
    turned = [
        PairEvent(
            frame=n_frames - event.frame,
            parents=event.children,
            children=event.parents,
            x=event.x,
            y=event.y,
        )
        for event in events
    ]
    return paths[:, ::-1], sizes[:, ::-1], turned
