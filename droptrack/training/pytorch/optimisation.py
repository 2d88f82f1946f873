"""One gradient step of the PyTorch trainer: optimizer, learning rate, and the step itself."""

import math
from collections.abc import Iterator
from contextlib import nullcontext
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from droptrack.network.darknet_cfg import Cfg
from droptrack.network.torch_network import DarknetNetwork
from droptrack.training.pytorch.loss import darknet_loss, yolo_loss
from droptrack.training.pytorch.settings import TorchSettings

ADAMW_DECAY = 0.01
ADAMW_WARM_UP = 50  # one part in so many of the iterations
MAX_GRADIENT_NORM = 1000.0


def make_optimizer(
    network: DarknetNetwork, cfg: Cfg, settings: TorchSettings
) -> torch.optim.Optimizer:
    """As Darknet, weight decay acts on the kernels only, not on biases and batch normalisation."""
    kernels = [p for p in network.parameters() if p.ndim == 4]
    others = [p for p in network.parameters() if p.ndim != 4]
    adamw = settings.optimizer == "adamw"
    decay = ADAMW_DECAY if adamw else cfg.net.number("decay", 0.0001)
    groups = [{"params": kernels, "weight_decay": decay}, {"params": others, "weight_decay": 0}]
    if adamw:
        return torch.optim.AdamW(groups, lr=settings.learning_rate)
    momentum = cfg.net.number("momentum", 0.9)
    return torch.optim.SGD(groups, lr=settings.learning_rate, momentum=momentum)


def learning_rate(iteration: int, cfg: Cfg, settings: TorchSettings) -> float:
    """The rate of an iteration (from 1).

    sgd: Darknet's, rate * (n / burn_in)^power at first, then times each of ``scales`` after its of
    ``steps``. adamw: a linear start over 2 % of the iterations, then half a cosine to nothing.
    """
    if settings.optimizer == "adamw":
        start = max(1, settings.iterations // ADAMW_WARM_UP)
        progress = (iteration - start) / max(1, settings.iterations - start)
        ramp = min(1.0, iteration / start)
        return settings.learning_rate * ramp * (1 + math.cos(math.pi * max(0.0, progress))) / 2
    burn_in = cfg.net.integer("burn_in", 0)
    if iteration < burn_in:
        return float(settings.learning_rate * (iteration / burn_in) ** cfg.net.number("power", 4))
    steps, scales = cfg.net.numbers("steps", ()), cfg.net.numbers("scales", ())
    passed = [scale for step, scale in zip(steps, scales, strict=True) if iteration > step]
    return settings.learning_rate * float(np.prod(passed))


def gradient_step(
    model: nn.Module,
    network: DarknetNetwork,
    optimizer: torch.optim.Optimizer,
    batch: tuple[Tensor, Tensor],
    settings: TorchSettings,
) -> Tensor:
    """One gradient step on images (B, 3, H, W) uint8 and their ground truths (T, 6).

    The batch goes through `model`, the network or its copies on all devices, in `subdivisions`
    parts. Returns (6,): the number that Darknet prints as the loss (`Step`), the three parts of the
    loss, the share of rewritten ground truths, and 1 if all was finite. If not, no step is made:
    what is learnt until here stays intact.
    """
    model.train()
    if settings.frozen_statistics:  # those of a short training lag behind its weights
        for module in network.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
    device = next(network.parameters()).device
    optimizer.zero_grad(set_to_none=True)
    terms = torch.zeros(5, device=device)
    for part, last in _parts(*batch, settings.subdivisions):
        pixels, boxes = (tensor.to(device, non_blocking=True) for tensor in part)
        waits = isinstance(model, DistributedDataParallel) and not last
        with cast(DistributedDataParallel, model).no_sync() if waits else nullcontext():
            part_terms = _add_gradients(model, network.cfg, pixels, boxes, bf16=settings.bf16)
        terms += part_terms / settings.subdivisions
    for parameter in network.parameters():
        if parameter.grad is not None:
            parameter.grad /= settings.subdivisions
    norm = torch.nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT_NORM)
    finite = torch.isfinite(norm + terms.sum())
    if finite:
        optimizer.step()
    return torch.cat([terms, finite.float()[None]])


def _add_gradients(
    model: nn.Module, cfg: Cfg, pixels: Tensor, truths: Tensor, *, bf16: bool
) -> Tensor:
    """Add the gradients of a part of a batch; returns the first five terms of `gradient_step`."""
    inputs = (pixels.float() / 255).contiguous(memory_format=torch.channels_last)
    with torch.autocast(pixels.device.type, torch.bfloat16, enabled=bf16):
        maps = [raw.float() for raw in model(inputs)]
    for raw in maps:
        raw.retain_grad()
    loss = yolo_loss(cfg, maps, truths)
    loss.total.backward()  # type: ignore[no-untyped-call]
    rewritten = loss.regression.new_tensor(loss.n_rewritten / max(1, loss.n_ground_truths))
    numbers = [darknet_loss(maps), loss.regression, loss.objectness, loss.classes, rewritten]
    return torch.stack(numbers).detach()


def _parts(
    images: Tensor, truths: Tensor, count: int
) -> Iterator[tuple[tuple[Tensor, Tensor], bool]]:
    """Equal parts of a batch, and whether each is the last."""
    size = len(images) // count
    for start in range(0, len(images), size):
        mine = truths[(truths[:, 0] >= start) & (truths[:, 0] < start + size)].clone()
        mine[:, 0] -= start
        yield (images[start : start + size], mine), start + size >= len(images)
