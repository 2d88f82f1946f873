"""Sequences of detections on which droptrack's DeepSORT is compared with the original program.

``python tests/tracking/deepsort_sequences.py ORIGINAL`` runs the original (nwojke/deep_sort, GPL,
not part of this repository; ORIGINAL is its folder) on them and writes the identities that it gives
to ``tests/reference/deepsort_original.npz``.
"""

import sys
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.tracking.deepsort.tracker import DeepSortParameters

Floats = NDArray[np.float64]

REFERENCE = Path(__file__).parents[1] / "reference" / "deepsort_original.npz"
N_FRAMES, N_OBJECTS = 300, 60
WIDTH, HEIGHT = 1200.0, 600.0


@dataclass(frozen=True)
class Sequence:
    """Boxes (M, 4) and descriptors (M, D) of each frame, and DeepSORT's parameters."""

    frames: list[tuple[Floats, Floats]]
    parameters: DeepSortParameters


def make(seed: int, own_share: float, missing: float, parameters: DeepSortParameters) -> Sequence:
    """Sixty objects that cross, stop being seen, appear and leave, with noise in all of it.

    `own_share`: of a descriptor, the rest is common or noise; `missing`:
    share of the detections left out; a sixth of the objects are also hidden for 1 to 40 frames.
    """
    rng = np.random.default_rng(seed)
    start = rng.uniform([0, 0], [WIDTH, HEIGHT], (N_OBJECTS, 2))
    velocity = rng.normal(0, 2.5, (N_OBJECTS, 2))
    size = rng.uniform([20, 30], [50, 70], (N_OBJECTS, 2))
    birth = np.where(rng.random(N_OBJECTS) < 0.5, 0, rng.integers(0, N_FRAMES, N_OBJECTS))
    death = birth + rng.integers(20, N_FRAMES, N_OBJECTS)
    hidden = rng.integers(0, N_FRAMES, N_OBJECTS)
    hidden_until = hidden + np.where(
        rng.random(N_OBJECTS) < 1 / 6, rng.integers(1, 40, N_OBJECTS), 0
    )
    own = rng.normal(0, 1, (N_OBJECTS, 16))
    common = rng.normal(0, 1, 16)
    frames = []
    for t in range(N_FRAMES):
        seen = (birth <= t) & (t < death) & ~((hidden <= t) & (t < hidden_until))
        ids = rng.permutation(np.flatnonzero(seen & (rng.random(N_OBJECTS) > missing)))
        place = start[ids] + velocity[ids] * (t - birth[ids, None])
        boxes = np.hstack([place, size[ids]]) + rng.normal(0, 1.0, (len(ids), 4))
        false = np.hstack([rng.uniform(0, HEIGHT, (3, 2)), rng.uniform(20, 60, (3, 2))])
        boxes = np.vstack([boxes, false])
        descriptors = rng.normal(0, 0.4, (len(boxes), 16)) + (1 - own_share) * common
        descriptors[: len(ids)] += own_share * own[ids]
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        frames.append((boxes, descriptors.astype(np.float32).astype(np.float64)))
    return Sequence(frames, parameters)


def sequences() -> dict[str, Sequence]:
    """The sequences by name."""
    return {
        "descriptors that differ": make(1, 1.0, 0.05, DeepSortParameters()),
        "descriptors that mislead": make(2, 0.3, 0.1, DeepSortParameters()),
        "equal descriptors": make(
            3, 0.0, 0.02, DeepSortParameters(max_cosine_distance=0.4, nn_budget=10)
        ),
        "short memory": make(
            4, 0.8, 0.2, DeepSortParameters(max_age=5, n_init=2, max_iou_distance=0.9)
        ),
    }


def identities_of_the_original(sequence: Sequence) -> NDArray[np.int32]:
    """Identity of each detection of all frames, negative while its track is not confirmed."""
    original: Any = import_module("deep_sort.tracker")
    new_detection: Any = import_module("deep_sort.detection").Detection
    new_metric: Any = import_module("deep_sort.nn_matching").NearestNeighborDistanceMetric
    given = asdict(sequence.parameters)
    metric = new_metric("cosine", given.pop("max_cosine_distance"), given.pop("nn_budget"))
    tracker = original.Tracker(metric, **given)
    rows: list[NDArray[np.int32]] = []
    for boxes, descriptors in sequence.frames:
        corners = np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, 2:]])
        detections = [new_detection(c, 1.0, d) for c, d in zip(corners, descriptors, strict=True)]
        tracker.predict()
        matches, _, _ = tracker._match(detections)  # changes nothing: update finds the same
        ids = np.zeros(len(boxes), np.int32)
        for track, detection in matches:
            ids[detection] = tracker.tracks[track].track_id
        before = tracker._next_id
        tracker.update(detections)
        started = [t.track_id for t in tracker.tracks if t.track_id >= before]
        # new tracks are started in the order of what was left unmatched: find them by their place
        for track in tracker.tracks:
            if track.track_id in started:
                ids[np.abs(boxes[:, :2] - track.mean[:2]).sum(axis=1).argmin()] = track.track_id
        confirmed = [t.track_id for t in tracker.tracks if t.is_confirmed()]
        rows.append(np.where(np.isin(ids, confirmed), ids, -ids))
    return np.concatenate(rows)


if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    for name, kind in (("float", float), ("int", int)):  # names that NumPy has dropped
        setattr(np, name, kind)
    rows: dict[str, Any] = {n: identities_of_the_original(s) for n, s in sequences().items()}
    np.savez_compressed(REFERENCE, **rows)
