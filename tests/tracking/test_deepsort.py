"""Tracks on drawings whose answer one can count by eye."""

import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from droptrack.evaluation.trajectory_scores import assign
from droptrack.tracking.appearance import describe
from droptrack.tracking.deepsort.matching import cosine_distances, matching_cascade
from droptrack.tracking.deepsort.tracker import DeepSortParameters, DeepSortTracker

Floats = NDArray[np.float64]

Point = tuple[float, float]
Frames = list[Sequence[Point]]

PARAMETERS = DeepSortParameters()
DESCRIPTOR = np.array([1.0, 0.0])


def run(
    frames: Sequence[Sequence[Point]],
    size: float = 20.0,
    parameters: DeepSortParameters = PARAMETERS,
) -> list[list[int]]:
    """Identities of droplets of one size and one descriptor, frame by frame."""
    tracker = DeepSortTracker(parameters)
    ids = []
    for positions in frames:
        boxes = np.array([[x, y, size, size] for x, y in positions]).reshape(-1, 4)
        update = tracker.update(boxes, np.tile(DESCRIPTOR, (len(boxes), 1)))
        ids.append(update.track_ids.tolist())
    return ids


def test_droplets_that_pass_each_other_keep_their_identities() -> None:
    """Two lanes 25 px apart, droplets of 20 px, opposite directions, 4 px a frame."""
    frames = [[(100 + 4 * t, 50), (260 - 4 * t, 75)] for t in range(40)]
    assert run(frames) == [[1, 2]] * 40


def test_order_of_detections_does_not_matter() -> None:
    frames: Frames = [
        [(100 + 4 * t, 50), (100 + 4 * t, 100)][:: 1 if t % 2 else -1] for t in range(20)
    ]
    assert run(frames) == [[1, 2] if t % 2 == 0 else [2, 1] for t in range(20)]


def test_a_droplet_missed_for_some_frames_is_the_same_afterwards() -> None:
    frames: Frames = [[(100 + 3 * t, 50)] for t in range(30)]
    for t in range(12, 18):
        frames[t] = []
    assert run(frames) == [[1]] * 12 + [[]] * 6 + [[1]] * 12


def test_a_droplet_last_seen_more_than_max_age_frames_ago_is_a_new_one() -> None:
    """The cascade's last level takes tracks seen max_age frames ago: a gap of one frame less."""
    there: Sequence[Point] = [(100.0, 50.0)]
    for gap, expected in ((4, 1), (5, 2)):
        frames = [there] * 5 + [[]] * gap + [there] * 5
        assert run(frames, parameters=DeepSortParameters(max_age=5))[-1] == [expected]


def test_a_new_track_is_terminated_by_its_first_miss() -> None:
    there: Sequence[Point] = [(100.0, 50.0)]
    assert run([there, there, [], there]) == [[1], [1], [], [2]]


def test_a_track_is_confirmed_by_the_third_detection_in_a_row() -> None:
    tracker = DeepSortTracker(DeepSortParameters())
    box, descriptor = np.array([[100.0, 50.0, 20.0, 20.0]]), DESCRIPTOR[None]
    assert [tracker.update(box, descriptor).confirmed for _ in range(5)] == [(), (), (1,), (), ()]
    none = np.zeros((0, 4))
    updates = [tracker.update(none, np.zeros((0, 2))) for _ in range(31)]
    assert [update.terminated for update in updates] == [()] * 30 + [(1,)]


def test_with_n_init_of_one_a_track_is_confirmed_at_birth() -> None:
    tracker = DeepSortTracker(DeepSortParameters(n_init=1))
    update = tracker.update(np.array([[100.0, 50.0, 20.0, 20.0]]), DESCRIPTOR[None])
    assert update.confirmed == (1,)


def test_appearance_decides_within_the_gate() -> None:
    """Two droplets nearly in one place exchange positions within the gate; descriptors tell."""
    tracker = DeepSortTracker(DeepSortParameters())
    descriptors = np.eye(2)
    boxes = np.array([[100.0, 50, 40, 40], [104.0, 50, 40, 40]])
    for _ in range(5):
        assert tracker.update(boxes, descriptors).track_ids.tolist() == [1, 2]
    assert tracker.update(boxes[::-1], descriptors).track_ids.tolist() == [1, 2]


