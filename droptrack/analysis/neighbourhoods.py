"""Which droplets of one frame are near each other, for all frames."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from droptrack.data.arrays import Floats, Rows
from droptrack.progress import with_progress

BLOCK = 50_000  # rows whose pairs are held at once


def frame_blocks(frames: Rows, n: int = BLOCK) -> list[slice]:
    """Slices of rows, whose frames (M,) rise, of about n rows: no frame is cut.

    >>> frame_blocks(np.array([0, 0, 1, 1, 1, 2]), 3)
    [slice(0, 5, None), slice(5, 6, None)]
    """
    found, start = [], 0
    while start < len(frames):
        last = min(start + n, len(frames)) - 1
        stop = int(np.searchsorted(frames, frames[last], side="right"))
        found.append(slice(start, stop))
        start = stop
    return found


def close_pairs(frames: Rows, places: Floats, radius: float) -> tuple[Rows, Rows]:
    """Pairs of rows of one frame whose places (M, 2) px are at most `radius` apart, each once.

    Two arrays of rows.
    """
    apart = (frames - frames[0]) * (2 * radius + 1) if len(frames) else frames
    tree = cKDTree(np.column_stack([places, apart]))
    pairs = tree.query_pairs(radius, output_type="ndarray").astype(np.int64)
    return pairs[:, 0], pairs[:, 1]


def blocks_with_pairs(
    frames: Rows, places: Floats, radius: float, task: str
) -> Iterator[tuple[slice, Rows, Rows]]:
    """For block after block of rows: its slice, and its close pairs, counted from its start."""
    blocks = frame_blocks(frames)
    for block in with_progress(blocks, len(blocks), task, "blocks"):
        yield block, *close_pairs(frames[block], places[block], radius)


def some_frames(frames: Rows, most: int) -> Rows:
    """Rows of at most so many frames, evenly over all frames (M,)."""
    all_frames = np.unique(frames)
    if len(all_frames) <= most:
        return np.arange(len(frames))
    kept = all_frames[np.unique(np.linspace(0, len(all_frames) - 1, most).astype(int))]
    return np.flatnonzero(np.isin(frames, kept))


def shuffled(frames: Rows, rng: np.random.Generator) -> Rows:
    """Rows (K,) in an order at random within each frame; frames (K,) rise."""
    return np.lexsort((rng.random(len(frames)), frames))
