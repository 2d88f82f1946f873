"""The droplet tracker on drawings that one can count by eye, and on what has gone wrong."""

import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.track_scores import score
from droptrack.data.detections import labels
from droptrack.data.trajectories import Trajectories
from droptrack.evaluation.trajectories import evaluate
from droptrack.evaluation.trajectory_scores import assign
from droptrack.tracking.appearance import describe_sizes
from droptrack.tracking.association import assign_greedy, assign_sparse
from droptrack.tracking.deepsort.tracker import DeepSortParameters, DeepSortTracker
from droptrack.tracking.droplet.noise import median
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.resumption import resumptions
from droptrack.tracking.droplet.tracker import DropletTracker
from droptrack.tracking.recorder import concatenated
from droptrack.tracking.session import TrackingSession
from droptrack.tracking.tracker import Tracker, Update
from tests.tracking.constriction_detections import SEEDS, Frames, load, with_more, without

DATA = Path(__file__).parents[1] / "reference"
Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]


def run(frames: Sequence[Sequence[Box]], tracker: DropletTracker | None = None) -> list[Update]:
    """The tracker's updates for boxes, frame by frame."""
    tracker = tracker or DropletTracker(DropletParameters())
    tables = [np.array(boxes, float).reshape(-1, 4) for boxes in frames]
    return [tracker.update(boxes, np.zeros((len(boxes), 0))) for boxes in tables]


def ids(frames: Sequence[Sequence[Box]]) -> list[list[int]]:
    """Identities frame by frame as they are known in the end."""
    updates = run(frames)
    later = {new: old for update in updates for new, old in update.merged}
    return [[later.get(i, i) for i in update.track_ids.tolist()] for update in updates]


def disc(x: float, y: float, d: float = 20.0) -> Box:
    return (x, y, d, d)


@pytest.mark.parametrize("step", [5, 15, 30, 45])
def test_a_row_of_droplets_is_tracked_however_far_it_moves(step: float) -> None:
    """Unevenly spaced, up to 2.25 diameters a frame: further than to the next one's old place."""
    places = [20.0, 60, 95, 140, 170, 222]
    frames = [[disc(x + step * t, 50 + x % 7) for x in places] for t in range(8)]
    assert ids(frames) == [[1, 2, 3, 4, 5, 6]] * 8


def test_a_droplet_that_enters_a_flow_is_expected_to_go_with_it() -> None:
    """At 1.5 diameters a frame, a new one has no velocity of its own; its neighbours have."""
    places = np.array([[x, y] for x in (200.0, 240, 290) for y in (40.0, 83, 121)])
    frames = [[disc(x + 30 * t, y) for x, y in places] for t in range(12)]
    for t in range(4, 12):
        frames[t].append(disc(170 + 30 * (t - 4), 83))
    assert [row[-1] for row in ids(frames)[4:]] == [10] * 8


@pytest.mark.parametrize("gap", [1, 3, 8, 15])
def test_a_droplet_missed_for_some_frames_is_the_same_afterwards(gap: int) -> None:
    """It turns meanwhile: neither end alone tells where it is, both do."""
    path = [(100 + 4.0 * t, 50 + 0.05 * t * t) for t in range(50)]
    frames = [[disc(x, y)] for x, y in path]
    frames[20 : 20 + gap] = [[] for _ in range(gap)]
    assert ids(frames) == [[] if 20 <= t < 20 + gap else [1] for t in range(50)]


@pytest.mark.parametrize(("ahead", "against"), [(20.0, False), (-20.0, True)])
def test_a_gap_against_the_flow_is_known_as_such(ahead: float, against: bool) -> None:
    """Ten droplets go right by 2 px a frame; the first is seen again 20 px ahead, or behind."""
    places = [(50.0 + 40 * i, 50.0 + i % 2 * 30) for i in range(10)]
    tracker = DropletTracker(DropletParameters())
    run([[disc(x + 2 * t, y) for x, y in places] for t in range(10)], tracker)
    run([[disc(x + 2 * t, y) for x, y in places[1:]] for t in range(10, 15)], tracker)
    lost = np.flatnonzero(tracker.tracks.missed > 0)
    ends = tracker.tracks.last_position[lost] + np.array([ahead, 0.0])
    five, even = np.array([5]), np.zeros(1)
    (found,) = resumptions(tracker.tracks, lost, ends, five, even, tracker.flow)
    assert found == (int(tracker.tracks.ids[lost[0]]), 0.5, against)


def test_a_droplet_missed_for_longer_than_max_age_is_a_new_one() -> None:
    there = [disc(50, 50)]
    frames: list[list[Box]] = [*[there] * 10, *[[]] * 21, *[there] * 5]
    assert ids(frames)[-1] == [2]


