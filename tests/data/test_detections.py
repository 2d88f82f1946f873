import numpy as np
import pytest

from droptrack.data.detections import (
    Detections,
    boxes_from_xyxy,
    iou_matrix,
    labels,
    xyxy_from_boxes,
)
from droptrack.detection.suppression import suppress_duplicates


def test_overlap_of_boxes_drawn_on_squared_paper() -> None:
    """A 4 x 2 box and a 2 x 4 box share 2 x 2 of 8 + 8 - 4 squares."""
    wide, tall = [2.0, 1.0, 4.0, 2.0], [3.0, 2.0, 2.0, 4.0]
    far = [50.0, 50.0, 4.0, 2.0]
    iou = iou_matrix(np.array([wide, far]), np.array([tall, wide]))
    np.testing.assert_allclose(iou, np.array([[4 / 12, 1], [0, 0]]))


def test_corners_and_centres_are_converted_there_and_back() -> None:
    boxes = np.array([[5.0, 7.0, 4.0, 2.0]])
    corners = xyxy_from_boxes(boxes)
    assert corners.tolist() == [[3, 6, 7, 8]]
    assert boxes_from_xyxy(corners).tolist() == boxes.tolist()


def test_of_two_boxes_on_one_droplet_the_better_is_kept() -> None:
    boxes = np.array([[10.0, 10, 8, 8], [10.5, 10, 8, 8], [18.5, 10, 8, 8]])
    found = Detections(boxes, np.array([0.7, 0.9, 0.5]), np.zeros(3, np.int64))
    kept = suppress_duplicates(found, 0.45)
    assert sorted(kept.scores.tolist()) == [0.5, 0.9]  # the touching neighbour stays


def test_a_droplet_has_one_class_but_as_darknet_has_it_a_box_of_each() -> None:
    boxes = np.array([[10.0, 10, 8, 8]] * 2)
    found = Detections(boxes, np.array([0.7, 0.9]), np.array([0, 1]))
    assert suppress_duplicates(found, 0.45).class_ids.tolist() == [1]  # the better one
    assert len(suppress_duplicates(found, 0.45, greedy=True)) == 2


def test_two_droplets_that_touch_are_kept_rather_than_a_box_between_them() -> None:
    """What a network saw in a simulated constriction; the best box is on neither droplet."""
    boxes = np.array(
        [[349.9, 246.8, 37.8, 41.3], [338.3, 256.1, 35.5, 37.5], [355.9, 238.9, 34.4, 42.1]]
    )
    found = Detections(boxes, np.array([0.993, 0.99, 0.98]), np.zeros(3, np.int64))
    assert suppress_duplicates(found, 0.3).boxes.tolist() == boxes[1:].tolist()
    assert suppress_duplicates(found, 0.3, greedy=True).boxes.tolist() == boxes[:1].tolist()
    unlikely = Detections(boxes, np.array([0.993, 0.99, 0.4]), np.zeros(3, np.int64))
    assert suppress_duplicates(unlikely, 0.3).boxes.tolist() == boxes[:1].tolist()
    others = Detections(boxes, np.array([0.993, 0.99, 0.98]), np.array([0, 0, 1]))
    assert suppress_duplicates(others, 0.3).class_ids.tolist() == [0, 1]
    assert suppress_duplicates(others, 0.3).boxes.tolist() == boxes[1:].tolist()
    kept = suppress_duplicates(others, 0.3, greedy=True)
    assert kept.boxes.tolist() == boxes[[0, 2]].tolist()


def test_a_droplet_is_kept_rather_than_its_two_halves() -> None:
    boxes = np.array([[50.0, 50, 80, 80], [28.0, 50, 40, 78], [72.0, 50, 40, 78]])
    found = Detections(boxes, np.array([0.9, 0.89, 0.88]), np.zeros(3, np.int64))
    assert suppress_duplicates(found, 0.3).boxes.tolist() == boxes[:1].tolist()


def test_a_droplet_is_kept_rather_than_two_boxes_beside_it_on_one_side() -> None:
    boxes = np.array([[50.0, 50, 40, 40], [66.0, 36, 40, 40], [66.0, 64, 40, 40]])
    found = Detections(boxes, np.array([0.9, 0.89, 0.88]), np.zeros(3, np.int64))
    assert suppress_duplicates(found, 0.2).boxes.tolist() == boxes[:1].tolist()


def test_thousands_of_droplets_are_not_capped() -> None:
    x, y = np.meshgrid(np.arange(100) * 10.0, np.arange(50) * 10.0)
    boxes = np.column_stack([x.ravel(), y.ravel(), np.full(5000, 9.0), np.full(5000, 9.0)])
    found = Detections(boxes, np.linspace(0.1, 1, 5000), np.zeros(5000, np.int64))
    assert len(suppress_duplicates(found, 0.45)) == 5000


@pytest.mark.parametrize(
    ("boxes", "problem"),
    [
        (np.zeros((2, 3)), r"shape \(2, 4\)"),
        (np.array([[1, 1, 1, 1], [1, np.nan, 1, 1.0]]), "finite, row 1"),
        (np.array([[1, 1, 0, 1.0]]), "width and height, row 0"),
    ],
)
def test_boxes_that_are_none_are_refused(boxes: np.ndarray, problem: str) -> None:
    n = len(boxes)
    with pytest.raises(ValueError, match=problem):
        Detections(boxes, np.ones(n), np.zeros(n, np.int64))


def test_no_detections_are_fine() -> None:
    assert len(suppress_duplicates(labels([]), 0.45)) == 0
    assert iou_matrix(labels([]).boxes, labels([[1, 1, 1, 1]]).boxes).shape == (0, 1)
