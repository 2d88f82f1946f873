"""The loss, against a loop over cells that writes down what Darknet does."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch", reason="needs the extra [train]")

from droptrack.data.detections import iou_matrix
from droptrack.network.darknet_cfg import Cfg, read_cfg, with_options, yolo_heads
from droptrack.training.pytorch import loss as loss_module
from droptrack.training.pytorch.loss import darknet_loss, yolo_loss

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU with CUDA")
SMALL = Path(__file__).parents[1] / "reference/small-yolov3.cfg"


def darknet_deltas(
    cfg: Cfg, raw: NDArray[np.float64], truths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What Darknet adds to its layer's delta of one image: loops over predictions and truths.

    raw: logits (A, 5 + C, rows, columns); truths (T, 5): class, box relative to the image.
    """
    (head,) = yolo_heads(cfg)
    truth_thresh = cfg.layers[head.layer].number("truth_thresh", 1)
    n, _, rows, columns = raw.shape
    width, height = columns * head.stride, rows * head.stride
    sigmoid = 1 / (1 + np.exp(-raw))
    delta = np.zeros_like(raw)

    def answer(a: int, j: int, i: int, truth: NDArray[np.float64]) -> None:
        class_id, x, y, w, h = truth
        scale = 0.75 * (2 - w * h)
        delta[a, 0, j, i] += scale * (x * columns - i - sigmoid[a, 0, j, i])
        delta[a, 1, j, i] += scale * (y * rows - j - sigmoid[a, 1, j, i])
        delta[a, 2, j, i] += scale * (np.log(w * width / head.anchors[a, 0]) - raw[a, 2, j, i])
        delta[a, 3, j, i] += scale * (np.log(h * height / head.anchors[a, 1]) - raw[a, 3, j, i])
        delta[a, 4, j, i] = 1 - sigmoid[a, 4, j, i]
        delta[a, 5 + int(class_id), j, i] = 1 - sigmoid[a, 5 + int(class_id), j, i]

    for a in range(n):
        for j in range(rows):
            for i in range(columns):
                box = [
                    (i + sigmoid[a, 0, j, i]) / columns,
                    (j + sigmoid[a, 1, j, i]) / rows,
                    np.exp(raw[a, 2, j, i]) * head.anchors[a, 0] / width,
                    np.exp(raw[a, 3, j, i]) * head.anchors[a, 1] / height,
                ]
                ious = iou_matrix(np.array([box]), truths[:, 1:])[0]
                best = ious.max(initial=0)
                delta[a, 4, j, i] = -sigmoid[a, 4, j, i]
                if best > 0.5 and sigmoid[a, 5, j, i] > 0.25:
                    delta[a, 4, j, i] = 0
                if best > truth_thresh:
                    answer(a, j, i, truths[ious.argmax()])
    for truth in truths:
        shapes = np.hstack(
            [np.zeros((len(head.all_anchors), 2)), head.all_anchors / [width, height]]
        )
        anchor = int(iou_matrix(np.array([[0, 0, *truth[3:]]]), shapes).argmax())
        if anchor in head.mask:
            answer(head.mask.index(anchor), int(truth[2] * rows), int(truth[1] * columns), truth)
    return delta


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=needs_gpu)])
@pytest.mark.parametrize("max_pairs", [1, 2**24])  # image by image, all at once
@pytest.mark.parametrize("truth_thresh", ["1", "0.55"])
def test_gradient_of_the_loss_is_what_darknet_writes_down(
    truth_thresh: str, max_pairs: int, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loss_module, "MAX_PAIRS", max_pairs)
    monkeypatch.setattr(loss_module, "MAX_PAIRS_GPU", max_pairs)
    cfg = with_options(read_cfg(SMALL), {}, {"truth_thresh": truth_thresh})
    rng = np.random.default_rng(3)
    raw = rng.normal(0, 1.5, (3, 3, 6, 8, 12))
    truths = [
        np.array(
            [[0, 0.31, 0.42, 0.11, 0.17], [0, 0.32, 0.43, 0.12, 0.17], [0, 0.8, 0.2, 0.5, 0.7]]
        ),
        np.empty((0, 5)),
        np.array([[0, 0.11, 0.92, 0.06, 0.1]]),
    ]
    for image in range(3):  # some predictions right on a ground truth, so that they are ignored
        raw[image, 1, 2:4, 4:6, 3:6] = 0.1
    batch = np.concatenate([np.column_stack([np.full(len(t), i), t]) for i, t in enumerate(truths)])
    maps = torch.tensor(raw, dtype=torch.float64, device=device, requires_grad=True)
    loss = yolo_loss(cfg, [maps], torch.tensor(batch, device=device))
    loss.total.backward()  # type: ignore[no-untyped-call]
    expected = np.stack([darknet_deltas(cfg, raw[i], truths[i]) for i in range(3)])
    answering = (expected[:, :, 4] > 0).sum()
    assert answering == 2 if truth_thresh == "1" else answering > 2
    assert (expected[:, :, 4] == 0).any() or truth_thresh != "1"
    # a mean over 3 images
    np.testing.assert_allclose(-3 * maps.grad.cpu().numpy(), expected, atol=3e-5)
    # the first two ground truths share a cell and anchor
    assert loss.n_rewritten == 1 or truth_thresh != "1"
    assert float(darknet_loss([maps])) == pytest.approx((expected**2).sum() / 3, rel=1e-5)


def test_a_perfect_answer_costs_next_to_nothing() -> None:
    cfg = read_cfg(SMALL)
    raw = torch.zeros(1, 3, 6, 8, 12)
    raw[:, :, 4] = -12
    raw[0, 1, :, 4, 6] = torch.tensor([0.0, 0, 0, 0, 12, 12])  # cell centre, anchor 10 x 10
    truth = torch.tensor([[0, 0, 6.5 / 12, 4.5 / 8, 10 / 96, 10 / 64]])
    loss = yolo_loss(cfg, [raw], truth)
    assert float(loss.objectness + loss.classes) < 0.01
    assert float(loss.regression) == pytest.approx(
        2 * np.log(2) * 0.75 * (2 - 100 / 6144), rel=1e-5
    )
