"""What the droplet tracker knows of its tracks, one array a property."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking.motion_filter import Motion


@dataclass
class Tracks:
    """N tracks; lengths in px, times in frames."""

    ids: Rows
    hits: Rows  # detections
    missed: Rows  # frames since the last one
    frames: Rows  # since birth, the first one counted
    confirmed: NDArray[np.bool_]
    evidence: Floats  # (N,) 2 log likelihood ratio of a droplet to false boxes that happen to fit
    second_of: Rows  # the track on whose droplet this one was born as a second box, or 0
    log_sizes: Floats  # (N, 2) of width and height
    log_area: Floats  # (N,) of the box, its mean over a long time
    first: Floats  # (N, 2) where it was born
    seen: Floats  # (N, 2) where it was last seen
    innovation: Floats  # (N, 2) of the last detection, in diameters
    looks: Floats  # (N, D)
    state: Motion

    @property
    def diameters(self) -> Floats:
        """Geometric mean of width and height, px."""
        width, height = self.log_sizes.T
        return np.asarray(np.exp((width + height) / 2))

    def __getitem__(self, rows: Rows | NDArray[np.bool_]) -> "Tracks":
        return Tracks(**{name: array[rows] for name, array in vars(self).items()})

    def and_these(self, others: "Tracks") -> "Tracks":
        """Both, these first."""
        state = {
            name: np.concatenate([array, getattr(others.state, name)])
            for name, array in vars(self.state).items()
        }
        arrays = {
            name: np.concatenate([array, getattr(others, name)])
            for name, array in vars(self).items()
            if name != "state"
        }
        return Tracks(**arrays, state=Motion(**state))


def new_tracks(boxes: Floats, descriptors: Floats, first_id: int) -> Tracks:
    """Tracks of boxes (N, 4) that are seen for the first time, at rest and without covariance."""
    n = len(boxes)
    places = boxes[:, :2]
    return Tracks(
        ids=np.arange(first_id, first_id + n),
        hits=np.ones(n, np.int64),
        missed=np.zeros(n, np.int64),
        frames=np.ones(n, np.int64),
        confirmed=np.zeros(n, bool),
        evidence=np.zeros(n),
        second_of=np.zeros(n, np.int64),
        log_sizes=np.log(boxes[:, 2:]),
        log_area=np.log(boxes[:, 2] * boxes[:, 3]),
        first=places.copy(),
        seen=places.copy(),
        innovation=np.zeros((n, 2)),
        looks=descriptors.copy(),
        state=Motion(places.copy(), np.zeros((n, 2)), np.zeros((n, 3))),
    )
