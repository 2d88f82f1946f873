"""Trajectories against the ground truth, droplet by droplet: matches, switches, errors."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.trajectories import Trajectories

FORBIDDEN = 1e5  # the cost of pairs that must not be matched


@dataclass(frozen=True)
class Matching:
    """Rows of the ground truth and of the result that are the same droplet in the same frame.

    truth, result (P,): rows, by rising frame; n_false: rows of the result that are no droplet.
    """

    truth: Rows
    result: Rows
    n_false: int


@dataclass(frozen=True, kw_only=True)
class DropletScore:
    """One droplet of the ground truth. Mean square errors are NaN where it was never found.

    Errors are given in px², in (y / H)², H the image's height, and in squared droplet diameters.
    """

    track_id: int
    found_as: tuple[int, ...]  # the result's identities, in order
    n_frames: int  # frames in which it must be found
    n_missed: int
    n_switches: int  # changes of the identity it is found as
    n_fragments: int  # times it is found again after being missed
    mse_y_px2: float
    mse_y_heights2: float
    mse_y_diameters2: float
    mse_position_px2: float
    mse_position_heights2: float
    mse_position_diameters2: float


def match(truth: Trajectories, result: Trajectories) -> Matching:
    """Match frame by frame as CLEAR MOT (Bernardin & Stiefelhagen 2008) does.

    A droplet can be matched to positions within half its diameter sqrt(w h). Pairs of the frame
    before stay together while that holds; the others get the assignment with the minimum total
    distance. A row of the ground truth with score 0 may be found or not: it is neither missed, nor
    is what is found there false.
    """
    identities: dict[int, int] = {}
    truth_rows: list[Rows] = []
    result_rows: list[Rows] = []
    n_false = 0
    reach = np.sqrt(truth.boxes[:, 2] * truth.boxes[:, 3]) / 2
    for frame in np.unique(np.concatenate([truth.frame, result.frame])):
        t = np.arange(*np.searchsorted(truth.frame, [frame, frame + 1]))
        r = np.arange(*np.searchsorted(result.frame, [frame, frame + 1]))
        distance = np.hypot(
            truth.x[t][:, None] - result.x[r][None], truth.y[t][:, None] - result.y[r][None]
        )
        cost = np.where(distance <= reach[t][:, None], distance, FORBIDDEN)
        before = np.array([identities.get(i, 0) for i in truth.track_id[t].tolist()], np.int64)
        rows, columns = _match_frame(cost, before[:, None] == result.track_id[r][None])
        n_false += len(r) - len(columns)
        for row, column in zip(t[rows], r[columns], strict=True):
            identities[int(truth.track_id[row])] = int(result.track_id[column])
        required = truth.scores[t[rows]] > 0
        truth_rows.append(t[rows[required]])
        result_rows.append(r[columns[required]])
    none = np.zeros(0, np.int64)
    return Matching(
        np.concatenate([none, *truth_rows]), np.concatenate([none, *result_rows]), n_false
    )


def _match_frame(cost: Floats, together: Bools) -> tuple[Rows, Rows]:
    """Rows and columns of one frame that are matched, by their cost (N, M).

    `together` (N, M): pairs that the frames before had, which stay unless they are FORBIDDEN now.
    """
    rows, columns = np.nonzero(together & (cost < FORBIDDEN))
    nearest = np.argsort(cost[rows, columns], kind="stable")
    _, first = np.unique(columns[nearest], return_index=True)  # one identity is one droplet
    rows, columns = rows[nearest[first]], columns[nearest[first]]
    free_rows = np.delete(np.arange(cost.shape[0]), rows)
    free_columns = np.delete(np.arange(cost.shape[1]), columns)
    more_rows, more_columns = assign(cost[np.ix_(free_rows, free_columns)], FORBIDDEN / 2)
    return np.append(rows, free_rows[more_rows]), np.append(columns, free_columns[more_columns])


def assign(cost: Floats, max_cost: float) -> tuple[Rows, Rows]:
    """Pairs of rows and columns of a cost matrix (N, M) with the minimum total cost.

    Pairs above `max_cost` count alike while the assignment is sought and are dropped after.
    """
    if not cost.size:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    capped = np.minimum(cost, max_cost + 1e-5)  # a little above it, as in deep_sort
    rows, columns = linear_sum_assignment(capped)
    good = capped[rows, columns] <= max_cost
    return rows[good].astype(np.int64), columns[good].astype(np.int64)


def score_droplets(
    truth: Trajectories, result: Trajectories, matching: Matching, height: float
) -> list[DropletScore]:
    """One score for each droplet of the ground truth; `height` of the image in px, or NaN."""
    dx = result.x[matching.result] - truth.x[matching.truth]
    dy = result.y[matching.result] - truth.y[matching.truth]
    diameter = np.sqrt(truth.boxes[matching.truth, 2] * truth.boxes[matching.truth, 3])
    square_y, square = dy**2, dx**2 + dy**2
    scores = []
    required = truth.scores > 0
    for track_id in np.unique(truth.track_id[required]):
        frames = truth.frame[required & (truth.track_id == track_id)]
        mine = truth.track_id[matching.truth] == track_id
        found = truth.frame[matching.truth[mine]]
        ids = result.track_id[matching.result[mine]]
        changes = np.flatnonzero(np.diff(ids)) + 1
        positions = np.searchsorted(frames, found)
        scores.append(
            DropletScore(
                track_id=int(track_id),
                found_as=tuple(int(ids[i]) for i in [0, *changes] if len(ids)),
                n_frames=len(frames),
                n_missed=len(frames) - len(found),
                n_switches=len(changes),
                n_fragments=int((np.diff(positions) > 1).sum()),
                mse_y_px2=_mean(square_y[mine]),
                mse_y_heights2=_mean(square_y[mine]) / height**2,
                mse_y_diameters2=_mean(square_y[mine] / diameter[mine] ** 2),
                mse_position_px2=_mean(square[mine]),
                mse_position_heights2=_mean(square[mine]) / height**2,
                mse_position_diameters2=_mean(square[mine] / diameter[mine] ** 2),
            )
        )
    return scores


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else float("nan")
