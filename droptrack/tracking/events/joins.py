"""Which tracks become one: two droplets that coalesce, or, seen backwards in time, that break up.

Two droplets coalesce where one track ends beside another whose area then grows by that of the one
that ended, or where two end and one of their common area begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.trajectories import Trajectories

GAP = 6  # frames that a parent may have been missed before, or a child after
LATE = 16  # as many where a track goes on: a child beside it looks like a duplicate at first
AROUND = 5  # frames before and after over which areas are taken, by their median
MAX_IMBALANCE = 0.25  # of areas, relative to their sum
MIN_GROWTH = 0.5  # of the other parent's area, by which the area of a track that goes on must rise
REACH = 1.35  # of the sum of the radii, at most, between the centres of droplets that coalesce
FAR = 4.0  # the same where they are looked for at first, before their ways are followed
DISTANCE_WEIGHT = 0.1  # of a distance in sums of radii, beside an imbalance


@dataclass(frozen=True, kw_only=True)
class Track:
    """One track: frames (T,) that rise, positions (T, 2) px, areas (T,) px², observed (T,)."""

    track_id: int
    frames: Rows
    places: Floats
    areas: Floats
    observed: Bools

    @property
    def reversed(self) -> "Track":
        """Backwards in time."""
        return Track(
            track_id=self.track_id,
            frames=-self.frames[::-1],
            places=self.places[::-1],
            areas=self.areas[::-1],
            observed=self.observed[::-1],
        )

    def area(self, start: int, stop: int) -> float:
        """The median area over the observed rows of frames start to stop - 1, or NaN."""
        first, last = np.searchsorted(self.frames, [start, stop])
        some = self.areas[first:last][self.observed[first:last]]
        return float(np.median(some)) if len(some) else float("nan")

    def place(self, frame: int) -> Floats:
        """Where it is in a frame, or would be: on by the velocity of its last frames before."""
        k = int(np.searchsorted(self.frames, frame, side="right")) - 1
        k = max(k, 0)
        before = max(k - AROUND, 0)
        if before == k:
            return np.asarray(self.places[k])
        velocity = (self.places[k] - self.places[before]) / (self.frames[k] - self.frames[before])
        return np.asarray(self.places[k] + velocity * (frame - self.frames[k]))


@dataclass(frozen=True, kw_only=True)
class Join:
    """Two tracks that become one at a frame; `child` is `second` where that goes on."""

    frame: int
    first: int
    second: int
    child: int
    place: Floats
    balance: float
    cost: float


def tracks_of(rows: Trajectories) -> list[Track]:
    """The tracks of rows; areas are those of the outlines, else of ellipses in the boxes."""
    order = np.lexsort((rows.frame, rows.track_id))
    ids, starts = np.unique(rows.track_id[order], return_index=True)
    measured = rows.columns.get("area_px2", np.full(len(rows), np.nan))
    of_boxes = np.pi / 4 * rows.boxes[:, 2] * rows.boxes[:, 3]
    areas = np.where(np.isfinite(measured), measured, of_boxes)
    places = np.column_stack([rows.x, rows.y])
    return [
        Track(
            track_id=one,
            frames=rows.frame[some],
            places=places[some],
            areas=areas[some],
            observed=rows.observed[some],
        )
        for one, some in zip(ids.tolist(), np.split(order, starts[1:])[: len(ids)], strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class _Ends:
    """Where N tracks begin and end: frames (N,), places (N, 2) px; their radii (N,) px.

    And all their rows, by frame: frames (M,), the tracks (M,) that they are of, places (M, 2).
    """

    starts: Rows
    stops: Rows
    first: Floats
    final: Floats
    radii: Floats
    frames: Rows
    owners: Rows
    places: Floats

    def near(self, k: int, others: Rows, places: Floats) -> list[int]:
        """Those of other tracks (K,), at places (K, 2), that are not far from the end of one."""
        apart = np.hypot(*(places - self.final[k]).T)
        found: list[int] = others[apart <= FAR * (self.radii[others] + self.radii[k])].tolist()
        return found

    def going_on(self, k: int) -> list[int]:
        """Tracks that are near where one ends, in its last frame, and go on."""
        rows = slice(*np.searchsorted(self.frames, [self.stops[k], self.stops[k] + 1]))
        owners, places = self.owners[rows], self.places[rows]
        longer = self.stops[owners] > self.stops[k]
        return self.near(k, owners[longer], places[longer])

    def beginning(self, k: int) -> list[int]:
        """Tracks that begin near where one ends, soon after."""
        later = self.starts - self.stops[k]
        some = np.flatnonzero((later >= 0) & (later <= 1 + GAP))
        return self.near(k, some, self.first[some])

    def ended(self, k: int, begin: int, last: int) -> list[int]:
        """Tracks that end near where one ends, shortly before a frame."""
        late = (self.stops >= begin - 1 - GAP) & (self.stops <= begin) & (self.stops < last)
        some = np.flatnonzero(late & (self.starts < begin))
        return self.near(k, some, self.final[some])


def _ends_of(tracks: Sequence[Track]) -> _Ends:
    frames = np.concatenate([track.frames for track in tracks])
    owners = np.repeat(np.arange(len(tracks)), [len(track.frames) for track in tracks])
    places = np.concatenate([track.places for track in tracks])
    order = np.argsort(frames, kind="stable")
    return _Ends(
        starts=np.array([track.frames[0] for track in tracks]),
        stops=np.array([track.frames[-1] for track in tracks]),
        first=np.array([track.places[0] for track in tracks]),
        final=np.array([track.places[-1] for track in tracks]),
        radii=np.array([np.sqrt(np.median(track.areas) / np.pi) for track in tracks]),
        frames=frames[order],
        owners=owners[order],
        places=places[order],
    )


def joins_of(tracks: Sequence[Track], last: int) -> list[Join]:
    """Which of the tracks, which end before the frame `last`, become one.

    Each ends and begins once; the best balanced come first.
    """
    ends = _ends_of(tracks)
    found: list[Join | None] = []
    for k in np.flatnonzero(ends.stops < last).tolist():
        found += [_absorbed(tracks[k], tracks[m]) for m in ends.going_on(k)]
        for child in ends.beginning(k):
            begin = int(ends.starts[child])
            found += [
                _united(tracks[k], tracks[m], tracks[child])
                for m in ends.ended(k, begin, last)
                if tracks[m].track_id > tracks[k].track_id and child not in (k, m)
            ]
    used: set[tuple[str, int]] = set()
    kept: list[Join] = []
    for join in sorted((one for one in found if one is not None), key=lambda one: one.cost):
        taken = {("end", join.first)}
        if join.child == join.second:
            taken |= {(f"on {join.child}", f) for f in range(join.frame - GAP, join.frame + GAP)}
        else:
            taken |= {("end", join.second), ("start", join.child)}
        if not taken & used:
            used |= taken
            kept.append(join)
    return kept


def _absorbed(one: Track, other: Track) -> Join | None:
    """One track ends, and another goes on with the area of both."""
    end = int(one.frames[-1])
    area = one.area(end - AROUND, end + 1)
    best: Join | None = None
    for frame in range(end, end + 2 + LATE):
        before, after = other.area(frame - AROUND, frame), other.area(frame, frame + AROUND)
        whole = before + area
        if not (after > before + MIN_GROWTH * area):
            continue
        balance = after / whole - 1
        there = other.place(frame - 1)
        if abs(balance) > MAX_IMBALANCE or not _near(one.place(frame - 1), there, area, before):
            continue
        change = _step(other, frame)
        cost = abs(balance) + DISTANCE_WEIGHT * _apart(one.place(frame - 1), there, area, before)
        cost -= min(change / max(area, 1e-9), 1.0)  # where its area rises the most at once
        if best is None or cost < best.cost:
            place = other.place(frame)
            best = Join(
                frame=frame,
                first=one.track_id,
                second=other.track_id,
                child=other.track_id,
                place=place,
                balance=balance,
                cost=cost,
            )
    return best


def _step(track: Track, frame: int) -> float:
    """By how much the area of a track rises from its last row before a frame to its next."""
    k = int(np.searchsorted(track.frames, frame))
    return float(track.areas[k] - track.areas[k - 1]) if 0 < k < len(track.frames) else 0.0


def _united(one: Track, other: Track, child: Track) -> Join | None:
    """Two tracks end, and a third begins with the area of both."""
    frame = int(child.frames[0])
    ends = [int(track.frames[-1]) for track in (one, other)]
    areas = [t.area(e - AROUND, e + 1) for t, e in zip((one, other), ends, strict=True)]
    balance = child.area(frame, frame + AROUND) / sum(areas) - 1
    places = one.place(frame - 1), other.place(frame - 1)
    if not abs(balance) <= MAX_IMBALANCE or not _near(*places, *areas):
        return None
    middle = (places[0] * areas[0] + places[1] * areas[1]) / sum(areas)
    apart = _apart(middle, child.places[0], *areas)
    if apart > REACH / 2:
        return None
    return Join(
        frame=frame,
        first=one.track_id,
        second=other.track_id,
        child=child.track_id,
        place=child.places[0],
        balance=balance,
        cost=abs(balance) + DISTANCE_WEIGHT * apart - 1,
    )


def _apart(one: Floats, other: Floats, area: float, other_area: float) -> float:
    """How far two places are apart, in sums of the radii of circles of two areas."""
    radii = np.sqrt(area / np.pi) + np.sqrt(other_area / np.pi)
    return float(np.hypot(*(one - other)) / radii)


def _near(one: Floats, other: Floats, area: float, other_area: float) -> bool:
    return _apart(one, other, area, other_area) <= REACH
