"""What a tracker says frame by frame -> rows of trajectories, once they are final.

A tracker knows only later that an early detection belonged to a droplet, or that a droplet was
missed for a while and is the same. So rows are held back for a few frames: those of a track's first
frames are added when it is confirmed, and gaps are bridged when it is seen again.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from droptrack.detections import Detections
from droptrack.tracks import Update
from droptrack.trajectories import Trajectories

Floats = NDArray[np.float64]


class Row(NamedTuple):
    """One droplet in one frame.

    `values` are x, y, box cx, cy, w, h, the score, and 1 where x, y is a measured centre of mass.
    """

    track_id: int
    values: Floats
    observed: bool


@dataclass(frozen=True)
class Recorded:
    """M final rows, and whether the position of each (M,) is a measured centre of mass."""

    rows: Trajectories
    measured: NDArray[np.bool_]


class Recorder:
    """Collects rows; `max_age` is the longest gap in frames that the tracker bridges."""

    def __init__(self, max_age: int) -> None:
        self.max_age = max_age
        self._confirmed: set[int] = set()
        self._waiting: dict[int, list[tuple[int, Row]]] = {}  # of tracks not yet confirmed
        self._last: dict[int, tuple[int, Row]] = {}  # where each living track was last seen
        self._frames: dict[int, list[Row]] = {}

    def add(
        self,
        frame: int,
        detections: Detections,
        centres: Floats,
        measured: NDArray[np.bool_],
        update: Update,
    ) -> None:
        """Take a frame's M detections, their centres (M, 2), those measured (M,), their tracks."""
        values = np.column_stack([centres, detections.boxes, detections.scores, measured])
        self._frames[frame] = []
        self._confirmed.update(update.confirmed)
        for young, old in update.joined:
            self._continue(old, self._waiting.pop(young, []))
            self._last.pop(young, None)
        for track_id, row_values in zip(update.track_ids.tolist(), values, strict=True):
            row = Row(track_id, row_values, observed=True)
            if track_id in self._confirmed:
                self._bridge(frame, row)
                self._frames[frame].append(row)
            else:
                self._waiting.setdefault(track_id, []).append((frame, row))
            self._last[track_id] = (frame, row)
        for track_id in update.confirmed:
            self._release(track_id)
        for track_id in update.ended:
            self._waiting.pop(track_id, None)
            self._last.pop(track_id, None)
            self._confirmed.discard(track_id)

    def rows_of(self, frame: int) -> list[Row]:
        """What is known of a frame now; the last few frames may still get rows."""
        return self._frames.get(frame, [])

    def take_final(self, frame: int) -> Recorded:
        """Rows that nothing in or after `frame` can change any more; they are handed out once."""
        return self._take([f for f in self._frames if f < frame - self.max_age])

    def take_rest(self, *, unconfirmed: bool) -> Recorded:
        """All rows left, at the video's end; also those of tracks not yet confirmed if wanted."""
        for track_id in list(self._waiting) if unconfirmed else []:
            self._release(track_id)
        return self._take(list(self._frames))

    def _continue(self, track_id: int, rows: list[tuple[int, Row]]) -> None:
        """Give a track the rows of another; where it has one of its own, the larger box counts."""
        for frame, row in rows:
            mine = row._replace(track_id=track_id)
            if frame > self._last[track_id][0]:
                self._bridge(frame, mine)
                self._frames.setdefault(frame, []).append(mine)
                self._last[track_id] = (frame, mine)
            else:
                self._frames[frame] = [
                    mine if other.track_id == track_id and _area(mine) > _area(other) else other
                    for other in self._frames.get(frame, [])
                ]

    def _bridge(self, frame: int, row: Row) -> None:
        """Fill the frames since the track was last seen, on a straight line, with score 0."""
        last = self._last.get(row.track_id)
        if last is None:
            return
        start, before = last
        for between in range(start + 1, frame):
            share = (between - start) / (frame - start)
            values = (1 - share) * before.values + share * row.values
            values[6:] = 0
            self._frames.setdefault(between, []).append(Row(row.track_id, values, observed=False))

    def _release(self, track_id: int) -> None:
        for frame, row in self._waiting.pop(track_id, []):
            self._frames.setdefault(frame, []).append(row)

    def _take(self, frames: list[int]) -> Recorded:
        taken = [(frame, row) for frame in frames for row in self._frames.pop(frame)]
        taken.sort(key=lambda pair: (pair[0], pair[1].track_id))
        values = np.array([row.values for _, row in taken]).reshape(-1, 8)
        rows = Trajectories(
            np.array([frame for frame, _ in taken], np.int64),
            np.array([row.track_id for _, row in taken], np.int64),
            values[:, 0],
            values[:, 1],
            values[:, 2:6],
            values[:, 6],
            np.array([row.observed for _, row in taken], bool),
        )
        return Recorded(rows, values[:, 7] > 0)


def _area(row: Row) -> float:
    return float(row.values[4] * row.values[5])
