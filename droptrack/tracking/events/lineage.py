"""Trajectories -> coalescences, break-ups, droplets that enter and leave; and who came of whom.

A droplet that coalesces or breaks up ends, and what comes of it is a new droplet: trackers hand the
identity of one parent to the child by chance, so the rows from the event on get a new identity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from droptrack.data.trajectories import Trajectories, sorted_trajectories
from droptrack.tracking.events.joins import MAX_IMBALANCE, Join, Track, joins_of, tracks_of

EDGE_SHARE = 0.6  # of a diameter, between the box of a droplet that enters or leaves and the edge
DOUBTFUL = 0.3  # the confidence of what appears or vanishes in the middle
PARENTS = ("parent_id", "parent_id_2")


class Kind(StrEnum):
    """What may happen to droplets."""

    coalescence = "coalescence"
    break_up = "break-up"
    entering = "entering"
    leaving = "leaving"
    appearing = "appearing"  # in the middle: doubtful
    vanishing = "vanishing"


@dataclass(frozen=True, kw_only=True)
class Event:
    """What happened in a frame, the first after it, at x, y px.

    area_balance: area after less area before, relative to that before; NaN where nothing is to be
    balanced. confidence: from 0 to 1.
    """

    frame: int
    kind: Kind
    parents: tuple[int, ...]
    children: tuple[int, ...]
    x: float
    y: float
    area_balance: float = float("nan")
    confidence: float = 1.0


def find_events(rows: Trajectories, size: tuple[int, int]) -> tuple[list[Event], Trajectories]:
    """What happened, by frame, in an image of a size, px; and the rows with identities of it.

    Those have the further columns `parent_id` and `parent_id_2`, 0 where there is none. Two
    droplets of 10 px become one:

    >>> import numpy as np
    >>> def droplet(track_id, frames, x, size):
    ...     return [[t, track_id, x(t), 50, size] for t in frames]
    >>> table = np.array([
    ...     *droplet(1, range(0, 10), lambda t: 40 + t, 10.0),
    ...     *droplet(2, range(0, 10), lambda t: 68 - t, 10.0),
    ...     *droplet(3, range(10, 20), lambda t: 54, 10 * 2**0.5),
    ... ])
    >>> x, y, side = table[:, 2:].T
    >>> rows = sorted_trajectories(
    ...     *table[:, :2].astype(np.int64).T, x, y, np.column_stack([x, y, side, side]),
    ...     np.ones(30), np.ones(30, bool),
    ... )
    >>> (event,), _ = find_events(rows, (120, 100))
    >>> event.kind.value, event.frame, event.parents, event.children
    ('coalescence', 10, (1, 2), (3,))
    """
    tracks = tracks_of(rows)
    if not tracks:
        return [], _with_parents(rows, {}, [])
    first, last = int(rows.frame[0]), int(rows.frame[-1])
    joins = joins_of(tracks, last)
    splits = joins_of([track.reversed for track in tracks], -first)
    cuts = _cuts(joins, splits)
    events = [_coalescence(one, cuts) for one in joins] + [_break_up(one, cuts) for one in splits]
    ended = {one.first for one in joins} | {one.second for one in joins if one.second != one.child}
    begun = {one.first for one in splits} | {
        one.second for one in splits if one.second != one.child
    }
    ended |= {one.child for one in splits if one.child != one.second}
    begun |= {one.child for one in joins if one.child != one.second}
    at_edge = _ends_at_edge(rows, size)
    for track in tracks:
        one = track.track_id
        if track.frames[0] > first and one not in begun:
            events.append(_alone(track, 0, cuts, at_edge=at_edge[one][0]))
        if track.frames[-1] < last and one not in ended:
            events.append(_alone(track, -1, cuts, at_edge=at_edge[one][1]))
    events.sort(key=lambda event: (event.frame, event.kind, event.parents, event.children))
    return events, _with_parents(rows, cuts, events)


def _cuts(joins: Sequence[Join], splits: Sequence[Join]) -> dict[int, list[int]]:
    """In which frames tracks that go on through events become other droplets."""
    cuts: dict[int, set[int]] = {}
    for one in joins:
        if one.child == one.second:
            cuts.setdefault(one.child, set()).add(one.frame)
    for one in splits:
        if one.child == one.second:
            cuts.setdefault(one.child, set()).add(1 - one.frame)
    return {track_id: sorted(frames) for track_id, frames in cuts.items()}


def _piece(track_id: int, frame: int, cuts: dict[int, list[int]]) -> tuple[int, int]:
    """Which piece of a cut track a frame is in."""
    return track_id, int(np.searchsorted(cuts.get(track_id, []), frame, side="right"))


# until they are numbered, droplets are named by their track and its piece
def _coalescence(join: Join, cuts: dict[int, list[int]]) -> Event:
    parents = [_piece(one, join.frame - 1, cuts) for one in (join.first, join.second)]
    return Event(
        frame=join.frame,
        kind=Kind.coalescence,
        parents=_numbers(parents),
        children=_numbers([_piece(join.child, join.frame, cuts)]),
        x=float(join.place[0]),
        y=float(join.place[1]),
        area_balance=join.balance,
        confidence=1 - abs(join.balance) / MAX_IMBALANCE / 2,
    )


def _break_up(join: Join, cuts: dict[int, list[int]]) -> Event:
    """A join seen backwards: its frame is the last, with minus, in which there was one droplet."""
    frame = 1 - join.frame
    children = [_piece(one, frame, cuts) for one in (join.first, join.second)]
    return Event(
        frame=frame,
        kind=Kind.break_up,
        parents=_numbers([_piece(join.child, frame - 1, cuts)]),
        children=_numbers(children),
        x=float(join.place[0]),
        y=float(join.place[1]),
        area_balance=1 / (1 + join.balance) - 1,
        confidence=1 - abs(join.balance) / MAX_IMBALANCE / 2,
    )


PIECES = 10**12  # a track's piece k has the number track_id + k PIECES, until all are numbered


def _numbers(pieces: Sequence[tuple[int, int]]) -> tuple[int, ...]:
    return tuple(sorted(track_id + piece * PIECES for track_id, piece in pieces))


def _alone(track: Track, end: int, cuts: dict[int, list[int]], *, at_edge: bool) -> Event:
    """A track's first (0) or last (-1) row: at the edge it enters or leaves, else is doubtful."""
    frame = int(track.frames[end])
    one = _numbers([_piece(track.track_id, frame, cuts)])
    if end == 0:
        kind = Kind.entering if at_edge else Kind.appearing
    else:
        kind, frame = (Kind.leaving if at_edge else Kind.vanishing), frame + 1
    x, y = track.places[end].tolist()
    return Event(
        frame=frame,
        kind=kind,
        parents=() if end == 0 else one,
        children=one if end == 0 else (),
        x=x,
        y=y,
        confidence=1.0 if at_edge else DOUBTFUL,
    )


