import numpy as np
import pytest

from droptrack.data.detections import Detections, labels
from droptrack.evaluation.average_precision import average_precision, coco_average_precision


def found(boxes: list[list[float]], scores: list[float]) -> Detections:
    return Detections(
        np.array(boxes, float).reshape(-1, 4), np.array(scores), np.zeros(len(scores), np.int64)
    )


A, B, C = [10.0, 10, 8, 8], [40.0, 10, 8, 8], [70.0, 10, 8, 8]
NOWHERE = [200.0, 200, 8, 8]


def test_all_found_and_nothing_else_is_one() -> None:
    assert average_precision([(found([A, B], [0.9, 0.8]), labels([A, B]))]).average_precision == 1


def test_a_curve_integrated_by_hand() -> None:
    """By falling score: hit, false, hit, and one of three is missed.

    Precision 1, 1/2, 2/3 at recall 1/3, 1/3, 2/3: area 1/3 x 1 + 1/3 x 2/3 = 5/9.
    """
    pairs = [(found([A, NOWHERE, B], [0.9, 0.8, 0.7]), labels([A, B, C]))]
    result = average_precision(pairs, score=0.75)
    assert result.average_precision == pytest.approx(5 / 9)
    assert result.precision == 0.5
    assert result.recall == pytest.approx(1 / 3)


def test_a_droplet_found_twice_counts_once() -> None:
    """Hit at 0.9, duplicate at 0.8 (false), hit at 0.7: 1/2 x 1 + 1/2 x 2/3."""
    pairs = [(found([A, A, B], [0.9, 0.8, 0.7]), labels([A, B]))]
    assert average_precision(pairs).average_precision == pytest.approx(5 / 6)


def test_scores_are_ranked_over_all_images() -> None:
    """The false one of image 2 outranks the hit of image 1: precision 1/2 at recall 1/2."""
    pairs = [(found([A], [0.3]), labels([A])), (found([NOWHERE], [0.9]), labels([B]))]
    assert average_precision(pairs).average_precision == pytest.approx(0.25)


def test_iou_must_exceed_one_half() -> None:
    """Shifted by a third of the width, the IoU is exactly 1/2."""
    shifted = [10 + 8 / 3, 10.0, 8, 8]
    pairs = [(found([shifted], [0.9]), labels([A]))]
    assert average_precision(pairs, min_iou=0.5 + 1e-9).average_precision == 0
    assert average_precision(pairs, min_iou=0.5 - 1e-9).average_precision == 1


def test_without_ground_truth_precision_is_undefined() -> None:
    assert np.isnan(average_precision([(found([A], [0.9]), labels([]))]).average_precision)


def test_f1_and_iou_counted_by_hand() -> None:
    """Above 0.5: one exact hit, one shifted by a third (IoU 1/2), one false; one is missed.

    Precision 2/3, recall 2/3, F1 2/3; IoUs 1, 1/2 and 0.
    """
    shifted = [40 + 8 / 3 - 1e-6, 10.0, 8, 8]
    pairs = [(found([A, shifted, NOWHERE, C], [0.9, 0.8, 0.7, 0.4]), labels([A, B, C]))]
    result = average_precision(pairs, min_iou=0.49, score=0.5)
    assert (result.precision, result.recall, result.f1) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
    assert result.average_iou == pytest.approx((1 + 0.5 + 0) / 3, abs=1e-5)


def test_each_class_is_scored_by_itself() -> None:
    """Class 0 all found; of class 1's two, one is found as class 0: (1/2 + 1/2) / 2."""
    detections = Detections(np.array([A, B, C]), np.array([0.9, 0.8, 0.7]), np.array([0, 0, 1]))
    truth = Detections(np.array([A, B, C]), np.ones(3), np.array([0, 1, 1]))
    assert average_precision([(detections, truth)]).average_precision == pytest.approx(
        (1 + 0.5) / 2
    )


def test_cocos_precision_counted_by_hand() -> None:
    """A false one first, then four of five, with an IoU of 7.5/8.5 = 0.88.

    The best precision is 4/5 up to a recall of 4/5, at 81 of 101 recalls, and the IoU suffices
    for eight of the ten thresholds 0.5, 0.55 ... 0.95.
    """
    truth = [[10.0 * i, 10, 8, 8] for i in range(5)]
    boxes = [NOWHERE, *([x + 0.5, y, w, h] for x, y, w, h in truth[:4])]
    pairs = [(found(boxes, [0.9, 0.8, 0.7, 0.6, 0.5]), labels(truth))]
    every, half = coco_average_precision(pairs)
    assert half == pytest.approx(0.8 * 81 / 101)
    assert every == pytest.approx(0.8 * half)


def test_cocos_precision_counts_more_than_a_hundred_droplets() -> None:
    truth = [[10.0 * (i % 20), 10.0 * (i // 20), 8, 8] for i in range(150)]
    pairs = [(found(truth, np.linspace(0.9, 0.5, 150).tolist()), labels(truth))]
    assert coco_average_precision(pairs) == pytest.approx((1, 1))
    assert coco_average_precision([(found([], []), labels(truth))]) == (0, 0)
    assert np.isnan(coco_average_precision([(found([A], [0.9]), labels([]))])).all()


def test_classes_have_their_own_curves_and_the_mean_is_over_classes() -> None:
    """0: hit, false, hit of two, 5/6. 1: one of two, 1/2. 2: taken for 1, 0. 3: not labelled."""
    boxes = [A, NOWHERE, B, C, [100.0, 40, 8, 8], [130.0, 40, 8, 8]]
    seen = Detections(
        np.array(boxes), np.array([0.9, 0.8, 0.7, 0.9, 0.1, 0.6]), np.array([0, 0, 0, 1, 1, 3])
    )
    there = Detections(
        np.array([A, B, C, [160.0, 40, 8, 8], boxes[4]]), np.ones(5), np.array([0, 0, 1, 1, 2])
    )
    result = average_precision([(seen, there)])
    assert result.of_classes == pytest.approx({0: 5 / 6, 1: 1 / 2, 2: 0})
    assert result.average_precision == pytest.approx((5 / 6 + 1 / 2) / 3)
