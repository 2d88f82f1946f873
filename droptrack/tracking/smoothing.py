"""Final rows -> smoothed positions and velocities (Rauch, Tung & Striebel 1965).

The filter of `motion_filter` goes forward frame by frame; every LAG frames the smoother goes back
through the last 2 LAG frames, and those that have LAG frames after them are done. Frames later than
that would change them by less than a millionth of a pixel.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking import motion_filter
from droptrack.tracking.motion_filter import KinematicState
from droptrack.tracking.recorder import Recorded, concatenated
from droptrack.tracking.row_selection import RowSelection

LAG = 30  # frames
COLUMNS = ("smooth_x", "smooth_y", "velocity_x", "velocity_y")
# standard deviations in droplet diameters
CENTRE_OF_MASS_NOISE = 0.005
BOX_CENTRE_NOISE = 0.04
EDGE_NOISE = 0.5  # where the image cuts the droplet, its position is hardly known
ACCELERATION = 0.03  # a frame²
FIRST_VELOCITY = 1.0  # a frame


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """The droplets of one frame, and the filter's states of them."""

    number: int
    ids: Rows  # (N,)
    diameters: Floats  # (N,) of each droplet when it was first seen
    filtered: KinematicState
    predicted: KinematicState  # as expected; of droplets new in this frame, nothing is
    here: RowSelection  # those that were in the frame just before, too
    before: RowSelection  # the rows that they had there


class Smoother:
    """Takes final rows in the order of their frames and gives them back smoothed, later."""

    def __init__(self) -> None:
        self._held: list[Recorded] = []  # the rows of all frames that are not done
        self._frames: list[_Frame] = []

    def add(self, recorded: Recorded) -> Iterator[tuple[Recorded, Floats]]:
        """Take the rows of some frames; yields rows (M) and columns (M, 4) that are done."""
        rows = recorded.rows
        if not len(rows):
            return
        self._held.append(recorded)
        noise = np.where(recorded.measured, CENTRE_OF_MASS_NOISE, BOX_CENTRE_NOISE)
        # of a droplet that was not seen yet, the place is hardly known either
        noise = np.where(rows.observed, noise, EDGE_NOISE)
        if (at_edge := rows.columns.get("at_edge")) is not None:
            noise = np.where(at_edge == 1, EDGE_NOISE, noise)
        columns = np.column_stack(
            [rows.x, rows.y, np.sqrt(rows.boxes[:, 2] * rows.boxes[:, 3]), noise]
        )
        starts = np.flatnonzero(np.diff(rows.frame, prepend=-1)).tolist()
        for start, end in pairwise([*starts, len(rows)]):
            one = slice(start, end)
            number = int(rows.frame[start])
            self._filter(number, rows.track_id[one], columns[one], rows.observed[one])
            if len(self._frames) >= 2 * LAG:
                yield self._back(LAG)

    def rest(self) -> Iterator[tuple[Recorded, Floats]]:
        """The rows that are left at the end."""
        if self._frames:
            yield self._back(len(self._frames))

    def _filter(self, number: int, ids: Rows, columns: Floats, observed: Bools) -> None:
        """One frame forward; `columns` (N, 4): x, y, diameter px, noise in diameters."""
        last = self._frames[-1] if self._frames else None
        here, before = _in_both(last, number, ids)
        positions, diameters = columns[:, :2], columns[:, 2]
        if last is not None:
            diameters = here.replaced(diameters, before.of(last.diameters))
        noise = columns[:, 3] * diameters
        predicted = _at_rest(positions, diameters, noise)
        measured = np.zeros(len(ids), bool)  # of new droplets, what is predicted is the position
        if last is not None:
            acceleration = ACCELERATION * here.of(diameters)
            moved = motion_filter.predict(last.filtered[before.rows], acceleration)
            predicted = predicted.replaced(here, moved)
            measured = here.replaced(measured, here.of(observed))
        filtered = motion_filter.update(predicted, positions, np.where(measured, noise, np.inf))
        self._frames.append(
            _Frame(
                number=number,
                ids=ids,
                diameters=diameters,
                filtered=filtered,
                predicted=predicted,
                here=here,
                before=before,
            )
        )

    def _back(self, n_done: int) -> tuple[Recorded, Floats]:
        """Go back through all frames that are held; hand out the first of them."""
        columns: list[Floats] = []
        later: KinematicState | None = None  # the smoothed states of the next frame
        for index in range(len(self._frames) - 1, -1, -1):
            state = self._frames[index].filtered
            if later is not None:
                following = self._frames[index + 1]
                here, there = following.before, following.here.rows
                predicted = following.predicted[there]
                smoothed = motion_filter.smooth(state[here.rows], predicted, later[there])
                state = state.replaced(here, smoothed)
            later = state
            if index < n_done:
                columns.append(np.hstack([state.position, state.velocity]))
        del self._frames[:n_done]
        done, held = np.concatenate(columns[::-1]), concatenated(self._held)
        self._held = [held[len(done) :]]
        return held[: len(done)], done


def _at_rest(positions: Floats, diameters: Floats, noise: Floats) -> KinematicState:
    """N droplets seen for the first time; `noise` (N,): standard deviation of the position, px."""
    n = len(positions)
    covariance = np.column_stack([noise**2, np.zeros(n), (FIRST_VELOCITY * diameters) ** 2])
    return KinematicState(positions, np.zeros((n, 2)), covariance)


def _in_both(last: _Frame | None, number: int, ids: Rows) -> tuple[RowSelection, RowSelection]:
    """Rows, here and in the frame just before, of the droplets that are in both."""
    ids_before = np.zeros(0, np.int64) if last is None else last.ids
    rows = rows_before = np.zeros(0, np.int64)
    if last is not None and last.number == number - 1:
        if np.array_equal(ids, ids_before):
            rows = rows_before = np.arange(len(ids))
        else:
            _, rows, rows_before = np.intersect1d(
                ids, ids_before, assume_unique=True, return_indices=True
            )
    return RowSelection(rows, len(ids)), RowSelection(rows_before, len(ids_before))
