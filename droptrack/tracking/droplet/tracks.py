"""The droplet tracker's records: detections of a frame, and tracks."""

from dataclasses import dataclass, fields

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking.droplet.noise import Noise
from droptrack.tracking.motion_filter import KinematicState
from droptrack.tracking.row_selection import select


@dataclass(frozen=True)
class Observations:
    """The M detections of a frame."""

    boxes: Floats  # (M, 4)
    log_sizes: Floats  # (M, 2) of width and height
    descriptors: Floats  # (M, D)

    def __len__(self) -> int:
        return len(self.boxes)

    def __getitem__(self, rows: Rows) -> "Observations":
        return Observations(
            select(self.boxes, rows), select(self.log_sizes, rows), select(self.descriptors, rows)
        )


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """N tracks, an array a property; lengths in px, times in frames."""

    ids: Rows
    hits: Rows  # detections
    missed: Rows  # frames since the last one
    unseen: Rows  # images since the last one: a frame without any box has none
    frames: Rows  # since birth, the first one counted
    images: Rows  # the same
    confirmed: Bools
    evidence: Floats  # (N,) 2 log likelihood ratio of a droplet to false boxes that happen to fit
    duplicate_of: Rows  # the track whose droplet had another box when this one was born, or 0
    log_sizes: Floats  # (N, 2) of width and height
    log_area: Floats  # (N,) of the box, its mean over a long time
    diameters: Floats  # (N,) of `log_sizes`
    first_position: Floats  # (N, 2) where it was born
    last_position: Floats  # (N, 2) where it was last seen
    innovation: Floats  # (N, 2) of the last detection, in diameters
    descriptors: Floats  # (N, D)
    state: KinematicState

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, rows: Rows) -> "Tracks":
        names = [field.name for field in fields(self) if field.name != "state"]
        arrays = {name: select(getattr(self, name), rows) for name in names}
        return Tracks(**arrays, state=self.state[rows])

    def replaced(self, **arrays: Floats | Rows | Bools | KinematicState) -> "Tracks":
        """With other arrays; `dataclasses.replace` takes four times as long."""
        tracks = object.__new__(Tracks)
        vars(tracks).update(vars(self), **arrays)
        return tracks

    def followed_by(self, others: "Tracks") -> "Tracks":
        """Both, these first; the descriptors of none are of any length."""
        if not len(self):
            return others
        names = [field.name for field in fields(self) if field.name != "state"]
        arrays = {n: np.concatenate([getattr(self, n), getattr(others, n)]) for n in names}
        return Tracks(**arrays, state=self.state.followed_by(others.state))


def observe(boxes: Floats, descriptors: Floats) -> Observations:
    """Boxes (M, 4) and their descriptors (M, D)."""
    return Observations(boxes, np.log(boxes[:, 2:]), descriptors)


def diameters_of(log_sizes: Floats) -> Floats:
    """Geometric means (N,) of width and height."""
    width, height = log_sizes.T
    return np.asarray(np.exp((width + height) / 2))


def start_tracks(
    found: Observations, duplicate_of: Rows, first_id: int, noise: Noise, unknown_step: float
) -> Tracks:
    """Tracks of N detections that no track took, at rest.

    `duplicate_of` (N,): see `Tracks`; `unknown_step`: the standard deviation of how far they go in
    the first frame, in diameters.
    """
    n, positions = len(found), found.boxes[:, :2]
    diameters = diameters_of(found.log_sizes)
    covariance = np.zeros((n, 3))
    covariance[:, 0] = (noise.centre * diameters) ** 2
    covariance[:, 2] = (unknown_step * diameters) ** 2
    return Tracks(
        ids=np.arange(first_id, first_id + n),
        hits=np.ones(n, np.int64),
        missed=np.zeros(n, np.int64),
        unseen=np.zeros(n, np.int64),
        frames=np.ones(n, np.int64),
        images=np.ones(n, np.int64),
        confirmed=np.zeros(n, bool),
        evidence=np.zeros(n),
        duplicate_of=duplicate_of,
        log_sizes=found.log_sizes,
        log_area=np.log(found.boxes[:, 2] * found.boxes[:, 3]),
        diameters=diameters,
        first_position=positions,
        last_position=positions,
        innovation=np.zeros((n, 2)),
        descriptors=found.descriptors,
        state=KinematicState(positions, np.zeros((n, 2)), covariance),
    )
