"""The loss of YOLOv3 as Darknet trains it: regression, objectness and class, summed over a batch.

Darknet writes down gradients, not a loss. They are those of binary cross-entropy for x, y,
objectness and class, and of half the squared error for the logarithms of width and height. For each
ground truth, the anchor (of all heads) with the best IoU answers, in the cell of its centre.
Predictions whose IoU with a ground truth is above ``ignore_thresh`` are not punished for being
there; those above ``truth_thresh`` answer for it, too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from droptrack.network.darknet_cfg import Cfg, Layer, YoloHead, yolo_heads
from droptrack.network.torch_network import decode_boxes, head_grid

# predictions times ground truths whose IoUs are computed at once: what fits into a core's cache, or
# so many that a GPU waits for few commands
MAX_PAIRS, MAX_PAIRS_GPU = 2**17, 2**24
CONFIDENT = 0.25  # probability of a class, above which a good prediction is not punished


@dataclass(frozen=True, kw_only=True)
class Loss:
    """The three parts of the loss, per image; how many ground truths shared a cell and anchor."""

    regression: Tensor
    objectness: Tensor
    classes: Tensor
    n_ground_truths: int
    n_rewritten: int

    @property
    def total(self) -> Tensor:
        """What is minimised."""
        return self.regression + self.objectness + self.classes


def yolo_loss(cfg: Cfg, maps: list[Tensor], truths: Tensor) -> Loss:
    """The loss of raw maps, one per head (B, A, 5 + C, rows, columns), against the ground truths.

    truths (T, 6): image in the batch, class, and the box relative to the image, cx, cy, w, h.
    Anchors are px of the network's input, whatever size the maps were computed at.
    """
    batch = len(maps[0])
    parts = torch.zeros(3, device=truths.device)
    n_rewritten = 0
    for head, raw in zip(yolo_heads(cfg), maps, strict=True):
        layer = cfg.layers[head.layer]
        losses, rewritten = _head_loss(head, layer, raw.float(), truths)
        parts = parts + losses / batch
        n_rewritten += rewritten
    return Loss(
        regression=parts[0],
        objectness=parts[1],
        classes=parts[2],
        n_ground_truths=len(truths),
        n_rewritten=n_rewritten,
    )


def darknet_loss(maps: Sequence[Tensor]) -> Tensor:
    """What Darknet prints as the loss of maps whose gradients are known."""
    squares = [raw.grad.square().sum() for raw in maps if raw.grad is not None]
    return torch.stack(squares).mean() * len(maps[0])


def _head_loss(head: YoloHead, options: Layer, raw: Tensor, truths: Tensor) -> tuple[Tensor, int]:
    """The three parts (3,), summed over the batch, and the number of rewritten ground truths."""
    rows, columns = raw.shape[3:]
    size = torch.tensor([columns, rows], device=raw.device) * head.stride  # of the input, px
    raw = raw.permute(0, 1, 3, 4, 2)  # (B, A, rows, columns, 5 + C)
    anchors = torch.as_tensor(head.anchors, dtype=raw.dtype, device=raw.device)

    cells, row = _assign(head, truths, size)
    iou, row_of_best = _best_ious(raw, head, truths)
    if (truth_thresh := options.number("truth_thresh", 1.0)) < 1:
        good = torch.nonzero(iou > truth_thresh, as_tuple=True)
        cells = tuple(torch.cat(both) for both in zip(cells, good, strict=True))
        row = torch.cat([row, row_of_best[good]])
    _, anchor, cell_y, cell_x = cells
    mine = truths[row]
    answer = raw[cells]  # (M, 5 + C)

    frac = mine[:, 2:4] * (size / head.stride) - torch.stack([cell_x, cell_y], 1)
    logs = torch.log(mine[:, 4:] * size / anchors[anchor])
    xy = functional.binary_cross_entropy_with_logits(answer[:, :2], frac, reduction="none")
    wh = (answer[:, 2:4] - logs).square() / 2
    weight = options.number("iou_normalizer", 0.75) * (2 - mine[:, 4] * mine[:, 5])
    regression = (weight[:, None] * (xy + wh)).sum()

    target = torch.zeros_like(raw[..., 4])
    target[cells] = 1
    confident = (raw[..., 5:].sigmoid() > CONFIDENT).any(dim=-1)
    ignored = (iou > options.number("ignore_thresh", 0.5)) & confident
    counted = ~ignored | (target > 0)
    objectness = functional.binary_cross_entropy_with_logits(
        raw[..., 4], target, weight=counted.to(raw.dtype), reduction="sum"
    )

    wanted = torch.zeros_like(raw[..., 5:])
    wanted[(*cells, mine[:, 1].long())] = 1
    answered = target > 0
    classes = functional.binary_cross_entropy_with_logits(
        raw[..., 5:][answered], wanted[answered], reduction="sum"
    )
    rewritten = len(mine) - int(target.sum())
    return torch.stack([regression, objectness, classes]), rewritten


def _assign(head: YoloHead, truths: Tensor, size: Tensor) -> tuple[tuple[Tensor, ...], Tensor]:
    """For the ground truths this head answers: cells (image, anchor, y, x), rows in truths."""
    every = torch.as_tensor(head.all_anchors, dtype=truths.dtype, device=truths.device)
    shape = truths[:, 4:] * size  # (T, 2) px
    shared = torch.minimum(shape[:, None], every[None]).prod(dim=2)
    iou = shared / (shape.prod(dim=1)[:, None] + every.prod(dim=1)[None] - shared)
    best = iou.argmax(dim=1)
    mask = torch.tensor(head.mask, device=truths.device)
    row, anchor = torch.nonzero(best[:, None] == mask[None], as_tuple=True)
    cells = (truths[row, 2:4] * (size / head.stride)).long()
    cells = torch.minimum(cells.clamp_min(0), size // head.stride - 1)
    return (truths[row, 0].long(), anchor, cells[:, 1], cells[:, 0]), row


@torch.no_grad()
def _best_ious(raw: Tensor, head: YoloHead, truths: Tensor) -> tuple[Tensor, Tensor]:
    """The best IoU of predictions (B, A, rows, columns) with a ground truth, and its row."""
    batch, _, rows, columns = raw.shape[:4]
    grid = head_grid(head, rows, columns, raw.device)
    centre, size = decode_boxes(raw, grid, head.scale_x_y)
    low, high = (centre - size / 2).flatten(1, 3), (centre + size / 2).flatten(1, 3)  # (B, P, 2)
    area = (high - low).prod(dim=-1)
    best = torch.zeros_like(area)
    row = torch.zeros_like(area, dtype=torch.long)
    by_image = truths[:, 0].argsort(stable=True)
    counts = torch.bincount(truths[:, 0].long(), minlength=batch)
    starts = counts.cumsum(0) - counts
    max_pairs = MAX_PAIRS_GPU if raw.is_cuda else MAX_PAIRS
    for images, most in _together(counts.tolist(), max_pairs // area.shape[1]):
        # a row of each image's ground truths, the last again and again where others have more
        nth = torch.arange(most, device=raw.device)
        nth = torch.minimum(nth[None], counts[images][:, None] - 1)
        mine = by_image[starts[images][:, None] + nth]  # (I, N)
        boxes = truths[mine, 2:]  # (I, N, 4)
        b_low, b_high = boxes[..., :2] - boxes[..., 2:] / 2, boxes[..., :2] + boxes[..., 2:] / 2
        shared = torch.ones((), device=raw.device)
        for axis in range(2):
            end = torch.minimum(high[images, :, None, axis], b_high[:, None, :, axis])
            begin = torch.maximum(low[images, :, None, axis], b_low[:, None, :, axis])
            shared = shared * (end - begin).clamp_(min=0)
        union = area[images, :, None] + boxes[..., 2:].prod(dim=-1)[:, None] - shared
        iou, which = (shared / union).max(dim=2)
        best[images] = iou.to(best)
        row[images] = mine.gather(1, which)
    return best.reshape(raw.shape[:4]), row.reshape(raw.shape[:4])


def _together(counts: Sequence[int], at_most: int) -> Iterator[tuple[list[int], int]]:
    """Images that have ground truths, in groups, and how many the one with the most has.

    That times the images is at most so many, but for a group of one.

    >>> list(_together([3, 0, 2, 9, 1], 6))
    [([0, 2], 3), ([3], 9), ([4], 1)]
    """
    images: list[int] = []
    most = 0
    for image in (image for image, count in enumerate(counts) if count):
        if images and (len(images) + 1) * max(most, counts[image]) > at_most:
            yield images, most
            images, most = [], 0
        images.append(image)
        most = max(most, counts[image])
    if images:
        yield images, most
