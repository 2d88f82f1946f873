"""The tracker made for droplets: DeepSORT's skeleton, its constants in diameters and frames.

Each stage is a function in a module of its own. It takes what it needs, tracks among it, and gives
new tracks; it writes into nothing that it takes.
"""

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.droplet.confirmation import MAX_FRAMES_OF_NEW, confirm, terminate
from droptrack.tracking.droplet.correction import correct
from droptrack.tracking.droplet.duplicates import find_duplicates
from droptrack.tracking.droplet.matching import Matches, match
from droptrack.tracking.droplet.merging import merge
from droptrack.tracking.droplet.noise import FalseBoxes, Noise
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.prediction import predict
from droptrack.tracking.droplet.tracks import Observations, Tracks, observe, start_tracks
from droptrack.tracking.tracker import Update, check_descriptors


class DropletTracker:
    """Tracks droplets; call `update` with each frame's detections, also when there are none.

    >>> tracker = DropletTracker(DropletParameters())
    >>> box = np.array([[50.0, 40, 20, 20]])
    >>> for _ in range(3):
    ...     update = tracker.update(box, np.zeros((1, 0)))
    >>> update.track_ids, update.confirmed
    (array([1]), (1,))
    """

    def __init__(self, parameters: DropletParameters) -> None:
        p = self.parameters = parameters
        self.noise = Noise(centre=p.noise, acceleration=p.acceleration, size=p.size_noise)
        none = observe(np.zeros((0, 4)), np.zeros((0, 0)))
        self.false_boxes = FalseBoxes()
        self.tracks = start_tracks(none, np.zeros(0, np.int64), 1, self.noise, p.unknown_step)
        self._next_id = 1

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

    def update(self, boxes: Floats, descriptors: Floats) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D)."""
        check_descriptors(boxes, descriptors)
        p, noise = self.parameters, self.noise
        found = observe(boxes, descriptors if p.appearance else np.zeros((len(boxes), 0)))
        tracks = predict(self.tracks, boxes, noise, p)
        matches = match(tracks, found, noise, self.false_boxes, p)
        duplicate_of = find_duplicates(tracks, boxes, matches, p)
        tracks, noise = correct(tracks, found, matches, noise, p)
        tracks, track_ids = self._start(tracks, found, matches, duplicate_of, noise)
        tracks, merged = merge(tracks, noise, p)
        tracks, confirmed = confirm(tracks, p)
        tracks, self.false_boxes, terminated = terminate(tracks, self.false_boxes, p)
        self.tracks, self.noise = tracks, noise
        for new, old in merged:
            track_ids[track_ids == new] = old
        return Update(
            track_ids=track_ids, confirmed=confirmed, terminated=terminated, merged=merged
        )

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