def test_a_jump_beyond_the_gate_and_any_iou_starts_a_new_track() -> None:
    here, there = [(100.0, 50.0)], [(140.0, 50.0)]
    frames = [here] * 5 + [there]
    assert run(frames)[-1] == [2]


def test_three_hundred_droplets_keep_their_identities() -> None:
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(20) * 30.0, np.arange(15) * 30.0)
    start = np.column_stack([x.ravel(), y.ravel()])
    velocity = np.array([2.0, 1.0]) + rng.normal(0, 0.02, start.shape)
    frames = [[tuple(p) for p in start + velocity * t] for t in range(20)]
    assert run(frames, size=26.0) == [list(range(1, 301))] * 20


def test_ten_thousand_boxes_take_no_quadratic_memory() -> None:
    """A matrix of all against all would be 800 MB."""
    x, y = np.meshgrid(np.arange(100) * 30.0, np.arange(100) * 30.0)
    places = np.column_stack([x.ravel(), y.ravel()])
    tracker = DeepSortTracker(PARAMETERS)
    tracemalloc.start()
    for t in range(5):
        boxes = np.hstack([places + 2 * t, np.full((10_000, 2), 26.0)])
        update = tracker.update(boxes, np.tile(DESCRIPTOR, (10_000, 1)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6
    assert update.track_ids.tolist() == list(range(1, 10_001))


def test_boxes_apart_are_matched_only_where_every_distance_is_allowed() -> None:
    """An IoU of 0 is a distance of 1."""
    frames = [[(0.0, 0.0)], [(300.0, 0.0)]]
    assert run(frames) == [[1], [2]]
    assert run(frames, parameters=DeepSortParameters(max_iou_distance=1)) == [[1], [1]]


def test_assignment_takes_the_minimum_total_not_the_minimum_pair() -> None:
    """Greedy would take 1 and be left with 9: total 10; the others make 2 + 3."""
    cost = np.array([[1.0, 2.0], [3.0, 9.0]])
    rows, columns = assign(cost, 100)
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 1), (1, 0)]
    rows, columns = assign(cost, 2.5)
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 0)]


def test_the_cascade_serves_tracks_seen_last_first() -> None:
    """The older track would be the cheaper one, but its turn comes later."""
    cost = np.array([0.1, 0.0])
    tracks, detections = matching_cascade(
        np.array([0, 1]), np.array([0, 0]), cost, 0.2, np.array([1, 4]), 30
    )
    assert (tracks.tolist(), detections.tolist()) == ([0], [0])


def test_cosine_distance_is_that_to_the_nearest_in_the_gallery() -> None:
    galleries = [list(np.eye(3)[:2]), list(np.eye(3)[2:])]
    rows, columns = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    found = cosine_distances(galleries, np.eye(3)[[0, 2]], rows, columns)
    np.testing.assert_allclose(found, [0.0, 1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    "box",
    [[30.0, 20, 10, 10], [0.0, 0, 30, 30], [-500.0, 900, 10, 10]],
    ids=["inside", "across the edge", "outside"],
)
def test_every_box_has_a_descriptor_of_length_one(box: list[float]) -> None:
    frame = np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    descriptor = describe(frame, np.array([box]))
    assert np.linalg.norm(descriptor) == pytest.approx(1)
    assert np.isfinite(descriptor).all()


def test_descriptors_of_other_sizes_differ_and_of_equal_ones_do_not() -> None:
    frame = np.full((200, 200, 3), 128, np.uint8)
    boxes = np.array([[50.0, 50, 20, 20], [120, 120, 20, 20], [150, 60, 40, 40]])
    descriptors = describe(frame, boxes)
    distance = 1 - descriptors @ descriptors.T
    assert distance[0, 1] == pytest.approx(0, abs=1e-9)
    assert distance[0, 2] > 0.2
