"""Which of the boxes that a network sees are droplets, without anybody saying so.

In a video, those whose tracks are long and steady: seen before and after, in a size that stays. A
droplet that was missed between is one, too. In images that have nothing to do with one another,
those that every look shows (`looking`). What is neither trusted nor plainly nothing is doubtful:
it must teach nothing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from droptrack.adaptation.footage import Footage, LabelledShot, Shot
from droptrack.adaptation.looking import Looks, covered, cut_by_edge, seen_in_all
from droptrack.data.arrays import Bools, Floats
from droptrack.data.detections import Detections, intersections
from droptrack.data.trajectories import Trajectories
from droptrack.detection.scale_choice import typical_diameter
from droptrack.tracking.choice import TrackerConfig, choose_descriptor, make_tracker
from droptrack.tracking.recorder import concatenated
from droptrack.tracking.session import TrackingSession

TRACKED_SCORE = 0.15  # of a detection that may belong to a track
MIN_OBSERVED = 4  # of a track
MIN_TRACK_SCORE = 0.3  # mean, of a track
STEADY = 0.15  # typical deviation of a droplet's size from its median, as a share of it
MAX_DEVIATION = 0.3  # in one frame
MAX_BRIDGED = 3  # frames one after the other in which a droplet was missed
SURE_SCORE = 0.5  # of a droplet in an image that has no neighbours
SURE_SHARE = 0.8  # of the looks
DOUBT_SCORE = 0.1  # of what may be a droplet
STILL = 0.1  # of its size: as far as a thing at rest may seem to go
MIN_TRACKED = 0.4  # share of the droplets that have tracks, in a video
INSIDE, LARGER, SURER = 0.8, 4.0, 0.15  # share of a box's area; times its area; of its score
COVERED = 0.5  # share of a doubtful box that trusted ones explain
MUCH_SMALLER, SMALLER, FEW = 0.4, 0.5, 0.1  # times most of their diameters; share of the droplets


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What is known of an image: boxes (N, 4) px of droplets, and of what may be one.

    `whole` (N,): which of the droplets no edge cuts. `labelled`: a user said so.
    """

    shot: Shot
    trusted: Floats
    doubtful: Floats
    labelled: bool = False

    @property
    def whole(self) -> Bools:
        """Which of the droplets no edge cuts."""
        return ~cut_by_edge(self.trusted, self.shot.size)


@dataclass(frozen=True, kw_only=True)
class Trust:
    """What is known of all images to learn from, and whether tracks or looks say it."""

    seen: tuple[Seen, ...]
    by_tracks: bool
    n_tracks: int

    @property
    def n_droplets(self) -> int:
        """Droplets in all images."""
        return sum(len(one.trusted) for one in self.seen)


def trust(footage: Footage, looks: Looks, progress: Iterable[Shot]) -> Trust:
    """What is trusted in the images to learn from; `progress` yields them, one after the other."""
    found = {id(shot): seen_in_all(looks, shot) for shot in progress}
    if footage.moving:
        by_tracks = _trust_tracks(
            [[(shot, found[id(shot)][0]) for shot in stretch] for stretch in footage.stretches]
        )
        n_sure = sum(int((one.scores >= SURE_SCORE).sum()) for one, _ in found.values())
        if by_tracks.n_droplets >= MIN_TRACKED * n_sure and by_tracks.n_droplets:
            return replace(by_tracks, seen=tuple(_few_small_ones_doubted(by_tracks.seen)))
    seen = [_trust_looks(shot, *found[id(shot)]) for shot in footage.used]
    return Trust(seen=tuple(_few_small_ones_doubted(seen)), by_tracks=False, n_tracks=0)


def of_labels(labelled: Sequence[LabelledShot]) -> list[Seen]:
    """What a user said of images: nothing in them is doubtful."""
    return [
        Seen(shot=one.shot, trusted=one.truth.boxes, doubtful=one.truth.boxes[:0], labelled=True)
        for one in labelled
    ]


def _trust_looks(shot: Shot, found: Detections, shares: Floats) -> Seen:
    sure = (found.scores >= SURE_SCORE) & (shares >= SURE_SHARE)
    rest = found[np.flatnonzero(~sure)]
    return _seen(shot, found.boxes[sure], found.scores[sure], rest)


def _seen(shot: Shot, trusted: Floats, scores: Floats, others: Detections) -> Seen:
    """`others` are doubtful, but for what the trusted ones explain, or what is hardly anything.

    Trusted ones of lower scores (N,) in much larger ones are cells or reflections: nothing.
    """
    trusted = trusted[~_inside_others(trusted, scores)]
    doubtful = others.boxes[others.scores >= DOUBT_SCORE]
    return Seen(
        shot=shot,
        trusted=trusted,
        doubtful=doubtful[covered(doubtful, trusted) < COVERED],
    )


