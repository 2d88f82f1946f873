"""Boxes that no track takes on droplets that have one: networks give two to a bent droplet."""

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import intersections
from droptrack.tracking.droplet.matching import Matches
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.nearest import nearest, tree_of

NEAREST = 4  # droplets on which a box may lie
MIN_COVERED = 0.4  # share of the smaller of a box and a droplet, for the one to lie on the other
MAX_HALVES_AREA = 1.5  # of two boxes of one droplet together, in areas of its box before
MAX_NOISE = 0.08  # of boxes' centres, diameters; beyond, the boxes of neighbours lie on each other
MAX_DUPLICATE_FRAMES = 15  # after which a duplicate is a droplet of its own


def find_duplicates(
    tracks: Tracks, boxes: Floats, matches: Matches, noise: Noise, p: DropletParameters
) -> Rows:
    """The track (F,) on whose droplet each free box of the frame's boxes (M, 4) lies, or 0.

    Either the box covers the place where a droplet is predicted, or it lies beside the box that a
    droplet has and both are together no larger than it was: half a droplet. Where boxes are far
    off, that tells nothing.
    """
    none = np.zeros(len(matches.free), np.int64)
    if not len(none) or not p.duplicates or noise.centre > MAX_NOISE:
        return none
    droplets = np.flatnonzero(tracks.confirmed & (tracks.missed <= p.short_gap + 1))
    if not len(droplets):
        return none
    free = boxes[matches.free]
    k = min(NEAREST, len(droplets))
    _, near = nearest(tree_of(tracks.state.position[droplets]), free[:, :2], k)
    near = droplets[near]  # (F, k)
    area = _area_with_other_half(free, boxes, matches, tracks, near)
    half = area < MAX_HALVES_AREA
    lies = _covers(free, tracks, near) | half
    # the droplet of which it is a half, else the nearest
    best = np.where(half.any(axis=1), area.argmin(axis=1), lies.argmax(axis=1))
    return np.where(lies.any(axis=1), tracks.ids[near[np.arange(len(free)), best]], 0)


def _covers(free: Floats, tracks: Tracks, near: Rows) -> Bools:
    """Whether free boxes (F, 4) cover the places of tracks (F, k), or are covered by them."""
    size = np.exp(tracks.log_sizes[near])
    predicted = np.concatenate([tracks.state.position[near], size], axis=2)
    smaller = np.minimum(size.prod(axis=2), _areas(free))
    return np.asarray(intersections(predicted, free[:, None]) > MIN_COVERED * smaller)


def _area_with_other_half(
    free: Floats, boxes: Floats, matches: Matches, tracks: Tracks, near: Rows
) -> Floats:
    """Area (F, k) of free boxes and the boxes beside them that droplets have, in areas of before.

    Infinite where a droplet has no box, or another place.
    """
    given = np.full((len(tracks), 4), np.inf)  # boxes of this frame
    given[matches.rows] = boxes[matches.columns]
    other, area_before = given[near], np.exp(tracks.log_area[near])
    dx, dy = other[..., 0] - free[:, :1], other[..., 1] - free[:, 1:2]
    beside = np.hypot(dx, dy) < np.sqrt(area_before)
    area = other[..., 2:].prod(axis=2) + _areas(free)
    return np.where(beside, area / area_before, np.inf)


def _areas(free: Floats) -> Floats:
    """Of boxes (F, 4): (F, 1)."""
    return np.asarray(free[:, None, 2:].prod(axis=2))
