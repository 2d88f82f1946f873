"""Final rows -> smoothed positions and velocities (Rauch, Tung & Striebel 1965).

The filter of `motion` goes forward frame by frame; every LAG frames the smoother goes back through
the last 2 LAG frames, and those that have LAG frames after them are done. What comes later than
that changes nothing that could be seen.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking import motion_filter as motion
from droptrack.tracking.motion_filter import Motion
from droptrack.tracking.recorder import Recorded, joined

Selection = NDArray[np.int64] | slice

LAG = 30  # frames
COLUMNS = ("smooth_x", "smooth_y", "velocity_x", "velocity_y")
# standard deviations in droplet diameters
CENTRE_OF_MASS_NOISE = 0.005
BOX_CENTRE_NOISE = 0.04
ACCELERATION = 0.03  # a frame²
FIRST_VELOCITY = 1.0  # a frame


@dataclass
class _Frame:
    """The droplets of one frame, and the filter's states of them."""

    number: int
    ids: NDArray[np.int64]  # (N,)
    diameters: Floats  # (N,) of each droplet when it was first seen
    filtered: Motion
    predicted: Motion  # what was expected of them; of droplets new in this frame, nothing
    mine: Selection  # those that were in the frame just before,
    theirs: Selection  # and their rows there


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

    def _filter(
        self, number: int, ids: NDArray[np.int64], columns: Floats, observed: NDArray[np.bool_]
    ) -> None:
        """One frame forward; `columns` (N, 4): x, y, diameter px, noise in diameters."""
        before = self._frames[-1] if self._frames else None
        mine, theirs = _common(before, number, ids)
        n, places = len(ids), columns[:, :2]
        diameters = columns[:, 2].copy()
        if before is not None:
            diameters[mine] = before.diameters[theirs]
        noise = columns[:, 3] * diameters
        spread = np.column_stack([noise**2, np.zeros(n), (FIRST_VELOCITY * diameters) ** 2])
        predicted = Motion(places.copy(), np.zeros((n, 2)), spread)
        followed = np.zeros(n, bool)
        if before is not None:
            acceleration = ACCELERATION * diameters[mine]
            predicted[mine] = motion.predict(before.filtered[theirs], acceleration)
            followed[mine] = observed[mine]
        filtered = motion.update(predicted, places, np.where(followed, noise, np.inf))
        self._frames.append(_Frame(number, ids, diameters, filtered, predicted, mine, theirs))

    def _back(self, n_done: int) -> tuple[Recorded, Floats]:
        """Go back through all frames that are held; hand out the first of them."""
        columns: list[Floats] = []
        later: Motion | None = None
        for index in range(len(self._frames) - 1, -1, -1):
            frame = self._frames[index]
            state = frame.filtered[np.arange(len(frame.ids))]  # a copy
            if later is not None:
                following = self._frames[index + 1]
                mine, theirs = following.theirs, following.mine
                state[mine] = motion.smooth(state[mine], following.predicted[theirs], later[theirs])
            later = state
            if index < n_done:
                columns.append(np.hstack([state.position, state.velocity]))
        del self._frames[:n_done]
        smoothed, held = np.concatenate(columns[::-1]), joined(self._held)
        self._held = [held[len(smoothed) :]]
        return held[: len(smoothed)], smoothed


def _common(before: _Frame | None, number: int, ids: Rows) -> tuple[Selection, Selection]:
    """Rows, here and in the frame just before, of the droplets that are in both."""
    if before is None or before.number != number - 1:
        none = np.zeros(0, np.int64)
        return none, none
    if np.array_equal(ids, before.ids):
        return slice(None), slice(None)
    _, mine, theirs = np.intersect1d(ids, before.ids, assume_unique=True, return_indices=True)
    return mine.astype(np.int64), theirs.astype(np.int64)
