"""Lost tracks that new ones continue: they are merged, and the older identity stays."""

import numpy as np
from scipy.spatial import cKDTree

from droptrack.data.arrays import Rows
from droptrack.tracking.association import assign_sparse
from droptrack.tracking.droplet.confirmation import confirmable
from droptrack.tracking.droplet.matching import ANY_SIZE, CANDIDATES, MISS_COST
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.prediction import MIN_DEVIATION
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.nearest import nearest

GATE = 11.8  # chi-square of two degrees of freedom, 99.7 %
Pair = tuple[int, int]  # of a new track and a lost one: rows, or identities


def merge(tracks: Tracks, noise: Noise, p: DropletParameters) -> tuple[Tracks, tuple[Pair, ...]]:
    """Give new tracks the identities of the lost ones that they continue.

    Also gives the identities of each pair as they were, the new one's and the lost one's.
    """
    lost = tracks.confirmed & (tracks.missed > 0)
    if not p.both_ways or not lost.any():
        return tracks, ()
    duplicates = ~tracks.confirmed & (tracks.missed == 0) & (tracks.duplicate_of > 0)
    ready = confirmable(tracks, p) & (tracks.duplicate_of == 0)
    pairs: list[Pair] = []
    if duplicates.any():
        pairs = _duplicates_left(tracks, np.flatnonzero(duplicates), np.flatnonzero(lost))
        lost[[old for _, old in pairs]] = False
    pairs += _meeting(tracks, np.flatnonzero(ready), np.flatnonzero(lost), noise, p)
    if not pairs:
        return tracks, ()
    new, old = np.array(pairs).T
    merged = tuple(zip(tracks.ids[new].tolist(), tracks.ids[old].tolist(), strict=True))
    ids, confirmed = tracks.ids.copy(), tracks.confirmed.copy()
    hits, duplicate_of = tracks.hits.copy(), tracks.duplicate_of.copy()
    ids[new] = ids[old]
    confirmed[new] = True
    hits[new] += hits[old]
    duplicate_of[new] = 0
    tracks = tracks.replaced(ids=ids, confirmed=confirmed, hits=hits, duplicate_of=duplicate_of)
    return tracks[np.delete(np.arange(len(tracks)), old)], merged


def _duplicates_left(tracks: Tracks, duplicates: Rows, lost: Rows) -> list[Pair]:
    """Pairs of a duplicate and its droplet's track: the other box of a droplet is the one left."""
    row_of = dict(zip(tracks.ids[lost].tolist(), lost.tolist(), strict=True))
    pairs = []
    for new in duplicates.tolist():
        old = row_of.pop(int(tracks.duplicate_of[new]), None)
        if old is not None:
            pairs.append((new, old))
    return pairs


def _meeting(
    tracks: Tracks, ready: Rows, lost: Rows, noise: Noise, p: DropletParameters
) -> list[Pair]:
    """Pairs of new and lost tracks that meet, seen from both ends of the gap.

    With constant acceleration, a droplet goes its gap at the mean of the velocities at both
    ends; white acceleration leaves a variance of gap³ / 12, a fourth of that seen from one.
    """
    if not len(ready) or not len(lost):
        return []
    k = min(CANDIDATES, len(lost))
    state = tracks.state
    _, near = nearest(cKDTree(state.position[lost]), state.position[ready], k)
    new, old = np.repeat(ready, k), lost[near.ravel()]
    gap = tracks.missed[old] - tracks.frames[new] + 1
    new, old, gap = new[gap > 0], old[gap > 0], gap[gap > 0]
    velocity = (state.velocity[new] + state.velocity[old]) / 2
    off = tracks.first_position[new] - tracks.last_position[old] - gap[:, None] * velocity
    d = tracks.diameters[old]
    ends = (state.covariance[new, 2] + state.covariance[old, 2]) / d**2
    variance = noise.acceleration**2 * gap**3 / 12 + ends * gap**2 / 4 + 2 * noise.centre**2
    variance = np.maximum(variance, MIN_DEVIATION**2)
    square = (off**2).sum(axis=1) / d**2 / variance
    cost = square + 2 * np.log(2 * np.pi * variance)
    if p.size:
        change = (tracks.log_sizes[new] - tracks.log_sizes[old]) / noise.size
        cost += (change**2).sum(axis=1) + 4 * np.log(noise.size / ANY_SIZE)
    good = (square < GATE) & (cost < MISS_COST)
    rows, columns = assign_sparse(new[good], old[good], cost[good], MISS_COST)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))
