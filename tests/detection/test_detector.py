"""Maps of logits to boxes: by hand, and compiled loops against arrays."""

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
import pytest
from numpy.typing import NDArray

from droptrack.detection.decoding import decode_head, select
from droptrack.network.darknet_cfg import YoloHead

Float32s = NDArray[np.float32]


def head_of(anchors: list[list[float]], classes: int, stride: int, scale: float) -> YoloHead:
    sizes = np.array(anchors, float)
    return YoloHead(
        layer=0,
        anchors=sizes,
        all_anchors=sizes,
        mask=tuple(range(len(sizes))),
        classes=classes,
        stride=stride,
        scale_x_y=scale,
    )


@pytest.mark.usefixtures("implementation")
def test_logits_of_zero_are_the_middle_of_a_cell_and_the_anchor() -> None:
    """Cell (3, 1) of 4 x 2 cells of 32 px: the box's middle is at 3.5 and 1.5 cells."""
    raw = np.full((2, 6, 2, 4), -9, np.float32)
    raw[1, :, 1, 3] = [0, 0, 0, np.log(2), np.log(3), 0]
    (row,) = decode_head(raw, head_of([[10, 14], [32, 16]], 1, 32, 1.0), 0.5)
    np.testing.assert_allclose(row, [3.5 / 4, 1.5 / 2, 32 / 128, 2 * 16 / 64, 0.75, 0.5], rtol=1e-6)
    found = select(row[None], 1280, 640, 0.3, 0.5)
    np.testing.assert_allclose(found.boxes, [[1120, 480, 320, 320]], rtol=1e-6)
    np.testing.assert_allclose(found.scores, [0.375], rtol=1e-6)


@pytest.mark.usefixtures("implementation")
def test_the_best_of_those_that_overlap_is_kept() -> None:
    """As Darknet has it, in each class; in a video, a droplet has one class: of its best box."""
    rows = np.array(
        [
            [0.5, 0.5, 0.2, 0.2, 0.9, 0.6, 0.1],  # of class 0
            [0.51, 0.5, 0.2, 0.2, 0.9, 0.9, 0.1],  # better, nearly the same box
            [0.5, 0.5, 0.2, 0.2, 0.9, 0.1, 0.5],  # of class 1
            [0.7, 0.5, 0.2, 0.2, 0.9, 0.5, 0.1],  # beside them
            [0.9, 0.9, 0.2, 0.2, 0.9, 0.3, 0.1],  # not likely enough
            [0.1, 0.1, 0.0, 0.2, 0.9, 0.9, 0.1],  # no box
            [0.1, 0.1, np.nan, 0.2, 0.9, 0.9, 0.1],
        ],
        np.float32,
    )
    whole = select(rows, 100, 100, 0.3, 0.5)
    assert whole.class_ids.tolist() == [0, 0]
    np.testing.assert_allclose(whole.scores, [0.81, 0.45], rtol=1e-6)
    found = select(rows, 100, 100, 0.3, 0.5, greedy=True)
    assert found.class_ids.tolist() == [0, 1, 0]
    np.testing.assert_allclose(found.scores, [0.81, 0.45, 0.45], rtol=1e-6)
    np.testing.assert_allclose(found.boxes[:, 0], [51, 50, 70], rtol=1e-6)


@pytest.mark.usefixtures("implementation")
def test_for_darknets_precision_a_box_counts_for_each_likely_class() -> None:
    """Its get_yolo_detections keeps objectness times probability of every class above a score."""
    rows = np.array([[0.5, 0.5, 0.2, 0.2, 0.5, 0.8, 0.6, 0.1]], np.float32)
    assert select(rows, 100, 100, 0.25, 0.5).scores.tolist() == pytest.approx([0.4])
    found = select(rows, 100, 100, 0.25, 0.5, greedy=True)
    assert found.class_ids.tolist() == [0, 1]
    assert found.scores.tolist() == pytest.approx([0.4, 0.3])


@pytest.mark.parametrize("seed", range(12))
def test_compiled_loops_find_what_arrays_find(
    seed: int, arrays: Callable[[], AbstractContextManager[None]]
) -> None:
    pytest.importorskip("numba")
    rng = np.random.default_rng(seed)
    n_anchors, classes, n_rows, n_columns = rng.integers([1, 1, 2, 2], [4, 4, 40, 40])
    head = head_of(
        rng.uniform(5, 200, (n_anchors, 2)).tolist(), int(classes), 16, 1.05 if seed % 2 else 1.0
    )
    raw = rng.normal(0, 3, (n_anchors, 5 + classes, n_rows, n_columns)).astype(np.float32)
    raw[0, 2, 0, 0], raw[0, 4, 0, 0] = np.inf, 9
    raw[0, 0, 1, 0], raw[0, 4, 1, 0] = np.nan, 9
    raw[0, 4, 0, 1] = np.nan
    threshold = float(rng.choice([0.005, 0.25, 0.9]))
    rows = decode_head(raw, head, threshold)
    found = select(rows, 1200, 600, threshold, 0.45)
    with arrays():
        np.testing.assert_allclose(rows, decode_head(raw, head, threshold), rtol=3e-6, atol=1e-6)
        expected = select(rows, 1200, 600, threshold, 0.45)
    assert 0 < len(expected) < len(rows)
    assert found.boxes.tolist() == expected.boxes.tolist()
    assert found.scores.tolist() == expected.scores.tolist()
    assert found.class_ids.tolist() == expected.class_ids.tolist()


def test_compiled_loops_keep_the_boxes_that_arrays_keep_in_a_crowd(
    arrays: Callable[[], AbstractContextManager[None]],
) -> None:
    pytest.importorskip("numba")
    n_between = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n, reach, classes = rng.integers([2, 60, 1], [120, 500, 3])
        places, sizes = rng.uniform(0, reach, (n, 2)), rng.uniform(20, 60, (n, 2))
        scores = rng.uniform(0.3, 1, (n, 1 + classes))
        rows = np.hstack([places / 600, sizes / 600, scores]).astype(np.float32)
        counts = []
        for greedy in (False, True):
            found = select(rows, 600, 600, 0.1, 0.3, greedy=greedy)
            with arrays():
                expected = select(rows, 600, 600, 0.1, 0.3, greedy=greedy)
            assert found.boxes.tolist() == expected.boxes.tolist()
            assert found.scores.tolist() == expected.scores.tolist()
            assert found.class_ids.tolist() == expected.class_ids.tolist()
            counts.append(len(found))
        n_between += counts[0] != counts[1]
    assert n_between > 20
