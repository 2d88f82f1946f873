"""DeepSORT (Wojke et al. 2017): detections, frame by frame -> tracks with lasting identities."""

from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.data.detections import iou_of_pairs
from droptrack.data.neighbours import pairs_within
from droptrack.tracking.association import assign_sparse
from droptrack.tracking.deepsort import kalman
from droptrack.tracking.deepsort.matching import COST_STEP, cosine_distances, matching_cascade
from droptrack.tracking.nearest import ROUNDING
from droptrack.tracking.tracker import Update, Velocity, check_descriptors


@dataclass(frozen=True, kw_only=True)
class DeepSortParameters:
    """DeepSORT's parameters by the names of the original, with its defaults."""

    max_cosine_distance: float = 0.2
    nn_budget: int = 100  # descriptors kept a track
    max_iou_distance: float = 0.7
    max_age: int = 30  # frames that a confirmed track may be missed
    n_init: int = 3  # detections in a row that confirm a track


@dataclass(kw_only=True)
class _Track:
    """The track of one droplet, without its filter's state."""

    track_id: int
    hits: int = 1
    age: int = 0  # frames since it was seen
    confirmed: bool
    gallery: list[Floats]


class DeepSortTracker:
    """Tracks droplets; call `update` with each frame's detections, also when there are none."""

    def __init__(self, parameters: DeepSortParameters) -> None:
        self.parameters = parameters
        self.tracks: list[_Track] = []
        self.mean = np.zeros((0, 4, 2))
        self.covariance = np.zeros((0, 4, 2, 2))
        self._next_id = 1
        self.max_age = parameters.max_age
        self.delay = parameters.n_init - 1
        self.n_init = parameters.n_init

    @property
    def possible_velocities(self) -> tuple[Velocity, ...]:
        """None: DeepSORT does not ask."""
        return ()

    def update(self, boxes: Floats, descriptors: Floats, *, image: bool | None = None) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D).

        A frame without an `image` is one without detections, as in the original.
        """
        del image
        check_descriptors(boxes, descriptors)
        self.mean, self.covariance = kalman.predict(self.mean, self.covariance)
        for track in self.tracks:
            track.age += 1
        measurements = kalman.measurements_of(boxes)
        rows, columns = self._match(boxes, measurements, descriptors)
        self.mean[rows], self.covariance[rows] = kalman.update(
            self.mean[rows], self.covariance[rows], measurements[columns]
        )
        track_ids = np.zeros(len(boxes), np.int64)
        confirmed = []
        for row, column in zip(rows, columns, strict=True):
            track = self.tracks[row]
            track.hits, track.age = track.hits + 1, 0
            track.gallery.append(descriptors[column])
            track_ids[column] = track.track_id
            if not track.confirmed and track.hits >= self.parameters.n_init:
                track.confirmed = True
                confirmed.append(track.track_id)
        terminated = self._terminate()
        free = np.flatnonzero(track_ids == 0)
        track_ids[free] = self._start(measurements[free], descriptors[free])
        if self.parameters.n_init <= 1:
            confirmed += track_ids[free].tolist()
        for track in self.tracks:
            del track.gallery[: -self.parameters.nn_budget if track.confirmed else 0]
        return Update(track_ids=track_ids, confirmed=tuple(confirmed), terminated=terminated)

    def finish(self) -> Update:
        """Nothing: what is not confirmed by the last frame never was in the original."""
        return Update(track_ids=np.zeros(0, np.int64))

    def _match(self, boxes: Floats, measurements: Floats, descriptors: Floats) -> tuple[Rows, Rows]:
        """The cascade for confirmed tracks, then IoU for new ones and those just missed."""
        ages = np.array([track.age for track in self.tracks], np.int64)
        confirmed = np.array([track.confirmed for track in self.tracks], bool)
        rows, columns = self._match_by_appearance(
            np.flatnonzero(confirmed), ages, measurements, descriptors
        )
        rest = np.setdiff1d(np.flatnonzero(~confirmed | (ages == 1)), rows)
        free = np.setdiff1d(np.arange(len(boxes)), columns)
        more_rows, more_columns = self._match_by_iou(rest, boxes[free])
        return np.append(rows, rest[more_rows]), np.append(columns, free[more_columns])

    def _match_by_appearance(
        self, candidates: Rows, ages: Rows, measurements: Floats, descriptors: Floats
    ) -> tuple[Rows, Rows]:
        """Matched tracks, of the candidates, and detections: similar, and within the gate."""
        p, gate = self.parameters, kalman.CHI_SQUARE_95[4]
        mean, covariance = self.mean[candidates], self.covariance[candidates]
        reach = np.sqrt(gate * kalman.innovation_variance(mean, covariance)[:, :2].max(axis=1))
        rows, columns = pairs_within(mean[:, :2, 0], reach * (1 + ROUNDING), measurements[:, :2])
        near = kalman.gating_distance(mean[rows], covariance[rows], measurements[columns]) <= gate
        rows, columns = rows[near], columns[near]
        galleries = [self.tracks[row].gallery for row in candidates]
        cost = cosine_distances(galleries, descriptors, rows, columns)
        matched, taken = matching_cascade(
            rows, columns, cost, p.max_cosine_distance, ages[candidates], p.max_age
        )
        return candidates[matched], taken

    def _match_by_iou(self, tracks: Rows, boxes: Floats) -> tuple[Rows, Rows]:
        """Matched places among the tracks and among the boxes."""
        max_cost = self.parameters.max_iou_distance
        expected = kalman.boxes_of(self.mean[tracks])
        # boxes that do not overlap may be matched only if everything may
        largest = boxes[:, 2:].max(initial=0) if max_cost < 1 else np.inf
        reach = (expected[:, 2:].max(axis=1, initial=0) + largest) / 2
        rows, columns = pairs_within(expected[:, :2], reach, boxes[:, :2])
        cost = 1 - iou_of_pairs(expected[rows], boxes[columns])
        near = cost <= max_cost
        return assign_sparse(rows[near], columns[near], cost[near], max_cost + COST_STEP)

    def _terminate(self) -> tuple[int, ...]:
        """A new track is terminated by its first miss, a confirmed one by more than max_age."""
        alive = [
            track.age == 0 or (track.confirmed and track.age <= self.parameters.max_age)
            for track in self.tracks
        ]
        lost = tuple(t.track_id for t, lives in zip(self.tracks, alive, strict=True) if not lives)
        self.tracks = [t for t, lives in zip(self.tracks, alive, strict=True) if lives]
        self.mean, self.covariance = self.mean[alive], self.covariance[alive]
        return lost

    def _start(self, measurements: Floats, descriptors: Floats) -> Rows:
        """Start a track for each of F detections; returns their identities."""
        mean, covariance = kalman.initiate(measurements)
        self.mean = np.concatenate([self.mean, mean])
        self.covariance = np.concatenate([self.covariance, covariance])
        ids = np.arange(self._next_id, self._next_id + len(measurements))
        self._next_id += len(ids)
        self.tracks += [
            _Track(track_id=one, confirmed=self.parameters.n_init <= 1, gallery=[descriptor])
            for one, descriptor in zip(ids.tolist(), descriptors, strict=True)
        ]
        return ids
