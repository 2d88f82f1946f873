"""Which tracks are confirmed as droplets, and which are terminated."""

import numpy as np

from droptrack.data.arrays import Bools, Floats
from droptrack.tracking.droplet.duplicates import MAX_DUPLICATE_FRAMES
from droptrack.tracking.droplet.flow import Flow
from droptrack.tracking.droplet.matching import MIN_EVIDENCE
from droptrack.tracking.droplet.noise import FalseBoxes, Noise, median
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.passages import Passages
from droptrack.tracking.droplet.tracks import Tracks

MIN_DETECTION_RATE = 0.6  # detections a frame of a new track
MAX_MISSES_OF_NEW = 1  # in a row
MAX_FRAMES_OF_NEW = MAX_DUPLICATE_FRAMES + 1
MIN_SUPPORTED_HITS = 2  # detections of a track that is confirmed by what is remembered, too
MIN_EVIDENCE_OF_LEAVING = 14.0  # of a droplet that leaves too early for more: odds of 1,000 to 1
MIN_AREA = 1.0  # squared diameters over which false boxes are counted, where droplets are many


def confirmable(tracks: Tracks, support: Floats, p: DropletParameters) -> Bools:
    """New tracks (N,) that have been seen often enough, in this frame too.

    `support` (N,): of tracks for which `support_of` tells something, else 0.
    """
    if tracks.confirmed.all():
        return np.zeros(len(tracks), bool)
    often = (tracks.hits >= p.n_init) & (tracks.hits >= MIN_DETECTION_RATE * tracks.images)
    often &= tracks.evidence >= MIN_EVIDENCE
    supported = (support > 0) & (tracks.hits >= MIN_SUPPORTED_HITS)
    often |= supported & (tracks.evidence + support >= MIN_EVIDENCE)
    return np.asarray(~tracks.confirmed & (tracks.missed == 0) & often)


def confirm(
    tracks: Tracks, support: Floats, p: DropletParameters
) -> tuple[Tracks, tuple[int, ...]]:
    """Confirm new tracks; duplicates of a living one wait. Also gives the identities of the new."""
    if tracks.confirmed.all():
        return tracks, ()
    rows = np.flatnonzero(confirmable(tracks, support, p))
    if not len(rows):
        return tracks, ()
    alone = ~np.isin(tracks.duplicate_of[rows], tracks.ids)
    rows = rows[alone | (tracks.frames[rows] >= MAX_DUPLICATE_FRAMES)]
    confirmed = tracks.confirmed.copy()
    confirmed[rows] = True
    return tracks.replaced(confirmed=confirmed), tuple(tracks.ids[rows].tolist())


def support_of(
    tracks: Tracks, flow: Flow, passages: Passages, noise: Noise, false: FalseBoxes
) -> Floats:
    """Evidence (N,) that new tracks have besides their detections: 0 of confirmed ones.

    They were born where droplets pass, and are as large as droplets are. Where droplets are many
    nothing is remembered, and there is none.
    """
    support = np.zeros(len(tracks))
    if not flow.images or tracks.confirmed.all():
        return support
    rows = np.flatnonzero(~tracks.confirmed & (tracks.duplicate_of == 0))
    if not len(rows):
        return support
    density = flow.density_at(tracks.first_position[rows], tracks.diameters[rows])
    size = passages.evidence_of_size(tracks.log_sizes[rows], noise.size)
    support[rows] = 2 * np.log(density / false.density) + size
    return support


def unconfirmed(tracks: Tracks, flow: Flow) -> Bools:
    """New tracks (N,) that nothing confirms any more.

    It is their second miss in a row, or they have waited for too long. Those that would be out of
    the region where droplets are seen wait, since more may yet become known of the flow.
    """
    over = _gone(tracks) & ~flow.outside(tracks)
    return np.asarray(~tracks.confirmed & (over | (tracks.frames > MAX_FRAMES_OF_NEW)))


def _gone(tracks: Tracks) -> Bools:
    """New tracks (N,) that were missed more than once in a row."""
    return np.asarray(~tracks.confirmed & (tracks.unseen > MAX_MISSES_OF_NEW))


def leaving(tracks: Tracks, support: Floats, flow: Flow) -> Bools:
    """New tracks (N,) that end because they have left, too early for `n_init` detections.

    They go where the flow takes them, out of the region where droplets are seen.
    """
    over = _gone(tracks)
    if not over.any():
        return over
    sure = tracks.evidence + support >= MIN_EVIDENCE_OF_LEAVING
    return np.asarray(over & sure & (tracks.duplicate_of == 0) & flow.left_by(tracks))


def confirm_leaving(
    tracks: Tracks, support: Floats, flow: Flow, *, ended: bool = False
) -> tuple[Tracks, tuple[int, ...]]:
    """Confirm tracks that have left, or if the video has `ended`, those that may be in view still.

    Also gives their identities.
    """
    left = leaving(tracks, support, flow)
    if ended:
        sure = tracks.evidence + support >= MIN_EVIDENCE_OF_LEAVING
        here = (tracks.unseen == 0) | flow.left_by(tracks)
        left |= ~tracks.confirmed & sure & here & (tracks.duplicate_of == 0)
    rows = np.flatnonzero(left)
    if not len(rows):
        return tracks, ()
    confirmed = tracks.confirmed.copy()
    confirmed[rows] = True
    return tracks.replaced(confirmed=confirmed), tuple(tracks.ids[rows].tolist())


def terminate(
    tracks: Tracks,
    left: tuple[int, ...],
    support: Floats,
    flow: Flow,
    false: FalseBoxes,
    p: DropletParameters,
) -> tuple[Tracks, FalseBoxes, tuple[int, ...]]:
    """The tracks that live on, the density of false boxes, and the identities of those that do not.

    A new track is terminated by its second miss in a row, and if nothing confirms it for long: then
    its boxes were false. A confirmed one is terminated by more than `max_age` misses, and if it is
    among those that `left`.
    """
    new, over = ~tracks.confirmed, unconfirmed(tracks, flow)
    lost = over | (tracks.confirmed & (tracks.missed > p.max_age))
    if left:
        lost |= np.isin(tracks.ids, left)
    if p.learn_noise and not new.all():
        n_false = float(over.sum())
        if over.any() and flow.images:  # what has left, and what is like droplets, may be one
            gone = over & ~flow.left_by(tracks)
            n_false = float((1 / (1 + np.exp(support[gone] / 2))).sum())
        false = false.learned(n_false / _area(tracks, flow) if n_false else 0.0)
    if not lost.any():
        return tracks, false, ()
    return tracks[np.flatnonzero(~lost)], false, tuple(tracks.ids[lost].tolist())


def _area(tracks: Tracks, flow: Flow) -> float:
    """Squared diameters over which false boxes are counted.

    Those of few droplets in a channel may be anywhere in the image; others are among the droplets.
    """
    diameter = median(tracks.diameters)
    if flow.images:
        return flow.area(diameter)
    span = np.ptp(tracks.last_position[tracks.confirmed], axis=0)
    return max(MIN_AREA, float(span.prod()) / diameter**2)
