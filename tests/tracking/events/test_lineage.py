"""Coalescences and break-ups drawn exactly, found through a faulty detector and the tracker."""

import numpy as np
import pytest

from data_gen.videos.motion_kinds import HEIGHT, WIDTH, Kind, Motion
from data_gen.videos.motion_paths import events_of
from data_gen.videos.motions import make
from droptrack.data.trajectories import Trajectories, concatenate, sorted_trajectories
from droptrack.evaluation.trajectory_scores import match
from droptrack.tracking.appearance import describe_sizes
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracker import DropletTracker
from droptrack.tracking.events import lineage
from droptrack.tracking.events.lineage import find_events
from droptrack.tracking.session import TrackingSession

SIZE = (int(WIDTH), int(HEIGHT))
JOINED = {Kind.merging: lineage.Kind.coalescence, Kind.splitting: lineage.Kind.break_up}


def tracked(motion: Motion, seed: int) -> tuple[Trajectories, Trajectories]:
    truth, found = make(motion, seed)
    session = TrackingSession(DropletTracker(DropletParameters()))
    parts = [session.add_boxes(t, one, describe_sizes(one.boxes)) for t, one in enumerate(found)]
    rows = [part.rows for part in [*parts, session.finish()] if len(part.rows)]
    return truth, concatenate(rows)


@pytest.mark.parametrize("kind", [Kind.merging, Kind.splitting])
@pytest.mark.parametrize("seed", [0, 1])
def test_events_are_found_through_missing_and_false_detections(kind: Kind, seed: int) -> None:
    """Fifty events, 10 % missing, 5 % false; bystanders stay who they were."""
    motion = Motion(kind, droplets=200, missing=0.1, false=0.05)
    expected = events_of(motion, seed)
    assert len(expected) == 50
    truth, rows = tracked(motion, seed)
    events, new = find_events(rows, SIZE)
    found = [one for one in events if one.kind == JOINED[kind]]
    free = list(found)
    n_hits = 0
    for event in expected:
        for one in free:
            if (
                abs(one.frame - event.frame) <= 5
                and np.hypot(one.x - event.x, one.y - event.y) < 20
            ):
                free.remove(one)
                n_hits += 1
                break
    others = [e for e in events if e.kind in JOINED.values() and e.kind != JOINED[kind]]
    assert n_hits >= 0.95 * 50
    assert n_hits >= 0.95 * (len(found) + len(others))
    pairs, before = match(truth, new), match(truth, rows)
    taking_part = {k for e in expected for k in (*e.parents, *e.children)}
    bystander = ~np.isin(truth.track_id, list(taking_part))
    assert bystander.any()
    for matching, table in ((pairs, new), (before, rows)):
        ids = table.track_id[matching.result]
        of_truth = truth.track_id[matching.truth]
        n_ids = [len(np.unique(ids[of_truth == k])) for k in np.unique(truth.track_id[bystander])]
        assert np.mean(np.array(n_ids) == 1) >= 0.98


@pytest.mark.parametrize("kind", [Kind.merging, Kind.splitting])
def test_areas_of_drawn_events_add_up_and_a_child_is_nobody_s_parent(kind: Kind) -> None:
    motion = Motion(kind, droplets=40)
    truth, rows = tracked(motion, 3)
    events, new = find_events(rows, SIZE)
    (wanted,) = {one.kind for one in events}
    assert wanted == JOINED[kind]
    assert [one.frame for one in events] == sorted(one.frame for one in events_of(motion, 3))
    assert all(abs(one.area_balance) < 1e-9 and one.confidence > 0.99 for one in events)
    n_after = 1 if kind == Kind.merging else 2
    assert all((len(e.parents), len(e.children)) == (3 - n_after, n_after) for e in events)
    for event in events:
        for parent in event.parents:
            assert new.frame[new.track_id == parent].max() == event.frame - 1
        for child in event.children:
            mine = new.track_id == child
            assert new.frame[mine].min() == event.frame
            parents = {*new.columns["parent_id"][mine], *new.columns["parent_id_2"][mine]}
            assert parents - {0} == set(event.parents)
    assert len(new) == len(rows) == len(truth)