def test_of_two_droplets_that_meet_each_keeps_its_size() -> None:
    """They come so near that place alone would exchange them: after a gap, each is elsewhere."""
    small, large = [disc(100 + 3.0 * t, 50, 16) for t in range(40)], []
    large = [disc(219 - 3.0 * t, 54, 30) for t in range(40)]
    frames = [[a, b] for a, b in zip(small, large, strict=True)]
    assert ids(frames) == [[1, 2]] * 40


def test_half_a_droplet_with_a_box_of_its_own_is_no_droplet() -> None:
    """One box shrinks to the left half while a second grows on the right, as of a bent droplet."""
    whole: list[list[Box]] = [[(100.0 + t, 50.0, 20.0, 20.0)] for t in range(20)]
    two: list[list[Box]] = [
        [(115.0 + t, 50.0, 11.0, 18.0), (126.0 + t, 52.0, 12.0, 17.0)] for t in range(6)
    ]
    right: list[list[Box]] = [[(133.0 + t, 51.0, 16.0, 18.0)] for t in range(10)]
    updates = run([*whole, *two, *right])
    assert [update.confirmed for update in updates].count((1,)) == 1
    assert sum(len(update.confirmed) for update in updates) == 1
    assert updates[-1].track_ids.tolist() == [1]


def test_a_duplicate_that_stays_is_a_droplet() -> None:
    frames: list[list[Box]] = [[disc(100, 50)] for _ in range(10)]
    frames += [[disc(100, 50), disc(108, 50)] for _ in range(20)]
    updates = run(frames)
    assert [t for t, update in enumerate(updates) if 2 in update.confirmed] == [10 + 14]


def tracked(frames: Frames, tracker: Tracker) -> Trajectories:
    session, parts = TrackingSession(tracker), []
    for number, (found, centres) in enumerate(frames):
        sizes = describe_sizes(found.boxes)
        parts.append(session.add(number, found, centres, np.ones(len(found), bool), sizes))
    return concatenated([*parts, session.finish()]).rows


@pytest.mark.parametrize("seed", SEEDS)
def test_in_a_constriction_no_droplet_is_switched_missed_or_false(seed: int) -> None:
    """19 droplets, 155 frames; DeepSORT has 3, 0, 1, 1 switches and 40, 0, 4, 4 false ones."""
    frames, truth = load(seed)
    rows = tracked(frames, DropletTracker(DropletParameters()))
    summary = evaluate(truth, rows, 205).summary
    assert [summary[k] for k in ("n_switches", "n_false", "n_missed")] == [0, 0, 0]
    assert summary["n_tracks"] == 19


@pytest.mark.parametrize(
    ("change", "share"),
    [(without, 0.01), (without, 0.02), (without, 0.05), (with_more, 0.01), (with_more, 0.02)],
)
def test_a_missed_box_or_one_too_many_costs_no_identity(
    change: Callable[[Frames, float, np.random.Generator], Frames], share: float
) -> None:
    """At most one switch in 5,000 rows, and never more than DeepSORT has."""
    ours, theirs, n_rows = [], [], 0
    for seed in SEEDS:
        frames, truth = load(seed)
        faulty = change(frames, share, np.random.default_rng(seed))
        ours.append(score(truth, tracked(faulty, DropletTracker(DropletParameters()))))
        theirs.append(score(truth, tracked(faulty, DeepSortTracker(DeepSortParameters()))))
        n_rows += len(truth)
    switches = sum(one.switches for one in ours)
    assert switches <= min(n_rows / 5000, sum(one.switches for one in theirs))
    assert np.mean([one.idf1 for one in ours]) > 0.998


