"""Boxes that no track takes on droplets that have one: networks give two to a bent droplet."""

import numpy as np
from scipy.spatial import cKDTree

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import intersections
from droptrack.tracking.droplet.matching import Matches
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.nearest import nearest

NEAREST = 4  # droplets on which a box may lie
MIN_COVERED = 0.4  # share of the smaller of a box and a droplet, for the one to lie on the other
MAX_HALVES_AREA = 1.5  # of two boxes of one droplet together, in areas of its box before
MAX_DUPLICATE_FRAMES = 15  # after which a duplicate is a droplet of its own


def find_duplicates(tracks: Tracks, boxes: Floats, matches: Matches, p: DropletParameters) -> Rows:
    """The track (F,) on whose droplet each free box of the frame's boxes (M, 4) lies, or 0.

    Either the box covers the place where a droplet is predicted, or it lies beside the box that a
    droplet has and both are together no larger than it was: half a droplet.
    """
    none = np.zeros(len(matches.free), np.int64)
    if not len(none) or not p.duplicates:
        return none
    droplets = np.flatnonzero(tracks.confirmed & (tracks.missed <= p.short_gap + 1))
    if not len(droplets):
        return none
    free = boxes[matches.free]
    k = min(NEAREST, len(droplets))
    _, near = nearest(cKDTree(tracks.state.position[droplets]), free[:, :2], k)
    near = droplets[near]  # (F, k)
    lies = _covers(free, tracks, near) | _is_half(free, boxes, matches, tracks, near)
    droplet = tracks.ids[near[np.arange(len(free)), lies.argmax(axis=1)]]
    return np.where(lies.any(axis=1), droplet, 0)


def _covers(free: Floats, tracks: Tracks, near: Rows) -> Bools:
    """Whether free boxes (F, 4) cover the places of tracks (F, k), or are covered by them."""
    size = np.exp(tracks.log_sizes[near])
    predicted = np.concatenate([tracks.state.position[near], size], axis=2)
    smaller = np.minimum(size.prod(axis=2), _areas(free))
    return np.asarray(intersections(predicted, free[:, None]) > MIN_COVERED * smaller)


def _is_half(free: Floats, boxes: Floats, matches: Matches, tracks: Tracks, near: Rows) -> Bools:
    """Whether free boxes (F, 4) may be halves of the droplets of tracks (F, k)."""
    given = np.full((len(tracks), 4), np.inf)  # boxes of this frame
    given[matches.rows] = boxes[matches.columns]
    other, area_before = given[near], np.exp(tracks.log_area[near])
    dx, dy = other[..., 0] - free[:, :1], other[..., 1] - free[:, 1:2]
    beside = np.hypot(dx, dy) < np.sqrt(area_before)
    area = other[..., 2:].prod(axis=2) + _areas(free)
    return np.asarray(beside & (area < MAX_HALVES_AREA * area_before))


def _areas(free: Floats) -> Floats:
    """Of boxes (F, 4): (F, 1)."""
    return np.asarray(free[:, None, 2:].prod(axis=2))
