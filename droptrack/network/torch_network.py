"""A Darknet ``.cfg`` as a PyTorch module, filled from and dumped to ``.weights`` values."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import (
    BATCH_NORM_EPSILON,
    LEAKY_SLOPE,
    MAX_LOG_SIZE,
    Cfg,
    Convolution,
    Layer,
    YoloHead,
    convolution_padding,
    convolutions,
    pool_options,
    route_sources,
    yolo_heads,
)

# how far the rolling means move with a batch: Darknet has 0.01, but trainings on a CPU are short
BATCH_NORM_MOMENTUM = 0.03


class MaxPool(nn.Module):
    """Darknet's max-pooling: pads size - 1 cells of minus infinity, the odd one right and below."""

    def __init__(self, size: int, stride: int, padding: int) -> None:
        super().__init__()
        self.size, self.stride = size, stride
        self.before, self.after = padding // 2, padding - padding // 2

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C, H', W'), H' = (H + padding - size) / stride + 1."""
        if self.stride != self.size or x.shape[2] % self.size or x.shape[3] % self.size:
            sides = (self.before, self.after, self.before, self.after)
            x = functional.pad(x, sides, value=float("-inf"))
        return functional.max_pool2d(x, self.size, self.stride)


class DarknetNetwork(nn.Module):
    """The network of a ``.cfg``; `forward` gives the raw maps of its ``[yolo]`` heads."""

    def __init__(self, cfg: Cfg) -> None:
        super().__init__()
        self.cfg = cfg
        self.heads = yolo_heads(cfg)
        shapes = {convolution.layer: convolution for convolution in convolutions(cfg)}
        self.layers = nn.ModuleList(
            _module(layer, shapes.get(index)) for index, layer in enumerate(cfg.layers)
        )
        self.sources = [
            route_sources(layer, index) if layer.kind in ("route", "shortcut") else []
            for index, layer in enumerate(cfg.layers)
        ]

    def forward(self, images: Tensor) -> list[Tensor]:
        """Images (B, 3, H, W), RGB in [0, 1] -> per head (B, A, 5 + classes, H/stride, W/stride).

        The maps hold logits as Darknet's convolutions leave them: x, y, w, h, objectness, classes.
        """
        outputs: list[Tensor] = []
        maps: list[Tensor] = []
        x = images
        for layer, module, sources in zip(self.cfg.layers, self.layers, self.sources, strict=True):
            if layer.kind == "route":
                groups, group = layer.integer("groups", 1), layer.integer("group_id", 0)
                parts = [outputs[source].chunk(groups, dim=1)[group] for source in sources]
                x = torch.cat(parts, dim=1)
            elif layer.kind == "shortcut":
                x = x + outputs[sources[0]]
            elif layer.kind == "yolo":
                batch, channels, rows, columns = x.shape
                anchors = len(self.heads[len(maps)].mask)
                maps.append(x.reshape(batch, anchors, channels // anchors, rows, columns))
            else:
                x = module(x)
            outputs.append(x)
        return maps


class Grid(NamedTuple):
    """Where the predictions of a head lie: what `decode_boxes` needs besides the logits."""

    corner: Tensor  # (rows, columns, 2), of each cell, in cells
    cells: Tensor  # (2,): columns, rows
    anchors: Tensor  # (A, 1, 1, 2), relative to the input


def head_grid(head: YoloHead, rows: int, columns: int, device: torch.device | None = None) -> Grid:
    """The grid of a head, for maps of rows x columns cells."""
    row, column = torch.meshgrid(
        torch.arange(rows, device=device), torch.arange(columns, device=device), indexing="ij"
    )
    corner = torch.stack([column, row], 2) - (head.scale_x_y - 1) / 2
    relative = head.anchors / [columns * head.stride, rows * head.stride]
    anchors = torch.tensor(relative, dtype=torch.float32, device=device)[:, None, None]
    return Grid(corner.float(), torch.tensor([columns, rows], device=device).float(), anchors)


def decode_boxes(logits: Tensor, grid: Grid, scale_x_y: float) -> tuple[Tensor, Tensor]:
    """Centres and sizes (B, A, rows, columns, 2), relative to the image (YOLOv3, section 2.1).

    Of logits (B, A, rows, columns, 5 + C), as `decoding.decode_head` has them of arrays.
    """
    centre = (logits[..., :2].sigmoid() * scale_x_y + grid.corner) / grid.cells
    size = logits[..., 2:4].clamp(max=MAX_LOG_SIZE).exp() * grid.anchors
    return centre, size


def _module(layer: Layer, convolution: Convolution | None) -> nn.Module:
    if convolution is not None:
        return _convolution(layer, convolution)
    if layer.kind == "maxpool":
        return MaxPool(*pool_options(layer))
    if layer.kind == "upsample":
        return nn.Upsample(scale_factor=layer.integer("stride", 2), mode="nearest")
    return nn.Identity()  # route, shortcut and yolo: done in forward


def _convolution(layer: Layer, shape: Convolution) -> nn.Sequential:
    groups = layer.integer("groups", 1)
    convolution = nn.Conv2d(
        shape.inputs * groups,
        shape.outputs,
        shape.size,
        layer.integer("stride", 1),
        convolution_padding(layer),
        groups=groups,
        bias=not shape.batch_normalize,
    )
    parts: list[nn.Module] = [convolution]
    if shape.batch_normalize:
        parts.append(nn.BatchNorm2d(shape.outputs, BATCH_NORM_EPSILON, BATCH_NORM_MOMENTUM))
    activation = layer.text("activation", "logistic")
    if activation == "leaky":
        parts.append(nn.LeakyReLU(LEAKY_SLOPE, inplace=True))
    elif activation == "mish":
        parts.append(nn.Mish(inplace=True))
    elif activation != "linear":
        raise DroptrackError(f"line {layer.line}: activation={activation} is not supported")
    return nn.Sequential(*parts)


def _file_order(network: DarknetNetwork) -> list[Tensor]:
    """The tensors that a ``.weights`` file holds, in its order."""
    tensors: list[Tensor | None] = []
    for module in network.layers:
        if not isinstance(module, nn.Sequential):
            continue
        convolution = module[0]
        assert isinstance(convolution, nn.Conv2d)
        if len(module) > 1 and isinstance(norm := module[1], nn.BatchNorm2d):
            tensors += [norm.bias, norm.weight, norm.running_mean, norm.running_var]
        else:
            tensors.append(convolution.bias)
        tensors.append(convolution.weight)
    return [tensor for tensor in tensors if tensor is not None]


def load_values(network: DarknetNetwork, values: NDArray[np.float32]) -> None:
    """Fill the network from the values (P,) of a ``.weights`` file that fits its cfg."""
    start = 0
    with torch.no_grad():
        for tensor in _file_order(network):
            part = values[start : start + tensor.numel()].astype(np.float32)
            tensor.copy_(torch.from_numpy(part).reshape(tensor.shape))
            start += tensor.numel()
    if start != len(values):
        raise ValueError(f"the network has {start} values, not {len(values)}")


def dump_values(network: DarknetNetwork) -> NDArray[np.float32]:
    """The values (P,) of the network in the order of a ``.weights`` file."""
    parts = [tensor.detach().cpu().contiguous().reshape(-1) for tensor in _file_order(network)]
    return np.asarray(torch.cat(parts).numpy(), np.float32)
