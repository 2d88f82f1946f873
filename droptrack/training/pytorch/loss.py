"""The loss of YOLOv3 as Darknet trains it: regression, objectness and class, summed over a batch.

Darknet writes down gradients, not a loss. They are those of binary cross-entropy for x, y,
objectness and class, and of half the squared error for the logarithms of width and height. For each
truth, the anchor (of all heads) whose shape overlaps it best answers, in the cell of its centre.
Predictions that overlap some truth by more than ``ignore_thresh`` are not punished for being there;
those that overlap one by more than ``truth_thresh`` answer for it, too.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from droptrack.network.darknet_cfg import Cfg, YoloHead, yolo_heads


@dataclass(frozen=True)
class Loss:
    """The three parts of the loss, per image, and how many truths shared a cell and anchor."""

    regression: Tensor
    objectness: Tensor
    classes: Tensor
    n_truths: int
    n_rewritten: int

    @property
    def total(self) -> Tensor:
        """What is minimised."""
        return self.regression + self.objectness + self.classes


def yolo_loss(cfg: Cfg, maps: list[Tensor], truths: Tensor) -> Loss:
    """The loss of raw maps, one per head (B, A, 5 + C, rows, columns), against a batch's truths.

    truths (T, 6): image in the batch, class, and the box relative to the image, cx, cy, w, h.
    Anchors are px of the network's input, whatever size the maps were computed at.
    """
    batch = len(maps[0])
    parts = torch.zeros(3, device=truths.device)
    n_rewritten = 0
    for head, raw in zip(yolo_heads(cfg), maps, strict=True):
        layer = cfg.layers[head.layer]
        losses, rewritten = _head_loss(
            head,
            raw.float(),
            truths,
            layer.number("ignore_thresh", 0.5),
            layer.number("truth_thresh", 1.0),
            layer.number("iou_normalizer", 0.75),
        )
        parts = parts + losses / batch
        n_rewritten += rewritten
    return Loss(parts[0], parts[1], parts[2], len(truths), n_rewritten)


def _head_loss(
    head: YoloHead,
    raw: Tensor,
    truths: Tensor,
    ignore_thresh: float,
    truth_thresh: float,
    iou_normalizer: float,
) -> tuple[Tensor, int]:
    rows, columns = raw.shape[3:]
    size = torch.tensor([columns, rows], device=raw.device) * head.stride  # of the input, px
    raw = raw.permute(0, 1, 3, 4, 2)  # (B, A, rows, columns, 5 + C)
    anchors = torch.as_tensor(head.anchors, dtype=raw.dtype, device=raw.device)

    image, cell_x, cell_y, anchor, rows_of_truths = _assign(head, truths, size)
    overlap, row_of_best = _overlaps(raw, anchors, size, truths)
    if truth_thresh < 1:
        good = torch.nonzero(overlap > truth_thresh, as_tuple=True)  # image, anchor, y, x
        image, cell_x = torch.cat([image, good[0]]), torch.cat([cell_x, good[3]])
        cell_y, anchor = torch.cat([cell_y, good[2]]), torch.cat([anchor, good[1]])
        rows_of_truths = torch.cat([rows_of_truths, row_of_best[good]])
    mine = truths[rows_of_truths]
    answer = raw[image, anchor, cell_y, cell_x]  # (M, 5 + C)

    frac = mine[:, 2:4] * (size / head.stride) - torch.stack([cell_x, cell_y], 1)
    logs = torch.log(mine[:, 4:] * size / anchors[anchor])
    xy = functional.binary_cross_entropy_with_logits(answer[:, :2], frac, reduction="none")
    wh = (answer[:, 2:4] - logs).square() / 2
    weight = iou_normalizer * (2 - mine[:, 4] * mine[:, 5])
    regression = (weight[:, None] * (xy + wh)).sum()

    target = torch.zeros_like(raw[..., 4])
    target[image, anchor, cell_y, cell_x] = 1
    sure = (raw[..., 5:].sigmoid() > 0.25).any(dim=-1)
    counted = ~((overlap > ignore_thresh) & sure) | (target > 0)
    objectness = functional.binary_cross_entropy_with_logits(
        raw[..., 4], target, weight=counted.to(raw.dtype), reduction="sum"
    )

    wanted = torch.zeros_like(raw[..., 5:])
    wanted[image, anchor, cell_y, cell_x, mine[:, 1].long()] = 1
    answered = target > 0
    classes = functional.binary_cross_entropy_with_logits(
        raw[..., 5:][answered], wanted[answered], reduction="sum"
    )
    rewritten = len(mine) - int(target.sum())
    return torch.stack([regression, objectness, classes]), rewritten


def _assign(
    head: YoloHead, truths: Tensor, size: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """For the truths this head answers: image, cell x, cell y, anchor, row in truths."""
    every = torch.as_tensor(head.all_anchors, dtype=truths.dtype, device=truths.device)
    shape = truths[:, 4:] * size  # (T, 2) px
    shared = torch.minimum(shape[:, None], every[None]).prod(dim=2)
    overlap = shared / (shape.prod(dim=1)[:, None] + every.prod(dim=1)[None] - shared)
    best = overlap.argmax(dim=1)
    mask = torch.tensor(head.mask, device=truths.device)
    row, anchor = torch.nonzero(best[:, None] == mask[None], as_tuple=True)
    cells = (truths[row, 2:4] * (size / head.stride)).long()
    cells = torch.minimum(cells.clamp_min(0), size // head.stride - 1)
    return truths[row, 0].long(), cells[:, 0], cells[:, 1], anchor, row


@torch.no_grad()
def _overlaps(raw: Tensor, anchors: Tensor, size: Tensor, truths: Tensor) -> tuple[Tensor, Tensor]:
    """Of predictions (B, A, rows, columns): the best overlap with a truth, and that truth's row."""
    batch, _, rows, columns = raw.shape[:4]
    cells = torch.stack(
        torch.meshgrid(
            torch.arange(columns, device=raw.device),
            torch.arange(rows, device=raw.device),
            indexing="xy",
        ),
        dim=-1,
    )
    grid = torch.tensor([columns, rows], device=raw.device)
    centre = (raw[..., :2].sigmoid() + cells) / grid
    half = raw[..., 2:4].clamp(max=10).exp() * anchors[:, None, None] / size / 2
    low, high = (centre - half).flatten(1, 3), (centre + half).flatten(1, 3)  # (B, P, 2)
    area = (high - low).prod(dim=-1)
    best = torch.zeros_like(area)
    row = torch.zeros_like(area, dtype=torch.long)
    for image in range(batch):
        mine = torch.nonzero(truths[:, 0] == image)[:, 0]
        if not len(mine):
            continue
        boxes = truths[mine, 2:]
        b_low, b_high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
        shared = torch.ones((), device=raw.device)
        for axis in range(2):
            end = torch.minimum(high[image, :, None, axis], b_high[None, :, axis])
            begin = torch.maximum(low[image, :, None, axis], b_low[None, :, axis])
            shared = shared * (end - begin).clamp_(min=0)
        union = area[image, :, None] + boxes[:, 2:].prod(dim=1)[None] - shared
        best[image], which = (shared / union).max(dim=1)
        row[image] = mine[which]
    return best.reshape(raw.shape[:4]), row.reshape(raw.shape[:4])
