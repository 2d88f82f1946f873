"""Which tracks are confirmed as droplets, and which are terminated."""

import numpy as np

from droptrack.data.arrays import Bools
from droptrack.tracking.droplet.duplicates import MAX_DUPLICATE_FRAMES
from droptrack.tracking.droplet.noise import FalseBoxes, median
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracks import Tracks

MIN_EVIDENCE = 25.0  # 2 log likelihood ratio of a droplet
MIN_DETECTION_RATE = 0.6  # detections a frame of a new track
MAX_MISSES_OF_NEW = 1  # in a row
MAX_FRAMES_OF_NEW = MAX_DUPLICATE_FRAMES + 1
MIN_AREA = 1.0  # squared diameters over which false boxes are counted


def confirmable(tracks: Tracks, p: DropletParameters) -> Bools:
    """New tracks (N,) that have been seen often enough, in this frame too."""
    often = (tracks.hits >= p.n_init) & (tracks.hits >= MIN_DETECTION_RATE * tracks.frames)
    often &= tracks.evidence >= MIN_EVIDENCE
    return np.asarray(~tracks.confirmed & (tracks.missed == 0) & often)


def confirm(tracks: Tracks, p: DropletParameters) -> tuple[Tracks, tuple[int, ...]]:
    """Confirm new tracks; duplicates of a living one wait. Also gives the identities of the new."""
    if tracks.confirmed.all():
        return tracks, ()
    rows = np.flatnonzero(confirmable(tracks, p))
    if not len(rows):
        return tracks, ()
    alone = ~np.isin(tracks.duplicate_of[rows], tracks.ids)
    rows = rows[alone | (tracks.frames[rows] >= MAX_DUPLICATE_FRAMES)]
    confirmed = tracks.confirmed.copy()
    confirmed[rows] = True
    return tracks.replaced(confirmed=confirmed), tuple(tracks.ids[rows].tolist())


def terminate(
    tracks: Tracks, false: FalseBoxes, p: DropletParameters
) -> tuple[Tracks, FalseBoxes, tuple[int, ...]]:
    """The tracks that live on, the density of false boxes, and the identities of those that do not.

    A new track is terminated by its second miss in a row, and if nothing confirms it for long: then
    its boxes were false. A confirmed one is terminated by more than `max_age` misses.
    """
    new = ~tracks.confirmed
    unconfirmed = (tracks.missed > MAX_MISSES_OF_NEW) | (tracks.frames > MAX_FRAMES_OF_NEW)
    unconfirmed &= new
    lost = unconfirmed | (tracks.confirmed & (tracks.missed > p.max_age))
    if p.learn_noise and not new.all():
        false = false.learned(_false_density(tracks, int(unconfirmed.sum())))
    if not lost.any():
        return tracks, false, ()
    return tracks[np.flatnonzero(~lost)], false, tuple(tracks.ids[lost].tolist())


def _false_density(tracks: Tracks, n_false: int) -> float:
    """Of `n_false` boxes, a squared diameter of the area where there are droplets."""
    if not n_false:
        return 0.0
    span = np.ptp(tracks.last_position[tracks.confirmed], axis=0)
    return n_false / max(MIN_AREA, float(span.prod()) / median(tracks.diameters) ** 2)
