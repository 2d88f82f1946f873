"""Score trackers on the motions of `data_gen.videos.motions` with TrackEval's metrics."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from trackeval.metrics import CLEAR, HOTA, Identity

from droptrack.data.detections import Detections
from droptrack.data.trajectories import Trajectories
from droptrack.evaluation.trajectory_scores import match
from droptrack.tracking.appearance import describe_sizes
from droptrack.tracking.recorder import concatenated
from droptrack.tracking.session import TrackingSession
from droptrack.tracking.tracker import Tracker

QUIET = {"PRINT_CONFIG": False}


@dataclass(frozen=True, kw_only=True)
class Score:
    """MOTA, IDF1 and HOTA from 0 to 1; switches per 1,000 droplet-frames; errors in diameters."""

    mota: float
    idf1: float
    hota: float
    switches: int
    switches_per_1000: float
    position_rms: float  # of matched positions


def track(tracker: Tracker, frames: Sequence[Detections]) -> Trajectories:
    """The rows of a tracker that sees the sizes of boxes."""
    session = TrackingSession(tracker)
    parts = [
        session.add_boxes(index, found, describe_sizes(found.boxes))
        for index, found in enumerate(frames)
    ]
    return concatenated([*parts, session.finish()]).rows


def only_images(rows: Trajectories, frames: Sequence[Detections]) -> Trajectories:
    """Those rows that are in frames with an image: what has no box at all has none.

    Where droplets are in the frames without an image can be known, but it cannot be seen.
    """
    there = np.array([len(found) > 0 for found in frames], bool)
    return rows[there[rows.frame]]


def score(truth: Trajectories, result: Trajectories) -> Score:
    """Compare with ground truth; two are the same within half a diameter of the true droplet.

    TrackEval takes similarities and matches from 0.5 on: 1 - distance / diameter.
    """
    data = _trackeval_data(truth, result)
    # of the pairs that CLEAR MOT matches: the nearest of several would flatter who gives several
    pairs = match(truth, result)
    dx = result.x[pairs.result] - truth.x[pairs.truth]
    dy = result.y[pairs.result] - truth.y[pairs.truth]
    squares = (dx**2 + dy**2) / truth.boxes[pairs.truth, 2:].prod(axis=1)
    clear = CLEAR(QUIET).eval_sequence(data)
    return Score(
        mota=float(clear["MOTA"]),
        idf1=float(Identity(QUIET).eval_sequence(data)["IDF1"]),
        hota=float(np.mean(HOTA().eval_sequence(data)["HOTA"])),
        switches=int(clear["IDSW"]),
        switches_per_1000=1000 * float(clear["IDSW"]) / len(truth),
        position_rms=float(np.sqrt(squares.mean())) if len(squares) else np.nan,
    )


def _trackeval_data(truth: Trajectories, result: Trajectories) -> dict[str, Any]:
    true_names, true_ids = np.unique(truth.track_id, return_inverse=True)
    names, ids = np.unique(result.track_id, return_inverse=True)
    n_frames = int(max(truth.frame.max(initial=-1), result.frame.max(initial=-1))) + 1
    rows = [
        [slice(*np.searchsorted(table.frame, [t, t + 1])) for t in range(n_frames)]
        for table in (truth, result)
    ]
    similarities = []
    for t, r in zip(*rows, strict=True):
        apart = np.hypot(
            truth.x[t][:, None] - result.x[r][None], truth.y[t][:, None] - result.y[r][None]
        ) / np.sqrt(truth.boxes[t, 2] * truth.boxes[t, 3]).reshape(-1, 1)
        similarities.append(np.maximum(1 - apart, 0))
    return {
        "num_timesteps": n_frames,
        "num_gt_dets": len(truth),
        "num_gt_ids": len(true_names),
        "num_tracker_dets": len(result),
        "num_tracker_ids": len(names),
        "gt_ids": [true_ids[t] for t in rows[0]],
        "tracker_ids": [ids[r] for r in rows[1]],
        "similarity_scores": similarities,
    }
