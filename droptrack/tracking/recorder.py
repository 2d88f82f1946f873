"""What a tracker says frame by frame -> rows of trajectories, once they are final.

A tracker knows only later that an early detection belonged to a droplet, or that a droplet was
missed for a while and is the same. So rows are held back for a few frames: those of a track's first
frames are added when it is confirmed, and gaps are bridged when it is seen again.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from droptrack.data.trajectories import Trajectories, concatenate
from droptrack.tracking.tracker import Update

Ids = NDArray[np.int64]

NOBODY = 0  # the identity of rows that do not count


class Row(NamedTuple):
    """One droplet in one frame.

    `values` are x, y, box cx, cy, w, h, the score, and 1 where x, y is a measured centre of mass.
    """

    track_id: int
    values: Floats
    observed: bool


class _Rows(NamedTuple):
    """Rows of one frame: identities (N,), which may change, and values (N, 8) as of `Row`."""

    ids: Ids
    values: Floats
    observed: bool


@dataclass(frozen=True)
class Recorded:
    """M final rows, and whether the position of each (M,) is a measured centre of mass."""

    rows: Trajectories
    measured: NDArray[np.bool_]

    def __getitem__(self, rows: NDArray[np.bool_] | slice) -> "Recorded":
        return Recorded(self.rows[rows], self.measured[rows])


def joined(parts: Sequence[Recorded]) -> Recorded:
    """One after the other."""
    measured = np.concatenate([part.measured for part in parts])
    return Recorded(concatenate([part.rows for part in parts]), measured)


class Recorder:
    """Collects rows; `hold` is the number of later frames that may change them.

    These are the tracker's `delay` and its `max_age` together. Frames come in the order of their
    numbers, some of which a live source leaves out.
    """

    def __init__(self, hold: int) -> None:
        self._added: deque[int] = deque(maxlen=hold + 1)  # the last frames
        self._frames: dict[int, list[_Rows]] = {}
        self._last: dict[int, int] = {}  # the frame in which each living track was last seen
        self._confirmed: set[int] = set()  # all of which there are rows
        self._ended: deque[tuple[int, int]] = deque()  # frames, and tracks that ended in them

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
        for young, old in update.joined:
            self._continue(old, young)
        self._added.append(frame)
        self._frames[frame] = [_Rows(update.track_ids.copy(), values, observed=True)]
        self._confirmed.update(update.confirmed)
        seen = update.track_ids.tolist()
        for track_id in [one for one in seen if self._last.get(one, frame - 1) < frame - 1]:
            if track_id in self._confirmed:
                self._bridge(track_id, frame)
        self._last.update(dict.fromkeys(seen, frame))
        for track_id in update.ended:
            self._last.pop(track_id, None)
            self._ended.append((frame, track_id))

    def rows_of(self, frame: int) -> list[Row]:
        """What is known of a frame now; the last few frames may still get rows."""
        return [
            Row(track_id, values, rows.observed)
            for rows in self._frames.get(frame, [])
            for track_id, values in zip(rows.ids.tolist(), rows.values, strict=True)
            if track_id in self._confirmed
        ]

    def take_final(self) -> Recorded:
        """Rows that later frames cannot change any more; they are handed out once."""
        final = self._added[0] if len(self._added) == self._added.maxlen else 0
        taken = self._take([one for one in self._frames if one < final], self._confirmed)
        while self._ended and self._ended[0][0] < final:
            self._confirmed.discard(self._ended.popleft()[1])
        return taken

    def take_rest(self, *, unconfirmed: bool) -> Recorded:
        """All rows left, at the video's end; also those of tracks not yet confirmed if wanted."""
        wanted = self._confirmed.union(self._last) if unconfirmed else self._confirmed
        return self._take(list(self._frames), wanted)

    def _continue(self, old: int, young: int) -> None:
        """Give a track the rows of another; where it has one of its own, the larger box counts."""
        self._last.pop(young, None)
        for frame in list(self._frames):
            new, own = self._row_of(young, frame), self._row_of(old, frame)
            if new is None:
                continue
            rows, place = new
            rows.ids[place] = old
            if own is not None:
                smaller, at = own if _area(new) > _area(own) else new
                smaller.ids[at] = NOBODY
            elif frame > self._last[old]:
                self._bridge(old, frame)
                self._last[old] = frame

    def _bridge(self, track_id: int, frame: int) -> None:
        """Fill the frames since the track was last seen, on a straight line, with score 0."""
        start = self._last[track_id]
        before, now = self._values_of(track_id, start), self._values_of(track_id, frame)
        for between in range(start + 1, frame):
            share = (between - start) / (frame - start)
            values = (1 - share) * before + share * now
            values[6:] = 0
            bridge = _Rows(np.array([track_id]), values[None], observed=False)
            self._frames.setdefault(between, []).append(bridge)

    def _row_of(self, track_id: int, frame: int) -> "tuple[_Rows, int] | None":
        """Where the row of a track is."""
        for rows in self._frames[frame]:
            places = np.flatnonzero(rows.ids == track_id)
            if len(places):
                return rows, int(places[0])
        return None

    def _values_of(self, track_id: int, frame: int) -> Floats:
        found = self._row_of(track_id, frame)
        assert found is not None
        rows, place = found
        return np.asarray(rows.values[place])

    def _take(self, frames: Iterable[int], wanted: set[int]) -> Recorded:
        """Hand out the rows of some tracks."""
        taken = [(0, _Rows(np.zeros(0, np.int64), np.zeros((0, 8)), observed=True))]
        taken += [(frame, rows) for frame in frames for rows in self._frames.pop(frame)]
        counts = [len(rows.ids) for _, rows in taken]
        frame = np.repeat([frame for frame, _ in taken], counts)
        ids = np.concatenate([rows.ids for _, rows in taken])
        values = np.concatenate([rows.values for _, rows in taken])
        observed = np.repeat([rows.observed for _, rows in taken], counts)
        order = np.lexsort((ids, frame))
        order = order[[track_id in wanted for track_id in ids[order].tolist()]]
        values = values[order]
        rows = Trajectories(
            frame[order],
            ids[order],
            values[:, 0],
            values[:, 1],
            values[:, 2:6],
            values[:, 6],
            observed[order],
        )
        return Recorded(rows, values[:, 7] > 0)


def _area(row: tuple[_Rows, int]) -> float:
    rows, place = row
    return float(rows.values[place, 4] * rows.values[place, 5])