def line(track_id: int, frames: range, x0: float, step: float, side: float) -> list[list[float]]:
    return [[t, track_id, x0 + step * t, 50.0, side] for t in frames]


def rows_of(*lines: list[list[float]]) -> Trajectories:
    table = np.array([row for one in lines for row in one])
    x, y, side = table[:, 2:].T
    ids = table[:, :2].astype(np.int64)
    boxes = np.column_stack([x, y, side, side])
    n = len(x)
    return sorted_trajectories(ids[:, 0], ids[:, 1], x, y, boxes, np.ones(n), np.ones(n, bool))


def test_a_parent_whose_identity_went_on_ends_and_the_child_is_new() -> None:
    grown = 10 * 2**0.5
    rows = rows_of(
        line(1, range(10), 40, 1, 10), line(2, range(10), 68, -1, 10),
        line(1, range(10, 20), 54, 0, grown),
    )  # fmt: skip
    events, new = find_events(rows, (120, 100))
    assert [(e.kind.value, e.frame, e.parents, e.children) for e in events] == [
        ("coalescence", 10, (1, 2), (3,))
    ]
    assert new.track_id[new.frame >= 10].tolist() == [3] * 10
    assert new.columns["parent_id"][new.frame >= 10].tolist() == [1] * 10
    assert new.columns["parent_id_2"][new.frame >= 10].tolist() == [2] * 10


def test_entering_leaving_and_what_is_doubtful() -> None:
    """Right to left out of the image; in from the left; lost, and found, in the middle."""
    rows = rows_of(
        line(1, range(20), 100, -5, 10), line(2, range(5, 30), -18, 5, 10),
        line(3, range(12), 300, 0, 10), line(4, range(15, 30), 400, 0, 10),
    )  # fmt: skip
    events, _ = find_events(rows, (600, 100))
    assert [(e.kind.value, e.frame, e.parents or e.children) for e in events] == [
        ("entering", 5, (2,)), ("vanishing", 12, (3,)),
        ("appearing", 15, (4,)), ("leaving", 20, (1,)),
    ]  # fmt: skip
    assert [e.confidence for e in events] == [1, 0.3, 0.3, 1]


def test_what_a_region_or_a_field_stop_cuts_enters_and_leaves_there() -> None:
    """In the middle of the image: cut in its first frame, and in its last one."""
    passing = line(1, range(3, 20), 200, 5, 10)
    rows = rows_of(passing, line(2, range(30), 500, 0, 10))
    cut = np.isin(rows.frame, [3, 19]) & (rows.track_id == 1)
    columns = {"at_edge": cut.astype(float)}
    whole = (rows.frame, rows.track_id, rows.x, rows.y, rows.boxes, rows.scores, rows.observed)
    events, _ = find_events(sorted_trajectories(*whole, columns), (1000, 100))
    assert [(e.kind.value, e.frame, e.confidence) for e in events] == [
        ("entering", 3, 1.0), ("leaving", 20, 1.0),
    ]  # fmt: skip
    assert [e.kind.value for e in find_events(rows, (1000, 100))[0]] == ["appearing", "vanishing"]


def test_a_droplet_that_only_vanishes_beside_another_does_not_coalesce() -> None:
    rows = rows_of(line(1, range(10), 60, 0, 10), line(2, range(20), 71, 0, 10))
    events, new = find_events(rows, (200, 100))
    assert [e.kind.value for e in events] == ["vanishing"]
    assert (new.track_id == rows.track_id).all()


def test_no_rows_have_no_events() -> None:
    none = rows_of(line(1, range(2), 5, 5, 4))[:0]
    events, new = find_events(none, (10, 10))
    assert events == []
    assert len(new) == 0
