"""A tracker's updates -> rows of trajectories, once they are final.

A tracker finds only later that an early detection belonged to a droplet, or that a droplet was
missed for a while and is the same. So rows are held back for a few frames: those of a track's first
frames are added when it is confirmed, and gaps are bridged when it is seen again.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import Detections
from droptrack.data.trajectories import Trajectories, concatenate
from droptrack.tracking.tracker import LONG_GAP, Resumption, Unseen, Update

NO_TRACK = 0  # the identity of rows that do not count
# columns of a row's values; those before are x, y, cx, cy, those after N_COLUMNS are further ones
WIDTH, HEIGHT, SCORE, MEASURED = 4, 5, 6, 7
N_COLUMNS = 8


class Row(NamedTuple):
    """One droplet in one frame.

    `values` are x, y, box cx, cy, w, h, the score, 1 where x, y is a measured centre of mass, and
    the further columns.
    """

    track_id: int
    values: Floats
    observed: bool


class Gap(NamedTuple):
    """A long gap that was bridged: from its first frame on, so many frames.

    `distance_px`: between where the droplet was seen before and after. The rest: see `Resumption`.
    """

    track_id: int
    first_frame: int
    n_frames: int
    distance_px: float
    confidence: float
    against_flow: bool


class _Rows(NamedTuple):
    """Rows of one frame: identities (N,), which may change, and values (N, 8 + F) as of `Row`."""

    ids: Rows
    values: Floats
    observed: bool


@dataclass(frozen=True)
class Recorded:
    """M final rows, and whether the position of each (M,) is a measured centre of mass."""

    rows: Trajectories
    measured: Bools

    def __getitem__(self, rows: Bools | slice) -> "Recorded":
        return Recorded(self.rows[rows], self.measured[rows])


def concatenated(parts: Sequence[Recorded]) -> Recorded:
    """Rows of later and later frames, one part after the other."""
    measured = np.concatenate([part.measured for part in parts])
    return Recorded(concatenate([part.rows for part in parts]), measured)


NO_ROWS = Recorded(
    Trajectories(
        frame=np.zeros(0, np.int64),
        track_id=np.zeros(0, np.int64),
        x=np.zeros(0),
        y=np.zeros(0),
        boxes=np.zeros((0, 4)),
        scores=np.zeros(0),
        observed=np.zeros(0, bool),
    ),
    np.zeros(0, bool),
)


class Recorder:
    """Collects rows; `hold` is the number of later frames that may change them.

    These are the tracker's `delay` and its `max_age` together. Frames come in the order of their
    numbers, some of which a live source leaves out. `further` names the further columns of the
    rows, which are NaN where gaps are bridged.
    """

    def __init__(self, hold: int, further: tuple[str, ...] = ()) -> None:
        self._further = further
        self.gaps: list[Gap] = []
        self._resumed: dict[int, Resumption] = {}  # of this frame
        self._added: deque[int] = deque(maxlen=hold + 1)  # the last frames
        self._frames: dict[int, list[_Rows]] = {}
        self._last: dict[int, int] = {}  # the frame in which each living track was last seen
        self._open: dict[int, list[tuple[int, int]]] = {}  # gaps of tracks not confirmed yet
        self._confirmed: set[int] = set()  # all of which there are rows
        self._terminated: deque[tuple[int, int]] = deque()  # frames, and tracks terminated in them

    def add(
        self,
        frame: int,
        detections: Detections,
        centres: Floats,
        measured: Bools,
        update: Update,
        further: Floats | None = None,
    ) -> None:
        """Take a frame's M detections, their centres (M, 2), those measured (M,), their tracks.

        And their further columns (M, F), NaN without.
        """
        if further is None:
            further = np.full((len(detections), len(self._further)), np.nan)
        values = np.column_stack([centres, detections.boxes, detections.scores, measured, further])
        if update.again:
            self._add_again(update.again)
        self._add(frame, values, update)

    def add_end(self, update: Update) -> None:
        """Take what is known only after the last frame."""
        if update.again:
            self._add_again(update.again)
        self._confirm(update.confirmed)
        self._add_unseen(update.unseen)

    def _add_again(self, updates: Sequence[Update]) -> None:
        """All frames since the first box once more, with other tracks."""
        frames = list(self._added)[-len(updates) :]
        values = [self._frames[frame][0].values for frame in frames]
        for frame in [one for one in self._frames if one >= frames[0]]:  # and those left out
            del self._frames[frame]
        self.gaps.clear()
        self._last.clear()
        self._open.clear()
        self._confirmed.clear()
        self._terminated.clear()
        for _ in frames:
            self._added.pop()
        for frame, one, update in zip(frames, values, updates, strict=True):
            self._add(frame, one, update)

    def _add(self, frame: int, values: Floats, update: Update) -> None:
        self._resumed = {one.track_id: one for one in update.resumed}
        for new, old in update.merged:
            self._merge(old, new)
        self._added.append(frame)
        self._frames[frame] = [_Rows(update.track_ids.copy(), values, observed=True)]
        self._confirm(update.confirmed)
        seen = update.track_ids.tolist()
        for track_id in [one for one in seen if self._last.get(one, frame - 1) < frame - 1]:
            gap = (self._last[track_id], frame)
            if track_id in self._confirmed:
                self._bridge(track_id, *gap)
            else:
                self._open.setdefault(track_id, []).append(gap)
        self._last.update(dict.fromkeys(seen, frame))
        self._add_unseen(update.unseen)
        for track_id in update.terminated:
            self._last.pop(track_id, None)
            self._open.pop(track_id, None)
            self._terminated.append((frame, track_id))

    def _confirm(self, track_ids: tuple[int, ...]) -> None:
        """Take tracks as droplets, with the gaps that they had before."""
        self._confirmed.update(track_ids)
        for track_id in self._open.keys() & track_ids:
            for gap in self._open.pop(track_id):
                self._bridge(track_id, *gap)

    def _add_unseen(self, unseen: tuple[Unseen, ...]) -> None:
        """Add the frames in which droplets were in view but not seen, with score 0."""
        for one in unseen:
            place = len(self._added) - 1 - one.ago
            values = self._values_of(one.track_id, self._added[place])
            for k in range(one.way, one.way * (one.n_frames + 1), one.way):
                moved = values.copy()
                moved[:WIDTH] += np.tile(one.velocity, 2) * k
                self._add_unobserved(one.track_id, self._added[place + k], moved)

    def _add_unobserved(self, track_id: int, frame: int, values: Floats) -> None:
        """Add a row of a droplet that has no box."""
        values[[SCORE, MEASURED]] = 0
        values[N_COLUMNS:] = np.nan
        row = _Rows(np.array([track_id]), values[None], observed=False)
        self._frames.setdefault(frame, []).append(row)

    def rows_of(self, frame: int) -> list[Row]:
        """The rows of a frame so far; the last few frames may still get more."""
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
        while self._terminated and self._terminated[0][0] < final:
            self._confirmed.discard(self._terminated.popleft()[1])
        return taken

    def take_rest(self, *, unconfirmed: bool) -> Recorded:
        """All rows left, at the video's end; also those of tracks not yet confirmed if wanted."""
        wanted = self._confirmed.union(self._last) if unconfirmed else self._confirmed
        return self._take(list(self._frames), wanted)

    def _merge(self, old: int, new: int) -> None:
        """Give an old track a new one's rows; where it has its own, the larger box counts."""
        self._last.pop(new, None)
        self._open.pop(new, None)
        for frame in list(self._frames):
            added, own = self._row_of(new, frame), self._row_of(old, frame)
            if added is None:
                continue
            rows, place = added
            rows.ids[place] = old
            if own is not None:
                smaller, at = own if _area(added) > _area(own) else added
                smaller.ids[at] = NO_TRACK
            elif frame > self._last[old]:
                self._bridge(old, self._last[old], frame)
                self._last[old] = frame

    def _bridge(self, track_id: int, start: int, frame: int) -> None:
        """Fill the frames between two in which it was seen, on a straight line, with score 0."""
        before, now = self._values_of(track_id, start), self._values_of(track_id, frame)
        if frame - start - 1 > LONG_GAP:
            known = self._resumed.pop(track_id, Resumption(track_id, math.nan, against_flow=False))
            distance = math.dist(before[:2].tolist(), now[:2].tolist())
            gap = Gap(track_id, start + 1, frame - start - 1, distance, *known[1:])
            self.gaps.append(gap)
        for between in range(start + 1, frame):
            share = (between - start) / (frame - start)
            self._add_unobserved(track_id, between, (1 - share) * before + share * now)

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
        none = np.zeros((0, N_COLUMNS + len(self._further)))
        taken = [(0, _Rows(np.zeros(0, np.int64), none, observed=True))]
        taken += [(frame, rows) for frame in frames for rows in self._frames.pop(frame)]
        counts = [len(rows.ids) for _, rows in taken]
        frame = np.repeat([frame for frame, _ in taken], counts)
        ids = np.concatenate([rows.ids for _, rows in taken])
        values = np.concatenate([rows.values for _, rows in taken])
        observed = np.repeat([rows.observed for _, rows in taken], counts)
        order = np.lexsort((ids, frame))
        order = order[[track_id in wanted for track_id in ids[order].tolist()]]
        values = values[order]
        trajectories = Trajectories(
            frame=frame[order],
            track_id=ids[order],
            x=values[:, 0],
            y=values[:, 1],
            boxes=values[:, 2:SCORE],
            scores=values[:, SCORE],
            observed=observed[order],
            columns=dict(zip(self._further, values[:, N_COLUMNS:].T, strict=True)),
        )
        return Recorded(trajectories, values[:, MEASURED] > 0)


def _area(row: tuple[_Rows, int]) -> float:
    rows, place = row
    return float(rows.values[place, WIDTH] * rows.values[place, HEIGHT])