def _few_small_ones_doubted(seen: Sequence[Seen]) -> list[Seen]:
    """Droplets much smaller than most in their image are doubtful where they are few in all.

    And none is of a size between. They may be cells or beads beside the droplets, which look like
    small ones. Where there are many, or some of any size, the droplets' sizes differ.
    """
    sizes = [_relative_sizes(one) for one in seen]
    whole = np.concatenate([np.zeros(0), *(of[~np.isnan(of)] for of in sizes)])
    n_small, n_smaller = ((whole < limit).sum() for limit in (MUCH_SMALLER, SMALLER))
    if n_small < n_smaller or n_small > FEW * len(whole):
        return list(seen)
    return [
        replace(
            one,
            trusted=one.trusted[~(of < MUCH_SMALLER)],
            doubtful=np.concatenate([one.doubtful, one.trusted[of < MUCH_SMALLER]]),
        )
        for one, of in zip(seen, sizes, strict=True)
    ]


def _relative_sizes(one: Seen) -> Floats:
    """The diameters (N,) of an image's droplets, most of them 1; NaN of those an edge cuts."""
    diameters = np.where(one.whole, np.sqrt(one.trusted[:, 2:].prod(axis=1)), np.nan)
    return np.asarray(diameters / (typical_diameter(diameters[one.whole]) or np.nan))


def _inside_others(boxes: Floats, scores: Floats) -> Bools:
    """Which boxes (N, 4) lie in a much larger one that is surer by far."""
    areas = boxes[:, 2:].prod(axis=1)
    shared = intersections(boxes[:, None], boxes[None]) / areas[:, None]
    larger = areas[None] > LARGER * areas[:, None]
    surer = scores[None] > scores[:, None] + SURER
    return np.asarray(((shared > INSIDE) & larger & surer).any(axis=1), bool)


def track(numbered: Iterable[tuple[int, Detections]], *, n_init: int | None = None) -> Trajectories:
    """The tracks of detections, frame by frame; `n_init`: detections that confirm a track."""
    config = TrackerConfig(n_init=n_init)
    session = TrackingSession(make_tracker(config)[0])
    nothing = choose_descriptor(config)
    parts = []
    for number, found in numbered:
        blank = np.zeros((1, 1, 3), np.uint8)
        parts.append(session.add_boxes(number, found, nothing(blank, found.boxes)))
    parts.append(session.finish())
    return concatenated(parts).rows


def _trust_tracks(stretches: Sequence[Sequence[tuple[Shot, Detections]]]) -> Trust:
    seen: list[Seen] = []
    n_tracks = 0
    for stretch in stretches:
        rows = track(
            (shot.number, found[np.flatnonzero(found.scores >= TRACKED_SCORE)])
            for shot, found in stretch
        )
        good, n_good = _steady(rows, stretch[0][0].size)
        n_tracks += n_good
        for shot, found in stretch:
            mine = good & (rows.frame == shot.number)
            boxes, scores = rows.boxes[mine], rows.scores[mine]
            seen.append(_seen(shot, boxes, scores, found))
    return Trust(seen=tuple(seen), by_tracks=True, n_tracks=n_tracks)


def _steady(rows: Trajectories, size: tuple[int, int]) -> tuple[Bools, int]:
    """Which rows (M,) belong to long and steady tracks, and how many tracks these are.

    Where most such tracks move, those at rest are left out: they may be dirt.
    """
    good = np.zeros(len(rows), bool)
    cut = cut_by_edge(rows.boxes, size)
    sizes = np.sqrt(rows.boxes[:, 2:].prod(axis=1))
    moved: dict[int, float] = {}
    for track_id in np.unique(rows.track_id).tolist():
        mine = np.flatnonzero(rows.track_id == track_id)
        observed = mine[rows.observed[mine]]
        whole = observed[~cut[observed]]
        if len(observed) < MIN_OBSERVED or len(whole) < MIN_OBSERVED // 2:
            continue
        if rows.scores[observed].mean() < MIN_TRACK_SCORE:
            continue
        typical = float(np.median(sizes[whole]))
        deviation = np.abs(sizes / typical - 1)
        if np.median(deviation[whole]) > STEADY:
            continue
        kept = (deviation[mine] <= MAX_DEVIATION) | cut[mine]
        good[mine] = kept & (rows.observed[mine] | _short_gaps(rows.observed[mine]))
        middle = np.column_stack([rows.x[mine], rows.y[mine]])
        moved[track_id] = float(np.ptp(middle, axis=0).max()) / typical
    at_rest = [track_id for track_id, way in moved.items() if way < STILL]
    if 0 < len(at_rest) < len(moved) / 2:
        good &= ~np.isin(rows.track_id, at_rest)
        moved = {track_id: way for track_id, way in moved.items() if way >= STILL}
    return good, len(moved)


def _short_gaps(observed: Bools) -> Bools:
    """Which frames (N,) of a track are missed ones, few enough between two that are not."""
    short = np.zeros(len(observed), bool)
    seen = np.flatnonzero(observed)
    for start, end in zip(seen[:-1].tolist(), seen[1:].tolist(), strict=True):
        if end - start - 1 <= MAX_BRIDGED:
            short[start + 1 : end] = True
    return short
