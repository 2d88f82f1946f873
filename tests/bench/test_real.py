"""Scores on real images: of all droplets, and of small, middle and large ones, by hand."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bench.real import SIZES, LabelledImage, SetRules, score_set
from droptrack.data.detections import Detections


def boxes_of(rows: Sequence[tuple[float, ...]]) -> Detections:
    """Squares (x, y, side, score)."""
    array = np.array(rows, float).reshape(-1, 4)
    boxes = np.column_stack([array[:, :2], array[:, 2], array[:, 2]])
    return Detections(boxes, array[:, 3], np.zeros(len(array), int))


TRUTH = boxes_of([(50, 50, 20, 1), (150, 50, 20, 1), (100, 150, 60, 1), (300, 200, 150, 1)])
IMAGE = LabelledImage(Path("one.png"), np.zeros((400, 500), np.uint8), TRUTH)


def test_sizes_are_scored_apart() -> None:
    """Of two small ones one is found; the middle one, and before it a false one; not the large one.

    Small: a recall of 1/2 at a precision of 1. Middle: the one after a false one, 1/2. A false
    small box that is surer than all halves what small ones have.
    """
    found = [(50, 50, 20, 0.9), (400, 350, 60, 0.8), (100, 150, 60, 0.7)]
    scores = score_set([IMAGE], SetRules(), lambda _: boxes_of(found))
    assert dict(zip(SIZES, scores.ap50_of_sizes, strict=True)) == pytest.approx(
        {"small": 0.5, "middle": 0.5, "large": 0}
    )
    assert scores.ap50 == pytest.approx(1 / 4 + 1 / 4 * 2 / 3)  # the second of four at 2 of 3
    assert (scores.recall, scores.precision) == pytest.approx((2 / 4, 2 / 3))
    worse = score_set([IMAGE], SetRules(), lambda _: boxes_of([(450, 30, 20, 0.95), *found]))
    assert worse.ap50_of_sizes == pytest.approx((0.25, 0.5, 0))


def test_sizes_without_labels_have_no_score() -> None:
    one = LabelledImage(Path("one.png"), IMAGE.image, TRUTH[:2])
    scores = score_set([one], SetRules(), lambda _: TRUTH[:2])
    assert scores.ap50_of_sizes[0] == pytest.approx(1)
    assert np.isnan(scores.ap50_of_sizes[1:]).all()


def test_a_label_is_found_by_centre_by_one_box_only() -> None:
    """A box in half a label is found by its centre only; one box finds one of two labels."""
    small = (155, 55, 8, 0.9)  # of 20 px: an IoU of 0.16
    two = (152, 50, 20, 0.8)  # of the same label
    unsure = (100, 150, 60, 0.3)
    scores = score_set([IMAGE], SetRules(), lambda _: boxes_of([small, two, unsure]))
    assert scores.by_centre == pytest.approx(1 / 4)
    over = boxes_of([(50, 50, 20, 1), (52, 50, 20, 1)])
    one = LabelledImage(Path("one.png"), IMAGE.image, over)
    assert score_set([one], SetRules(), lambda _: over).by_centre == pytest.approx(1)
    assert score_set([one], SetRules(), lambda _: over[:1]).by_centre == pytest.approx(1 / 2)
