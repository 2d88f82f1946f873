"""Final rows -> smoothed positions and velocities (Rauch, Tung & Striebel 1965).

The filter of `motion` goes forward frame by frame; every LAG frames the smoother goes back through
the last 2 LAG frames, and those that have LAG frames after them are done. What comes later than
that changes nothing that could be seen.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from droptrack import motion
from droptrack.motion import Motion
from droptrack.recorder import Recorded

Floats = NDArray[np.float64]
Rows = NDArray[np.int64] | slice

LAG = 30  # frames
COLUMNS = ("smooth_x", "smooth_y", "velocity_x", "velocity_y")
# standard deviations in droplet diameters
CENTRE_OF_MASS_NOISE = 0.005
BOX_CENTRE_NOISE = 0.04
ACCELERATION = 0.03  # a frame²
FIRST_VELOCITY = 1.0  # a frame


@dataclass
class _Frame:
    """The rows of one frame, and the filter's states of their droplets, in the same order."""

    number: int
    recorded: Recorded
    diameters: Floats  # (N,) of each droplet when it was first seen
    filtered: Motion
    predicted: Motion  # what was expected of them; of droplets new in this frame, nothing
    mine: Rows  # those that were in the frame just before,
    theirs: Rows  # and their rows there


class Smoother:
    """Takes final rows in the order of their frames and gives them back smoothed, later."""

    def __init__(self) -> None:
        self._frames: list[_Frame] = []

    def add(self, recorded: Recorded) -> Iterator[tuple[Recorded, Floats]]:
        """Take the rows of one frame or more; yields rows (M) and columns (M, 4) that are done."""
        for rows in _by_frame(recorded):
            self._frames.append(self._filtered(int(rows.rows.frame[0]), rows))
            if len(self._frames) >= 2 * LAG:
                yield from self._back(LAG)

    def rest(self) -> Iterator[tuple[Recorded, Floats]]:
        """The rows that are left at the end."""
        yield from self._back(len(self._frames))

    def _filtered(self, number: int, recorded: Recorded) -> _Frame:
        """One frame forward."""
        rows = recorded.rows
        places = np.column_stack([rows.x, rows.y])
        diameters = np.sqrt(rows.boxes[:, 2] * rows.boxes[:, 3])
        before = self._frames[-1] if self._frames else None
        mine, theirs = _common(before, number, rows.track_id)
        if before is not None:
            diameters[mine] = before.diameters[theirs]
        noise = np.where(recorded.measured, CENTRE_OF_MASS_NOISE, BOX_CENTRE_NOISE) * diameters
        n = len(rows)
        spread = np.column_stack([noise**2, np.zeros(n), (FIRST_VELOCITY * diameters) ** 2])
        predicted = Motion(places.copy(), np.zeros((n, 2)), spread)
        followed = np.zeros(n, bool)
        if before is not None:
            acceleration = ACCELERATION * diameters[mine]
            predicted[mine] = motion.predict(before.filtered[theirs], acceleration)
            followed[mine] = rows.observed[mine]
        state = motion.update(predicted, places, np.where(followed, noise, np.inf))
        return _Frame(number, recorded, diameters, state, predicted, mine, theirs)

    def _back(self, n_done: int) -> Iterator[tuple[Recorded, Floats]]:
        """Go back through all frames that are held; hand out the first of them."""
        columns: list[Floats] = []
        later: Motion | None = None
        for index in range(len(self._frames) - 1, -1, -1):
            frame = self._frames[index]
            state = frame.filtered[np.arange(len(frame.diameters))]  # a copy
            if later is not None:
                following = self._frames[index + 1]
                mine, theirs = following.theirs, following.mine
                state[mine] = motion.smooth(state[mine], following.predicted[theirs], later[theirs])
            later = state
            columns.append(np.hstack([state.position, state.velocity]))
        for frame, values in zip(self._frames[:n_done], columns[::-1], strict=False):
            yield frame.recorded, values
        del self._frames[:n_done]


def _by_frame(recorded: Recorded) -> Iterator[Recorded]:
    """The rows of each frame."""
    frames = recorded.rows.frame
    if len(frames) and frames[0] == frames[-1]:
        yield recorded
        return
    for number in np.unique(frames):
        part = slice(*np.searchsorted(frames, [number, number + 1]))
        yield Recorded(recorded.rows[part], recorded.measured[part])


def _common(before: _Frame | None, number: int, ids: NDArray[np.int64]) -> tuple[Rows, Rows]:
    """Rows, here and in the frame just before, of the droplets that are in both."""
    if before is None or before.number != number - 1:
        none = np.zeros(0, np.int64)
        return none, none
    ids_before = before.recorded.rows.track_id
    if np.array_equal(ids, ids_before):
        return slice(None), slice(None)
    _, mine, theirs = np.intersect1d(ids, ids_before, assume_unique=True, return_indices=True)
    return mine.astype(np.int64), theirs.astype(np.int64)
