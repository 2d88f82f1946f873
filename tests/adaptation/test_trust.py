"""Which boxes are trusted, which images are used, and what makes a network better: by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from droptrack.adaptation.comparison import Quality, n_alike, verdict
from droptrack.adaptation.footage import _choose, is_still
from droptrack.adaptation.looking import covered, within
from droptrack.adaptation.trust import (
    Seen,
    _few_small_ones_doubted,
    _inside_others,
    _steady,
    _trust_tracks,
    track,
)
from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from tests.adaptation.drawn import channel_image, shot_of


def found(boxes: object, score: float = 0.6) -> Detections:
    array = np.asarray(boxes, float).reshape(-1, 4)
    return Detections(array, np.full(len(array), score), np.zeros(len(array), np.int64))


def moving(frame: int, *, size: float = 30, y: float = 40) -> Floats:
    return np.array([20.0 + 8 * frame, y, size, size])


def rows_of(frames: list[list[Floats]]) -> tuple[list[int], int]:
    """How many rows of each frame are trusted, and of how many tracks."""
    rows = track((number, found(boxes)) for number, boxes in enumerate(frames))
    good, n_tracks = _steady(rows, (400, 200))
    return np.bincount(rows.frame[good], minlength=len(frames)).tolist(), n_tracks


def test_a_long_steady_track_is_trusted_and_a_short_one_is_not() -> None:
    frames = [[moving(t), *([moving(t, y=120)] if t < 3 else [])] for t in range(12)]
    assert rows_of(frames) == ([1] * 12, 1)


def test_a_droplet_missed_between_is_trusted_where_it_must_have_been() -> None:
    frames = [[] if t in (5, 6) else [moving(t)] for t in range(14)]
    counts, n_tracks = rows_of(frames)
    assert (counts, n_tracks) == ([1] * 14, 1)
    shot = shot_of(np.zeros((200, 400), np.uint8))

    stretch = [(replace(shot, number=t), found(boxes)) for t, boxes in enumerate(frames)]
    trusted = _trust_tracks([stretch]).seen[5].trusted
    np.testing.assert_allclose(trusted, [moving(5)], atol=1e-6)


def test_boxes_whose_size_is_not_steady_are_not_trusted() -> None:
    sizes = [30, 44, 28, 46, 30, 45, 28, 44, 31, 46, 29, 45]
    assert rows_of([[moving(t, size=sizes[t])] for t in range(12)])[1] == 0


def test_what_stays_while_others_move_is_no_droplet() -> None:
    dirt = np.array([250.0, 150, 20, 20])
    frames = [[moving(t), moving(t, y=90), dirt] for t in range(15)]
    assert rows_of(frames) == ([2] * 15, 2)


def test_boxes_end_where_their_image_does() -> None:
    """An image of 100 x 50 px that was extended to a larger one."""
    kept = within(found([[95, 25, 20, 20], [120, 25, 20, 20], [50, 25, 10, 10]]), (100, 50))
    assert kept.boxes.tolist() == [[92.5, 25, 15, 20], [50, 25, 10, 10]]


def test_the_covered_share_of_a_box_is_that_of_the_areas() -> None:
    boxes = np.array([[10.0, 10, 10, 10], [50, 50, 10, 10]])
    assert covered(boxes, np.array([[12.5, 10, 10, 10]])).tolist() == [0.75, 0]
    assert covered(boxes, boxes[:0]).tolist() == [0, 0]


def test_noise_and_a_lamp_that_changes_are_still_and_a_droplet_is_not() -> None:
    rng = np.random.default_rng(0)
    empty = [channel_image(t, rng, droplets=False) for t in range(8)]
    brighter = [
        np.clip(image.astype(int) + 2 * t, 0, 255).astype(np.uint8) for t, image in enumerate(empty)
    ]
    assert is_still([shot_of(image) for image in empty])
    assert is_still([shot_of(image) for image in brighter])
    assert not is_still([shot_of(channel_image(t, rng)) for t in range(8)])
    one = [channel_image(2, rng) for _ in range(8)]
    assert is_still([shot_of(image) for image in one])


@pytest.mark.parametrize(
    ("n", "n_used", "n_kept"), [(8, 6, 2), (50, 40, 10), (150, 120, 30), (1000, 160, 60)]
)
def test_images_kept_back_are_not_learned_from(n: int, n_used: int, n_kept: int) -> None:
    used, kept = _choose(n, 10_000)
    places = [place for stretch in used for place in stretch]
    assert (len(places), len(kept)) == (n_used, n_kept)
    assert len(set(places)) == n_used
    assert max(places) < min(kept)
    assert max(kept) == n - 1
    assert sum(len(part) for part in _choose(n, 16)[0]) <= 16


def test_alike_are_boxes_that_are_each_others_best() -> None:
    one = found([[50, 50, 20, 20], [120, 50, 20, 20]])
    assert n_alike(one, found([[52, 50, 20, 20], [51, 50, 20, 20], [160, 50, 20, 20]])) == 1
    assert n_alike(one, one) == 2
    assert n_alike(one, one[:0]) == 0


BEFORE = Quality(
    n_images=10,
    droplets_per_image=5,
    n_tracks=10,
    mean_track_frames=6,
    droplets_seen_once_percent=20,
    frames_bridged_percent=4,
    agreement_percent=80,
    average_precision_50_percent=np.nan,
)


@pytest.mark.parametrize(
    ("changes", "helped"),
    [
        ({}, False),
        ({"agreement_percent": 90}, True),
        ({"agreement_percent": 70}, False),
        ({"droplets_seen_once_percent": 5, "frames_bridged_percent": 1}, True),
        ({"droplets_seen_once_percent": 30}, False),
        ({"agreement_percent": 99, "droplets_per_image": 2}, False),
        ({"agreement_percent": 90, "average_precision_50_percent": 80}, True),
    ],
)
def test_it_helped_where_more_got_better_than_worse(changes: dict[str, Any], helped: bool) -> None:

    before = BEFORE
    if "average_precision_50_percent" in changes:
        before = replace(before, average_precision_50_percent=70)
    assert verdict(before, replace(before, **changes))[0] is helped


def test_labels_decide_where_there_are_some() -> None:

    before = replace(BEFORE, average_precision_50_percent=90)
    after = replace(before, agreement_percent=95, average_precision_50_percent=85)
    assert verdict(before, after) == (False, "worse: average precision 50")


def test_cells_in_a_plug_are_nothing_and_cores_in_a_shell_are_droplets() -> None:
    """A cell's score is lower than its plug's; a core's is not."""
    boxes = np.array([[100.0, 100, 120, 60], [90, 100, 20, 20], [120, 100, 25, 25]])
    assert _inside_others(boxes, np.array([0.9, 0.5, 0.85])).tolist() == [False, True, False]
    assert _inside_others(boxes, np.array([0.3, 0.5, 0.85])).tolist() == [False, False, False]


@pytest.mark.parametrize(("n_images", "side", "n_doubted"), [(20, 40, 1), (6, 40, 0), (20, 25, 0)])
def test_a_few_droplets_much_smaller_than_the_others_are_doubtful(
    n_images: int, side: int, n_doubted: int
) -> None:
    """One cell beside 20 plugs is; one of seven droplets is not, nor where one is of half the size.

    Nor what is left of a plug, nor a plug as small as the cell in an image that another lens took.
    """
    plug, cell, cut = [100.0, 100, 80, 40], [60.0, 150, 16, 16], [1.0, 150, 2, 40]
    shot = shot_of(np.zeros((200, 400), np.uint8), 0)
    seen = [
        Seen(shot=shot, trusted=np.array(boxes), doubtful=np.empty((0, 4)))
        for boxes in (
            [plug, cell, cut],
            [cell],
            [plug, [200.0, 100, side, side]],
            *([plug],) * (n_images - 3),
        )
    ]
    first, *others = _few_small_ones_doubted(seen)
    assert first.doubtful.tolist() == [cell][:n_doubted]
    assert first.trusted.tolist() == [plug, cell, cut][:: 1 + n_doubted]
    assert not any(len(one.doubtful) for one in others)
