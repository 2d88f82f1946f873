"""The pair correlation function g(r) in a window whose edge cuts neighbourhoods off."""

import numpy as np
from scipy.spatial import cKDTree

from droptrack.analysis.neighbourhoods import frame_blocks
from droptrack.analysis.structure.window import Window
from droptrack.data.arrays import Floats, Rows
from droptrack.progress import with_progress

BLOCK = 20_000  # rows whose pairs are held at once: reaching far, there are many


def pair_counts(
    frames: Rows, places: Floats, owners: Rows, window: Window, edges: Floats, n: int
) -> tuple[Floats, Floats]:
    """Pairs (n, B) that each of n droplets is in, by their distance, and those of chance (n, B).

    Of rows (M,) in the window, by frames; edges (B + 1,) px. g(r) is the ratio of their sums.
    Chance: places at random, as many in the frame, in the same window.
    """
    inside = window.contains(places)
    frames, places, owners = frames[inside], places[inside], owners[inside]
    bins = len(edges) - 1
    counts, others = np.zeros((n, bins)), np.zeros(n)
    blocks = frame_blocks(frames, BLOCK)
    for block in with_progress(blocks, len(blocks), "pairs", "blocks"):
        first, second, apart = _pairs(frames[block], places[block], window, edges[-1])
        at = np.digitize(apart, edges) - 1
        seen = (at >= 0) & (at < bins)
        for one in (first, second):
            flat = owners[block][one[seen]] * bins + at[seen]
            counts += np.bincount(flat, minlength=n * bins).reshape(n, bins)
        _, which, number = np.unique(frames[block], return_inverse=True, return_counts=True)
        others += np.bincount(owners[block], number[which] - 1.0, n)
    return counts, others[:, None] * window.distance_share(edges)


def _pairs(frames: Rows, places: Floats, window: Window, reach: float) -> tuple[Rows, Rows, Floats]:
    """Pairs of rows of one frame, and their distance, px, through the walls of a periodic box."""
    apart = (frames - frames[0]) * (2 * reach + 1)
    box = np.array(window.size, float)
    sides = np.zeros(3)  # of a box: none
    if window.periodic:
        places, sides = np.mod(places, box), np.append(box, 0.0)
    tree = cKDTree(np.column_stack([places, apart]), boxsize=sides)
    pairs = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
    offset = places[pairs[:, 1]] - places[pairs[:, 0]]
    if window.periodic:
        offset -= box * np.round(offset / box)
    return pairs[:, 0], pairs[:, 1], np.hypot(*offset.T)
