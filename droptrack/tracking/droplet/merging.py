"""Lost tracks that new ones continue: they are merged, and the older identity stays."""

from typing import NamedTuple

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking.association import assign_in_order
from droptrack.tracking.droplet.flow import Flow
from droptrack.tracking.droplet.matching import CANDIDATES
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.passages import Passages
from droptrack.tracking.droplet.prediction import MIN_DEVIATION
from droptrack.tracking.droplet.resumption import resumptions
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.nearest import nearest, tree_of
from droptrack.tracking.tracker import Resumption

GATE = 11.8  # chi-square of two degrees of freedom, 99.7 %
Pair = tuple[int, int]  # of a new track and a lost one: rows, or identities


class Merged(NamedTuple):
    """The identities of each pair as they were, and the long gaps between them."""

    pairs: tuple[Pair, ...] = ()
    resumed: tuple[Resumption, ...] = ()


def merge(
    tracks: Tracks,
    ready: Bools,
    noise: Noise,
    passages: Passages,
    flow: Flow,
    p: DropletParameters,
) -> tuple[Tracks, Passages, Merged]:
    """Give new tracks the identities of the lost ones that they continue.

    `ready` (N,): new tracks that are to be confirmed.
    """
    lost = tracks.confirmed & (tracks.missed > 0)
    if not p.both_ways or not lost.any():
        return tracks, passages, Merged()
    duplicates = ~tracks.confirmed & (tracks.missed == 0) & (tracks.duplicate_of > 0)
    ready = ready & (tracks.duplicate_of == 0)
    pairs: list[Pair] = []
    if duplicates.any():
        pairs = _duplicates_left(tracks, np.flatnonzero(duplicates), np.flatnonzero(lost))
        lost[[old for _, old in pairs]] = False
    met, odds = _meeting(tracks, np.flatnonzero(ready), np.flatnonzero(lost), noise, passages, p)
    log_odds = np.concatenate([np.full(len(pairs), np.nan), odds])
    pairs += met
    if not pairs:
        return tracks, passages, Merged()
    new, old = np.array(pairs).T
    gaps = tracks.unseen[old] - tracks.images[new] + 1
    passages = passages.resuming(tracks.last_position[old], np.maximum(gaps, 1))
    n_frames = tracks.missed[old] - tracks.frames[new]
    merged = Merged(
        pairs=tuple(zip(tracks.ids[new].tolist(), tracks.ids[old].tolist(), strict=True)),
        resumed=resumptions(tracks, old, tracks.first_position[new], n_frames, log_odds, flow),
    )
    ids, confirmed = tracks.ids.copy(), tracks.confirmed.copy()
    hits, duplicate_of = tracks.hits.copy(), tracks.duplicate_of.copy()
    frames, first = tracks.frames.copy(), tracks.first_position.copy()
    ids[new], frames[new], first[new] = ids[old], frames[old], first[old]
    confirmed[new] = True
    hits[new] += hits[old]
    duplicate_of[new] = 0
    tracks = tracks.replaced(
        ids=ids,
        confirmed=confirmed,
        hits=hits,
        duplicate_of=duplicate_of,
        frames=frames,
        first_position=first,
    )
    return tracks[np.delete(np.arange(len(tracks)), old)], passages, merged


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
    tracks: Tracks, ready: Rows, lost: Rows, noise: Noise, passages: Passages, p: DropletParameters
) -> tuple[list[Pair], Floats]:
    """Pairs of new and lost tracks that meet, seen from both ends of the gap, and their log odds.

    With constant acceleration, a droplet goes its gap at the mean of the velocities at both
    ends; white acceleration leaves a variance of gap³ / 12, a fourth of that seen from one.
    A pair is weighed against the alternative that one droplet has left and another has entered.
    """
    if not len(ready) or not len(lost):
        return [], np.zeros(0)
    k = min(CANDIDATES, len(lost))
    state = tracks.state
    _, near = nearest(tree_of(state.position[lost]), state.position[ready], k)
    new, old = np.repeat(ready, k), lost[near.ravel()]
    gap = tracks.missed[old] - tracks.frames[new] + 1
    new, old, gap = new[gap > 0], old[gap > 0], gap[gap > 0]
    velocity = (state.velocity[new] + state.velocity[old]) / 2
    off = tracks.first_position[new] - tracks.last_position[old] - gap[:, None] * velocity
    d = tracks.diameters[old]
    # the old one's velocity as it was when it was lost: what came after counts by itself
    since = noise.acceleration**2 * tracks.missed[old]
    old_end = np.maximum(state.covariance[old, 2] / d**2 - since, 0)
    ends = state.covariance[new, 2] / d**2 + old_end
    variance = noise.acceleration**2 * gap**3 / 12 + ends * gap**2 / 4 + 2 * noise.centre**2
    variance = np.maximum(variance, MIN_DEVIATION**2)
    square = (off**2).sum(axis=1) / d**2 / variance
    cost = square + 2 * np.log(2 * np.pi * variance)
    if p.size:
        cost += _cost_of_sizes(tracks, new, old, noise, passages)
    unseen = tracks.unseen[old] - tracks.images[new] + 1
    ahead = tracks.last_position[old] + gap[:, None] * state.velocity[old]
    cost += 2 * passages.log_odds_of_leaving(tracks.last_position[old], ahead, d)
    cost += 2 * passages.log_density_of_entering(tracks.first_position[new], d)
    cost -= 2 * passages.log_probability_of_gap(unseen)
    good = (square < GATE) & (cost < 0)
    new, old, cost = new[good], old[good], cost[good]
    chosen = assign_in_order(new, old, cost, 0.0)
    pairs = list(zip(new[chosen].tolist(), old[chosen].tolist(), strict=True))
    return pairs, -cost[chosen] / 2


def _cost_of_sizes(
    tracks: Tracks, new: Rows, old: Rows, noise: Noise, passages: Passages
) -> Floats:
    """-2 log likelihood ratio (P,) of pairs' sizes: of one droplet, to any two of the video."""
    own = noise.size**2
    any_two = own + 2 * passages.size_variance
    change = (tracks.log_sizes[new] - tracks.log_sizes[old]) ** 2
    ratio = change * (1 / own - 1 / any_two) + np.log(own / any_two)
    return np.asarray(ratio.sum(axis=1))
