"""T1 events: two neighbours part, and the two between them become neighbours.

D. Weaire and N. Rivier (1984). Noise makes neighbours come and go: a pair counts as neighbours, or
as apart, once it has been so for some frames in a row; what is shorter is passed over.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows

TOGETHER, APART, UNKNOWN = 1, 0, -1
MAX_TRIED = 1_000_000  # lost with gained pairs


@dataclass(frozen=True, kw_only=True)
class Rearrangement:
    """In a frame at x, y px the droplets `lost` part, and `gained` become neighbours."""

    frame: int
    x: float
    y: float
    lost: tuple[int, int]
    gained: tuple[int, int]


@dataclass
class NeighbourChanges:
    """Takes frame after frame, and says in the end which neighbours changed for good.

    persistence: frames that a change has to last; box: sides of a periodic one, px.
    """

    persistence: int
    box: tuple[int, int] | None = None
    _frame: int | None = None
    _since: Rows = field(default_factory=lambda: np.zeros(0, np.int64))
    _owners: Rows = field(default_factory=lambda: np.zeros(0, np.int64))
    _keys: Rows = field(default_factory=lambda: np.zeros(0, np.int64))
    _runs: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    _flips: list[tuple[int, int, int, float, float]] = field(default_factory=list)

    def add(self, frame: int, owners: Rows, places: Floats, pairs: tuple[Rows, Rows]) -> None:
        """Droplets (K,), below 2³¹, at places (K, 2) px; pairs: which rows (E,) are neighbours."""
        order = np.argsort(owners)
        a, b = owners[pairs[0]], owners[pairs[1]]
        owners, places = owners[order], places[order]
        keys = np.unique((np.minimum(a, b) << 32) | np.maximum(a, b))
        since = np.full(len(owners), frame)
        if self._frame is None or frame != self._frame + 1:
            self._restart(frame, keys)
        else:
            lost = np.setdiff1d(self._keys, keys, assume_unique=True)
            gained = np.setdiff1d(keys, self._keys, assume_unique=True)
            stayed = _among(owners, self._owners)
            since[stayed] = self._since[np.searchsorted(self._owners, owners[stayed])]
            self._log_lost(frame, lost, owners)
            self._log_gained(frame, gained, owners, since)
            self._find_flips(frame, (lost, gained), keys, owners, places)
        self._frame, self._owners, self._since, self._keys = frame, owners, since, keys

    def _restart(self, frame: int, keys: Rows) -> None:
        """A frame is missing before this one: nothing is known of what changed in it."""
        for key in self._runs:
            self._runs[key].append((frame, UNKNOWN))
        for key in keys.tolist():
            self._runs.setdefault(key, []).append((frame, TOGETHER))

    def _log_lost(self, frame: int, keys: Rows, present: Rows) -> None:
        """Pairs (E,) that are neighbours no more; not known where one of them is not there."""
        there = _among(keys >> 32, present) & _among(keys & 0xFFFFFFFF, present)
        for key, known in zip(keys.tolist(), there.tolist(), strict=True):
            self._runs[key].append((frame, APART if known else UNKNOWN))

    def _log_gained(self, frame: int, keys: Rows, owners: Rows, since: Rows) -> None:
        """Pairs (E,) that are neighbours now; they were apart since both are there."""
        ends = [since[np.searchsorted(owners, one)] for one in (keys >> 32, keys & 0xFFFFFFFF)]
        for key, start in zip(keys.tolist(), np.maximum(*ends).tolist(), strict=True):
            runs = self._runs.setdefault(key, [])
            if not runs or runs[-1][1] == UNKNOWN or runs[-1][0] < start:
                runs += [(start, UNKNOWN), (start, APART)]
            runs.append((frame, TOGETHER))

    def _find_flips(
        self, frame: int, changed: tuple[Rows, Rows], keys: Rows, owners: Rows, places: Floats
    ) -> None:
        """Where lost and gained pairs are the diagonals of four droplets that stay neighbours."""
        all_lost, gained = changed
        step = max(1, MAX_TRIED // max(len(gained), 1))  # pairs of pairs held at once
        for start in range(0, len(all_lost), step):
            lost = all_lost[start : start + step]
            self._flips += self._fitting(frame, lost, gained, keys, owners, places)

    def _fitting(
        self, frame: int, lost: Rows, gained: Rows, keys: Rows, owners: Rows, places: Floats
    ) -> list[tuple[int, int, int, float, float]]:
        i, j = (k.ravel() for k in np.meshgrid(np.arange(len(lost)), np.arange(len(gained))))
        a, b = lost[i] >> 32, lost[i] & 0xFFFFFFFF
        c, d = gained[j] >> 32, gained[j] & 0xFFFFFFFF
        fits: Bools = np.ones(len(i), bool)
        for one, other in ((a, c), (a, d), (b, c), (b, d)):
            side = (np.minimum(one, other) << 32) | np.maximum(one, other)
            fits[fits] = _among(side[fits], keys)
            fits[fits] = _among(side[fits], self._keys)
        found = []
        for k in np.flatnonzero(fits).tolist():
            four = places[np.searchsorted(owners, [a[k], b[k], c[k], d[k]])]
            x, y = self._middle(four).tolist()
            found.append((frame, int(lost[i[k]]), int(gained[j[k]]), x, y))
        return found

    def _middle(self, places: Floats) -> Floats:
        """The mean of places (4, 2), on the same side of the walls of a periodic box."""
        if self.box is None:
            return np.asarray(places.mean(axis=0))
        offset = places - places[0]
        offset -= np.round(offset / self.box) * self.box
        return np.asarray(np.mod(places[0] + offset.mean(axis=0), self.box))

    @property
    def n_flips(self) -> int:
        """All changes of neighbours by T1, those undone soon included."""
        return len(self._flips)

    def found(self) -> list[Rearrangement]:
        """The changes that last, in the order of time."""
        last = self._frame if self._frame is not None else 0
        lasting = {key: _lasting(runs, self.persistence, last) for key, runs in self._runs.items()}
        events: dict[tuple[int, int, int], Rearrangement] = {}
        for frame, lost, gained, x, y in self._flips:
            began = _near(lasting[lost], frame, APART, self.persistence)
            ended = _near(lasting[gained], frame, TOGETHER, self.persistence)
            if began is None or ended is None:
                continue
            event = Rearrangement(frame=frame, x=x, y=y, lost=_pair(lost), gained=_pair(gained))
            events.setdefault((lost, gained, began), event)
        return sorted(events.values(), key=lambda one: (one.frame, one.lost))


def _among(keys: Rows, all_keys: Rows) -> Bools:
    """Whether keys are among others, which are sorted."""
    if not len(all_keys):
        return np.zeros(len(keys), bool)
    at = np.minimum(np.searchsorted(all_keys, keys), len(all_keys) - 1)
    return np.asarray(all_keys[at] == keys)


def _pair(key: int) -> tuple[int, int]:
    return key >> 32, key & 0xFFFFFFFF


def _lasting(runs: Sequence[tuple[int, int]], least: int, last: int) -> list[tuple[int, int]]:
    """Frames and states of the changes from one run of `least` frames or more to the next.

    >>> _lasting([(0, 0), (10, 1), (11, 0), (12, 1)], 3, 30)
    [(12, 1)]
    """
    ends = [start for start, _ in runs[1:]] + [last + 1]
    state: int | None = None
    changes = []
    for (start, new), end in zip(runs, ends, strict=True):
        if new == UNKNOWN:
            state = None
        elif end - start >= least:
            if state is not None and new != state:
                changes.append((start, new))
            state = new
    return changes


def _near(changes: Sequence[tuple[int, int]], frame: int, state: int, reach: int) -> int | None:
    """The frame of a change to a state, no further than `reach` from a frame."""
    for at, new in changes:
        if new == state and abs(at - frame) <= reach:
            return at
    return None


def per_droplet(events: Sequence[Rearrangement], n: int) -> Floats:
    """Events of each of n droplets (n,), a quarter for each of the four: their sum is the number.

    >>> one = Rearrangement(frame=3, x=0.0, y=0.0, lost=(0, 1), gained=(2, 3))
    >>> per_droplet([one], 5).tolist()
    [0.25, 0.25, 0.25, 0.25, 0.0]
    """
    involved = [droplet for one in events for droplet in (*one.lost, *one.gained)]
    return np.bincount(np.array(involved, np.int64), minlength=n) / 4


def rows_of(events: Sequence[Rearrangement], ids: Rows) -> list[Mapping[str, int | float]]:
    """The table of events, with the droplets' identities (N,)."""
    return [
        {
            "frame": one.frame, "x": one.x, "y": one.y,
            "lost_1": int(ids[one.lost[0]]), "lost_2": int(ids[one.lost[1]]),
            "gained_1": int(ids[one.gained[0]]), "gained_2": int(ids[one.gained[1]]),
        }
        for one in events
    ]  # fmt: skip
