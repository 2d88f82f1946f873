"""How far all droplets of a frame go the same way."""

import numpy as np

from droptrack.analysis.bootstrap import standard_error
from droptrack.analysis.flock.headings import Headings
from droptrack.analysis.neighbourhoods import some_frames
from droptrack.data.arrays import Floats

ORDER_FRAMES = 500  # from which the error of the polarisation is taken
DRAWS = 100


def polarisation(
    headings: Headings, weights: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Frames (F,) with two headings or more, the order (F,) in them, and that of chance (F,).

    weights (N,): how often each droplet counts.
    """
    frames, at = np.unique(headings.frames, return_inverse=True)
    w = np.ones(len(headings)) if weights is None else weights[headings.owners]
    angles, n = headings.angles, np.bincount(at, minlength=len(frames))
    total = np.bincount(at, w, len(frames))
    x, y = (np.bincount(at, w * one, len(frames)) for one in (np.cos(angles), np.sin(angles)))
    some = (n >= 2) & (total > 0)
    order = np.hypot(x[some], y[some]) / total[some]
    return frames[some].astype(float), order, np.sqrt(np.pi / (4 * n[some]))


def polarisation_error(headings: Headings, rng: np.random.Generator) -> float:
    """By bootstrap over droplets, each of which is in every frame's mean."""
    some = headings[some_frames(headings.frames, ORDER_FRAMES)]
    known = np.unique(some.owners)
    if len(known) < 2:
        return float("nan")
    draws = []
    for _ in range(DRAWS):
        weights = np.zeros(headings.n_droplets)
        weights[known] = rng.multinomial(len(known), np.full(len(known), 1 / len(known)))
        order = polarisation(some, weights)[1]
        draws.append(order.mean() if len(order) else np.nan)
    return float(standard_error(np.array(draws)))