def test_sparse_assignment_is_as_good_as_the_dense_one() -> None:
    """With a price on being left, against SciPy's on the full matrix with a dummy for each row."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        n, m = rng.integers(1, 9, 2)
        cost = rng.uniform(-10, 10, (n, m))
        possible = rng.random((n, m)) < 0.4
        rows, columns = np.nonzero(possible & (cost < 5))
        values = cost[rows, columns]
        got_rows, got_columns = assign_sparse(rows, columns, values, 5.0)
        assert len(set(got_rows)) == len(set(got_columns)) == len(got_rows)
        assert possible[got_rows, got_columns].all()
        full = np.hstack([np.where(possible, cost, 1e6), np.full((n, n), 5.0)])
        best_rows, best_columns = assign(full, 1e7)
        expected = full[best_rows, best_columns].sum()
        left = 5.0 * (n - len(got_rows))
        assert cost[got_rows, got_columns].sum() + left == pytest.approx(expected)


def test_greedy_assignment_takes_the_cheapest_pair_first() -> None:
    rows, columns = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    got = assign_greedy(rows, columns, np.array([1.0, 2, 3, 9]), 100)
    assert sorted(zip(*(part.tolist() for part in got), strict=True)) == [(0, 0), (1, 1)]
    together = assign_sparse(rows, columns, np.array([1.0, 2, 3, 9]), 100)
    assert sorted(zip(*(part.tolist() for part in together), strict=True)) == [(0, 1), (1, 0)]


def test_noise_is_learned_from_what_is_seen() -> None:
    """Forty droplets whose boxes are off by 8 % of the diameter."""
    rng = np.random.default_rng(1)
    places = np.array([[x, y] for x in range(40, 440, 50) for y in range(40, 290, 50)])
    tracker = DropletTracker(DropletParameters())
    for t in range(80):
        seen = places + np.array([2.0 * t, 0]) + rng.normal(0, 1.6, places.shape)
        tracker.update(np.hstack([seen, np.full_like(seen, 20.0)]), np.zeros((len(seen), 0)))
    assert tracker.noise.centre == pytest.approx(0.08, rel=0.15)
    assert tracker.noise.acceleration < 0.05


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_the_median_is_numpys(n: int) -> None:
    values = np.random.default_rng(n).normal(0, 1, n)
    assert median(values) == np.median(values)


def test_an_update_writes_into_no_array_that_there_was_before() -> None:
    """Into none of the tracks and boxes: all are locked."""
    tracker = DropletTracker(DropletParameters(appearance=1.0))
    for found, _ in load(SEEDS[0])[0]:
        state = tracker.tracks.state
        tables = (tracker.tracks, state)
        arrays = [a for table in tables for a in vars(table).values() if isinstance(a, np.ndarray)]
        for array in (*arrays, found.boxes):
            array.flags.writeable = False
        tracker.update(found.boxes, describe_sizes(found.boxes))
    assert len(arrays) == 16 + 3


def test_nothing_at_all_and_nothing_for_a_while() -> None:
    assert ids([[], [], []]) == [[], [], []]
    assert ids([[disc(9, 9)]]) == [[1]]


def test_boxes_given_twice_are_one_droplet() -> None:
    """Identical boxes: one track lives on, the other never is a droplet once the first is."""
    frames: list[list[Box]] = [[disc(50 + 2 * t, 50)] for t in range(5)]
    frames += [[disc(50 + 2 * t, 50)] * 2 for t in range(5, 15)]
    frames += [[disc(50 + 2 * t, 50)] for t in range(15, 20)]
    updates = run(frames)
    assert sum(len(update.confirmed) for update in updates) == 1


def test_boxes_and_descriptors_must_be_as_many() -> None:
    with pytest.raises(ValueError, match="1 boxes with 2 descriptors"):
        DropletTracker(DropletParameters()).update(np.ones((1, 4)), np.ones((2, 3)))


def test_ten_thousand_boxes_take_no_quadratic_memory() -> None:
    """A matrix of all against all would be 800 MB."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 4000, (10_000, 2))
    tracker = DropletTracker(DropletParameters())
    tracemalloc.start()
    for t in range(3):
        boxes = np.hstack([places + 2 * t, np.full((10_000, 2), 20.0)])
        update = tracker.update(boxes, np.zeros((10_000, 0)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6
    assert len(update.confirmed) > 9_900


def test_finished_tracks_leave_the_memory() -> None:
    """600 droplets come and go in 1,500 frames; never are more than the last few dozen held."""
    tracker = DropletTracker(DropletParameters())
    session, held = TrackingSession(tracker), []
    for t in range(1500):
        x = np.arange(t % 5 * 10.0, 200, 50)
        boxes = np.column_stack([x, np.full_like(x, 40), np.full((len(x), 2), 20.0)])
        session.add_boxes(t, labels(boxes), np.zeros((len(x), 0)))
        recorder = session._recorder
        kept = len(recorder._frames) + len(recorder._last) + len(recorder._terminated)
        held.append(len(tracker.tracks.ids) + kept + len(recorder._confirmed))
    assert int(tracker.tracks.ids.max()) > 250
    assert max(held[100:200]) >= max(held[200:])


def test_droplets_that_slip_past_each_other_keep_their_identities() -> None:
    """A plastic event: one moves 0.28 diameters more than before, from one frame to the next."""
    rows = np.loadtxt(DATA / "plastic_event.csv", delimiter=",", skiprows=3)
    tracker = DropletTracker(DropletParameters())
    identities: dict[int, set[int]] = {}
    for frame in range(22):
        found = rows[rows[:, 0] == frame]
        update = tracker.update(found[:, 2:], np.zeros((len(found), 0)))
        for droplet, track_id in zip(found[:, 1].astype(int), update.track_ids, strict=True):
            identities.setdefault(droplet, set()).add(int(track_id))
    assert len(identities) == 6
    assert all(len(ids) == 1 for ids in identities.values())
