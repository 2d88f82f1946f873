"""Which detection continues which track.

Each track is weighed against the detections near its prediction, by place, size and perhaps
appearance. Costs are -2 log likelihoods: of a box that is right, and of one that is wrong, as one
in a hundred is.
"""

from math import log
from typing import NamedTuple

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.association import assign_in_order
from droptrack.tracking.droplet.noise import MIN_FALSE_DENSITY, FalseBoxes, Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.prediction import detection_variance
from droptrack.tracking.droplet.tracks import Observations, Tracks
from droptrack.tracking.motion_filter import squares
from droptrack.tracking.nearest import ROUNDING, nearest_within
from droptrack.tracking.row_selection import select

CANDIDATES = 8  # detections that a track is weighed against
MISS_COST = 15.0  # -2 log likelihood of a miss and MIN_FALSE_DENSITY false boxes
WRONG_DEVIATION = 0.3  # diameters, standard deviation of the place of a wrong box
WRONG_SIZE = 0.3  # standard deviation of the logarithm of width and height of a wrong box
WRONG_COST = 9.0  # -2 log 0.01
ANY_SIZE = 0.4  # standard deviation of the logarithm of width and height of all droplets
MIN_EVIDENCE = 25.0  # 2 log likelihood ratio of a droplet, at which it is confirmed
LEAST_WEIGHT = 0.01  # of a pair's evidence
FRAME_COST = 0.5  # of every further frame that a track was missed,
MAX_COSTLY_FRAMES = 10  # up to these


class Matches(NamedTuple):
    """K pairs of a track and a detection.

    rows (K,): of the tracks, rising; columns (K,): of the detections; evidence (K,): 2 log
    likelihood ratio of each pair to a miss and a false box; free (F,): detections without a track,
    rising.
    """

    rows: Rows
    columns: Rows
    evidence: Floats
    free: Rows


class _Pairs(NamedTuple):
    """P pairs of a track and a detection that may belong together."""

    rows: Rows  # of the tracks, rising
    columns: Rows  # of the detections
    square: Floats  # (P,) of the distance from the prediction, squared diameters


class _LikelihoodTerms(NamedTuple):
    """Of -2 log likelihoods of boxes about N predictions: of right boxes, then of wrong ones.

    Place and size have normal distributions.
    """

    variance: Floats  # (2, N) of the place, squared diameters
    place_term: Floats  # (2, N) the same for all boxes of a track
    size_variance: Floats  # (2, 1) of the logarithm of width and height
    size_term: Floats  # (2, 1) the same for all boxes
    price: Floats  # (2, 1) of being such a box at all


def match(
    tracks: Tracks,
    found: Observations,
    noise: Noise,
    false: FalseBoxes,
    others: float,
    p: DropletParameters,
) -> Matches:
    """Assign a frame's detections to predicted tracks; the denser false boxes, the fewer match.

    `others`: 2 log likelihood ratio of a detection of another droplet to a false box, where
    droplets are so few that another one may well be where a lost one could be; else 0.
    """
    if not len(tracks) or not len(found):
        none = np.zeros(0, np.int64)
        return Matches(none, none, np.zeros(0), np.arange(len(found)))
    max_cost = MISS_COST - 2 * log(false.density / MIN_FALSE_DENSITY)
    terms = _likelihood_terms(tracks, noise, with_sizes=p.size)
    pairs = _near_pairs(tracks, found, terms, max_cost, p)
    cost = _costs(tracks, found, pairs, terms, p)
    if others:
        cost[tracks.missed[pairs.rows] > 1] += others
    good = cost < max_cost
    rows, columns, evidence = pairs.rows[good], pairs.columns[good], max_cost - cost[good]
    price = -_weight(tracks, rows, evidence)
    chosen = assign_in_order(rows, columns, price, 0.0, jointly=p.jointly)
    rows, columns, evidence = rows[chosen], columns[chosen], evidence[chosen]
    free = np.ones(len(found), bool)
    free[columns] = False
    return Matches(rows, columns, evidence, free.nonzero()[0])


def _weight(tracks: Tracks, rows: Rows, evidence: Floats) -> Floats:
    """What pairs (P,) of tracks in `rows`, with their evidence, weigh against each other.

    A new track may have come from a false box, and then its miss is none. So what it still lacks to
    be a droplet counts against it; where nothing else wants the detection, it is its own all the
    same.
    """
    if tracks.confirmed.all():
        return evidence
    lack = np.where(tracks.confirmed, 0, np.maximum(MIN_EVIDENCE - tracks.evidence, 0))
    return np.maximum(evidence - lack[rows], LEAST_WEIGHT * evidence)


def _likelihood_terms(tracks: Tracks, noise: Noise, *, with_sizes: bool) -> _LikelihoodTerms:
    right = detection_variance(tracks.state, tracks.diameters, noise)
    variance = np.array([right, right + WRONG_DEVIATION**2])
    size_variance = [noise.size**2, noise.size**2 + WRONG_SIZE**2]
    size_term = [2 * log(one / ANY_SIZE**2) if with_sizes else 0.0 for one in size_variance]
    return _LikelihoodTerms(
        variance=variance,
        place_term=2 * np.log(2 * np.pi * variance),
        size_variance=np.array(size_variance)[:, None],
        size_term=np.array(size_term)[:, None],
        price=np.array([[0.0], [WRONG_COST]]),
    )


def _near_pairs(
    tracks: Tracks,
    found: Observations,
    terms: _LikelihoodTerms,
    max_cost: float,
    p: DropletParameters,
) -> _Pairs:
    """The CANDIDATES detections of each track that are nearest, those that may cost little enough.

    Tracks that were missed for too long have none.
    """
    # what is further away costs more than `max_cost`, whatever its size
    right, wrong = terms.variance * (max_cost - terms.place_term - terms.price - terms.size_term)
    square = np.maximum(np.maximum(right, wrong), 0)
    reach = np.minimum(p.max_step, np.sqrt(square) * (1 + ROUNDING))
    recent = tracks.missed <= (p.short_gap + 1 if p.both_ways else p.max_age)
    rows, columns, distance = nearest_within(
        tracks.state.position,
        np.where(recent, reach * tracks.diameters, -1),
        found.boxes[:, :2],
        CANDIDATES,
    )
    return _Pairs(rows, columns, (distance / tracks.diameters[rows]) ** 2)


def _costs(
    tracks: Tracks,
    found: Observations,
    pairs: _Pairs,
    terms: _LikelihoodTerms,
    p: DropletParameters,
) -> Floats:
    """-2 log likelihoods (P,) of pairs."""
    rows, columns, square = pairs
    both = (
        square / terms.variance.take(rows, axis=1)
        + terms.place_term.take(rows, axis=1)
        + terms.price
    )
    if p.size:
        change = squares(select(found.log_sizes, columns) - select(tracks.log_sizes, rows))
        both += change / terms.size_variance + terms.size_term
    cost: Floats = np.minimum(*both)
    cost += np.minimum(tracks.unseen[rows] - 1, MAX_COSTLY_FRAMES) * FRAME_COST
    if p.appearance:
        products = select(tracks.descriptors, rows) * select(found.descriptors, columns)
        cost += p.appearance * (1 - products.sum(axis=1))
    return cost
