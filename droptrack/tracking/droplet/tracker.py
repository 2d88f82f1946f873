"""The tracker made for droplets: DeepSORT's skeleton, its constants in diameters and frames.

Each stage is a function in a module of its own. It takes what it needs, tracks among it, and gives
new tracks; it writes into nothing that it takes.
"""

from collections import deque
from dataclasses import replace
from math import log

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.droplet.beginning import MAX_FRAMES as MAX_BEGINNING
from droptrack.tracking.droplet.beginning import FrameInput, other_velocity
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
from droptrack.tracking.droplet.flow import Flow, WeighedVelocities
from droptrack.tracking.droplet.matching import Matches, match
from droptrack.tracking.droplet.merging import merge
from droptrack.tracking.droplet.noise import FalseBoxes, Noise, median
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.passages import Passages
from droptrack.tracking.droplet.prediction import predict
from droptrack.tracking.droplet.resumption import resumptions
from droptrack.tracking.droplet.tracks import Observations, Tracks, observe, start_tracks
from droptrack.tracking.droplet.unseen import unseen_of
from droptrack.tracking.tracker import (
    LONG_GAP,
    Resumption,
    Unseen,
    Update,
    Velocity,
    check_descriptors,
)

FRAMES_TO_WEIGH = 60  # after which is asked again whether another velocity explains the images
FRAMES_TO_ENTER = 20  # since birth, after which is told whether a droplet was in view before


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
        self.parameters = parameters
        self._beginning: list[FrameInput] | None = []  # the first frames
        self._begin(0)

    def _begin(self, n_frames: int) -> None:
        """Know nothing, before the first box comes after so many frames."""
        p = self.parameters
        self.noise = Noise(centre=p.noise, acceleration=p.acceleration, size=p.size_noise)
        none = observe(np.zeros((0, 4)), np.zeros((0, 0)))
        self.false_boxes = FalseBoxes()
        self.tracks = start_tracks(none, np.zeros(0, np.int64), 1, self.noise, p.unknown_step)
        self._next_id = 1
        self._n_frames = n_frames
        self.flow = Flow()
        self.passages = Passages()
        self._images: deque[bool] = deque(maxlen=self.delay + p.max_age + 1)
        self._weighed = WeighedVelocities()

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
        """Frames after which a new track is confirmed, merged or terminated, and the first ones."""
        return max(MAX_FRAMES_OF_NEW, MAX_BEGINNING)

    @property
    def possible_velocities(self) -> tuple[Velocity, ...]:
        """Two that explain the images alike: see `Flow.common_step`; none if one does.

        Then only `DropletParameters.expect_velocity` can tell which is right.
        """
        weighed = self._weighed
        if len(self.tracks) and self.parameters.expect_velocity is None:
            weighed = weighed.of(self.flow, median(self.tracks.diameters))
        return weighed.possible

    @property
    def velocity_is_ambiguous(self) -> bool:
        """Whether there are `possible_velocities`."""
        return bool(self.possible_velocities)

    def update(self, boxes: Floats, descriptors: Floats, *, image: bool | None = None) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D).

        `image`: whether there is one in which droplets can be missed; if nobody knows, it is there
        if any box is.
        """
        check_descriptors(boxes, descriptors)
        frame = FrameInput(boxes, descriptors, len(boxes) > 0 if image is None else image)
        again = self._again(boxes)
        if not again and self._beginning and len(self._beginning) == MAX_BEGINNING:
            again = self._again_with_flow()
        update = self._update(frame, self.parameters)
        if self._beginning is not None and (len(boxes) or self._beginning):
            over = not self.flow.images or len(self._beginning) == MAX_BEGINNING
            self._beginning = None if over else [*self._beginning, frame]
        return replace(update, again=again) if again else update

    def finish(self) -> Update:
        """What is known once the last frame has been seen; it has no detections.

        Where droplets are few, no further box can come of those that are new, as of those that
        leave.
        """
        again = self._again_with_flow() if self._beginning else ()
        tracks, flow = self.tracks, self.flow
        if not flow.images or not len(tracks):
            return Update(track_ids=np.zeros(0, np.int64), again=again)
        support = support_of(tracks, flow, self.passages, self.noise, self.false_boxes)
        tracks, confirmed = confirm_leaving(tracks, support, flow, ended=True)
        ends = np.flatnonzero(tracks.confirmed & (tracks.unseen > 0))
        young = np.flatnonzero(tracks.confirmed & (tracks.frames < FRAMES_TO_ENTER))
        unseen = self._unseen(tracks, ends, young, flow)
        none = np.zeros(0, np.int64)
        return Update(track_ids=none, confirmed=confirmed, unseen=unseen, again=again)

    def _unseen(self, tracks: Tracks, ended: Rows, young: Rows, flow: Flow) -> tuple[Unseen, ...]:
        """In which frames droplets were in view unseen: after they ended, and before they began."""
        ends = [(row, int(tracks.missed[row]), 1) for row in ended.tolist()]
        ends += [(row, int(tracks.frames[row]) - 1, -1) for row in young.tolist()]
        if not ends:
            return ()
        images = list(self._images)
        return tuple(unseen_of(tracks, ends, images, flow, self.passages, self.noise))

    def _again_with_flow(self) -> tuple[Update, ...]:
        """Track the first frames again with what they told of the flow, if droplets are few."""
        p, frames = self.parameters, self._beginning
        if not frames or not p.flow or not self.flow.images or not len(self.flow.positions):
            return ()
        flow, sizes = self.flow.without_images(), self.passages.sizes
        noise, false_boxes = self.noise, self.false_boxes
        self._begin(self._n_frames - len(frames))
        self.flow, self.passages = flow, replace(self.passages, sizes=sizes)
        self.noise, self.false_boxes = noise, false_boxes
        return tuple(self._update(frame, p, flow_known=True) for frame in frames)

    def _again(self, boxes: Floats) -> tuple[Update, ...]:
        """Track the first frames again if with this one they tell another velocity."""
        p, frames = self.parameters, self._beginning
        if not frames or p.expect_velocity is not None or not p.flow:
            return ()
        velocity = other_velocity(self.tracks, self.flow.seeing(self._n_frames, boxes[:, :2]))
        if velocity is None:
            return ()
        self._begin(self._n_frames - len(frames))
        return tuple(self._update(frame, replace(p, expect_velocity=velocity)) for frame in frames)

    def _update(
        self, frame: FrameInput, p: DropletParameters, *, flow_known: bool = False
    ) -> Update:
        boxes, descriptors, image = frame
        noise = self.noise
        found = observe(boxes, descriptors if p.appearance else np.zeros((len(boxes), 0)))
        flow = self.flow.seeing(self._n_frames, boxes[:, :2])
        self._n_frames += 1
        self._images.append(image)
        tracks = predict(self.tracks, boxes, noise, flow, p, image=image, flow_known=flow_known)
        others = self._evidence_of_others(tracks, flow)
        matches = match(tracks, found, noise, self.false_boxes, others, p)
        duplicate_of = find_duplicates(tracks, boxes, matches, noise, p)
        passages = _resumed(self.passages, tracks, matches)
        resumed = _after_gaps(tracks, found, matches, flow)
        flow = flow.surprised(_first_steps(tracks, found, matches))
        tracks, noise = correct(tracks, found, matches, noise, p)
        tracks, track_ids = self._start(tracks, found, matches, duplicate_of, noise)
        support = support_of(tracks, flow, passages, noise, self.false_boxes)
        ready = confirmable(tracks, support, p)
        if flow.images:
            ready |= leaving(tracks, support, flow)
        tracks, passages, merged = merge(tracks, ready, noise, passages, flow, p)
        if merged.pairs:
            support = support_of(tracks, flow, passages, noise, self.false_boxes)
        tracks, confirmed = confirm(tracks, support, p)
        tracks, left = confirm_leaving(tracks, support, flow)
        passages = _entered(passages, tracks, (*confirmed, *left), self._n_frames)
        before = tracks
        tracks, self.false_boxes, terminated = terminate(
            tracks, left, support, flow, self.false_boxes, p
        )
        ended = np.zeros(0, np.int64)
        if terminated:
            ended = np.flatnonzero(np.isin(before.ids, terminated) & before.confirmed)
            passages = passages.leaving(before[ended])
        self.passages = passages
        unseen: tuple[Unseen, ...] = ()
        if flow.images:
            known = before.confirmed & (before.frames == FRAMES_TO_ENTER)
            known[ended] |= before.frames[ended] < FRAMES_TO_ENTER
            unseen = self._unseen(before, ended, np.flatnonzero(known), flow)
        if flow.images and self._n_frames % FRAMES_TO_WEIGH == 0 and len(tracks):
            self._weighed = self._weighed.of(flow, median(tracks.diameters))
        self.tracks, self.noise, self.flow = tracks, noise, flow.learned(tracks, confirmed)
        for new, old in merged.pairs:
            track_ids[track_ids == new] = old
        return Update(
            track_ids=track_ids,
            confirmed=(*confirmed, *left),
            terminated=terminated,
            merged=merged.pairs,
            resumed=(*resumed, *merged.resumed),
            unseen=unseen,
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


def _first_steps(tracks: Tracks, found: Observations, matches: Matches) -> Floats:
    """How far off the first steps (K, 2) of new tracks were, diameters a frame.

    Of those of which something was known: others were expected at rest.
    """
    told = tracks.state.velocity[matches.rows].any(axis=1)
    new = np.flatnonzero(told & (tracks.hits[matches.rows] == 1))
    if not len(new):
        return np.zeros((0, 2))
    rows, columns = matches.rows[new], matches.columns[new]
    off = found.boxes[columns, :2] - tracks.state.position[rows]
    return np.asarray(off / (tracks.missed[rows] * tracks.diameters[rows])[:, None])


def _after_gaps(
    tracks: Tracks, found: Observations, matches: Matches, flow: Flow
) -> tuple[Resumption, ...]:
    """Confirmed tracks that one detection finds again after a long gap."""
    frames = tracks.missed[matches.rows] - 1
    late = np.flatnonzero((frames > LONG_GAP) & tracks.confirmed[matches.rows])
    if not len(late):
        return ()
    ends = found.boxes[matches.columns[late], :2]
    return resumptions(
        tracks, matches.rows[late], ends, frames[late], matches.evidence[late] / 2, flow
    )


def _resumed(passages: Passages, tracks: Tracks, matches: Matches) -> Passages:
    """With this image, and the lost droplets that are seen again in it."""
    passages = passages.with_image(int(np.count_nonzero(tracks.confirmed[matches.rows])))
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