def _ends_at_edge(rows: Trajectories, size: tuple[int, int]) -> dict[int, tuple[bool, bool]]:
    """Whether the first and the last row of each track are near the edge of an image of a size.

    Or cut by an edge of another kind, as a region or a field stop, where that was measured.
    """
    order = np.lexsort((rows.frame, rows.track_id))
    ids, starts = np.unique(rows.track_id[order], return_index=True)
    stops = np.append(starts[1:], len(order)) - 1
    low = rows.boxes[:, :2] - rows.boxes[:, 2:] / 2
    high = np.array(size) - rows.boxes[:, :2] - rows.boxes[:, 2:] / 2
    room = np.minimum(low, high).min(axis=1)
    near = room < EDGE_SHARE * rows.boxes[:, 2:].max(axis=1)
    near |= rows.columns.get("at_edge", np.zeros(len(rows))) == 1
    first, last = (near[order[some]].tolist() for some in (starts, stops))
    return dict(zip(ids.tolist(), zip(first, last, strict=True), strict=True))


def _with_parents(
    rows: Trajectories, cuts: dict[int, list[int]], events: list[Event]
) -> Trajectories:
    """Rows with new identities after events, and with their parents'; numbers `events` alike."""
    ids = rows.track_id.copy()
    for track_id, frames in cuts.items():
        mine = rows.track_id == track_id
        ids[mine] += PIECES * np.searchsorted(frames, rows.frame[mine], side="right")
    free = int(rows.track_id.max(initial=0)) + 1
    new = {one: one for one in np.unique(ids).tolist() if one < PIECES}
    for one in sorted(np.unique(ids[ids >= PIECES]).tolist(), key=lambda one: one % PIECES):
        new[one] = free
        free += 1
    for k, event in enumerate(events):
        parents, children = (
            tuple(sorted(new[one] for one in some)) for some in (event.parents, event.children)
        )
        events[k] = Event(**{**vars(event), "parents": parents, "children": children})
    ids = np.array([new[one] for one in ids.tolist()], np.int64)
    of_child = {child: event.parents for event in events for child in event.children}
    pairs = [(*of_child.get(one, ()), 0, 0)[:2] for one in ids.tolist()]
    of_rows = np.array(pairs, np.int64).reshape(-1, 2)
    return sorted_trajectories(
        rows.frame,
        ids,
        rows.x,
        rows.y,
        rows.boxes,
        rows.scores,
        rows.observed,
        {**rows.columns, **dict(zip(PARENTS, of_rows.T, strict=True))},
    )
