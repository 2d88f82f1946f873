"""The tracker made for droplets: DeepSORT's skeleton, its constants in diameters and frames.

Each stage is a function in a module of its own. It takes what it needs, tracks among it, and gives
new tracks; it writes into nothing that it takes.
"""

from math import log

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.droplet.confirmation import (
    MAX_FRAMES_OF_NEW,
    confirm,
    confirm_leaving,
    confirmable,
    leaving,
    support_of,
    terminate,
)
from droptrack.tracking.droplet.correction import correct
from droptrack.tracking.droplet.duplicates import find_duplicates
from droptrack.tracking.droplet.flow import Flow
from droptrack.tracking.droplet.matching import Matches, match
from droptrack.tracking.droplet.merging import merge
from droptrack.tracking.droplet.noise import FalseBoxes, Noise, median
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.passages import Passages
from droptrack.tracking.droplet.prediction import predict
from droptrack.tracking.droplet.tracks import Observations, Tracks, observe, start_tracks
from droptrack.tracking.tracker import Update, check_descriptors


class DropletTracker:
    """Tracks droplets; call `update` with each frame's detections, also when there are none.

    >>> tracker = DropletTracker(DropletParameters())
    >>> box = np.array([[50.0, 40, 20, 20]])
    >>> confirmed = set()
    >>> for _ in range(3):
    ...     update = tracker.update(box, np.zeros((1, 0)))
    ...     confirmed.update(update.confirmed)
    >>> update.track_ids, confirmed
    (array([1]), {1})
    """

    def __init__(self, parameters: DropletParameters) -> None:
        p = self.parameters = parameters
        self.noise = Noise(centre=p.noise, acceleration=p.acceleration, size=p.size_noise)
        none = observe(np.zeros((0, 4)), np.zeros((0, 0)))
        self.false_boxes = FalseBoxes()
        self.tracks = start_tracks(none, np.zeros(0, np.int64), 1, self.noise, p.unknown_step)
        self._next_id = 1
        self._n_frames = 0
        self.flow = Flow()
        self.passages = Passages()

    @property
    def max_age(self) -> int:
        """Frames that a droplet may be missed and still be the same."""
        return self.parameters.max_age

    @property
    def n_init(self) -> int:
        """Detections that confirm a track."""
        return self.parameters.n_init

    @property
    def delay(self) -> int:
        """Frames after which a new track is confirmed, merged or terminated."""
        return MAX_FRAMES_OF_NEW

    @property
    def velocity_is_ambiguous(self) -> bool:
        """Whether a second velocity explains the last images as well: see `Flow.common_step`.

        `DropletParameters.expect_velocity` then tells which is right.
        """
        if not len(self.tracks) or self.parameters.expect_velocity is not None:
            return False
        common = self.flow.common_step(median(self.tracks.diameters))
        return common is not None and common.ambiguous

    def update(self, boxes: Floats, descriptors: Floats) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D)."""
        check_descriptors(boxes, descriptors)
        p, noise = self.parameters, self.noise
        found = observe(boxes, descriptors if p.appearance else np.zeros((len(boxes), 0)))
        flow = self.flow.seeing(self._n_frames, boxes[:, :2])
        self._n_frames += 1
        tracks = predict(self.tracks, boxes, noise, flow, p)
        others = self._evidence_of_others(tracks, flow)
        matches = match(tracks, found, noise, self.false_boxes, others, p)
        duplicate_of = find_duplicates(tracks, boxes, matches, p)
        passages = _resumed(self.passages, tracks, matches)
        tracks, noise = correct(tracks, found, matches, noise, p)
        tracks, track_ids = self._start(tracks, found, matches, duplicate_of, noise)
        support = support_of(tracks, flow, passages, noise, self.false_boxes)
        ready = confirmable(tracks, support, p)
        if flow.images:
            ready |= leaving(tracks, support, flow)
        tracks, passages, merged = merge(tracks, ready, noise, passages, p)
        if merged:
            support = support_of(tracks, flow, passages, noise, self.false_boxes)
        tracks, confirmed = confirm(tracks, support, p)
        tracks, left = confirm_leaving(tracks, support, flow)
        passages = _entered(passages, tracks, (*confirmed, *left), self._n_frames)
        before = tracks
        tracks, self.false_boxes, terminated = terminate(
            tracks, left, support, flow, self.false_boxes, p
        )
        if terminated:
            ended = np.flatnonzero(np.isin(before.ids, terminated) & before.confirmed)
            passages = passages.leaving(before[ended])
        self.passages = passages
        self.tracks, self.noise, self.flow = tracks, noise, flow.learned(tracks)
        for new, old in merged:
            track_ids[track_ids == new] = old
        return Update(
            track_ids=track_ids,
            confirmed=(*confirmed, *left),
            terminated=terminated,
            merged=merged,
        )

    def _evidence_of_others(self, tracks: Tracks, flow: Flow) -> float:
        """2 log likelihood ratio of a detection of another droplet to a false box."""
        if not flow.images or not len(tracks):
            return 0.0
        density = flow.density(median(tracks.diameters)) / self.false_boxes.density
        size = self.passages.evidence_of_mean_size(self.noise.size)
        return max(2 * log(density) + size, 0.0)

    def _start(
        self,
        tracks: Tracks,
        found: Observations,
        matches: Matches,
        duplicate_of: Rows,
        noise: Noise,
    ) -> tuple[Tracks, Rows]:
        """All tracks with new ones for the free detections, and the track of each detection."""
        track_ids = np.zeros(len(found), np.int64)
        track_ids[matches.columns] = tracks.ids[matches.rows]
        if not len(matches.free):
            return tracks, track_ids
        step = self.parameters.unknown_step
        new = start_tracks(found[matches.free], duplicate_of, self._next_id, noise, step)
        track_ids[matches.free] = new.ids
        self._next_id += len(new)
        return tracks.followed_by(new), track_ids


def _resumed(passages: Passages, tracks: Tracks, matches: Matches) -> Passages:
    """With this image, and the lost droplets that are seen again in it."""
    passages = passages.with_image()
    late = tracks.unseen > 1
    if not late.any():
        return passages
    rows = matches.rows[tracks.confirmed[matches.rows]]
    passages, again = passages.seeing(tracks.last_position[rows]), rows[late[rows]]
    if not len(again):
        return passages
    return passages.resuming(tracks.last_position[again], tracks.unseen[again] - 1)


def _entered(
    passages: Passages, tracks: Tracks, confirmed: tuple[int, ...], n_frames: int
) -> Passages:
    """With those droplets, confirmed just now; some were there from the first frame on."""
    if not confirmed:
        return passages
    new = tracks[np.flatnonzero(np.isin(tracks.ids, confirmed))]
    return passages.entering(new, new.frames < n_frames)
