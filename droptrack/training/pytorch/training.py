"""Training without Darknet: a ``.cfg`` and a Darknet data set -> ``.weights``, with PyTorch."""

import math
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader

from droptrack.data.darknet_dataset import DataSet, read_ground_truth, read_image
from droptrack.data.detections import Detections
from droptrack.data.files import replacing
from droptrack.detection.decoding import decode_head, select
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import MAX_IOU, MIN_SCORE, average_precision
from droptrack.network.darknet_cfg import Cfg
from droptrack.network.darknet_weights import WEIGHTS_VERSION, Weights, read_weights, write_weights
from droptrack.network.torch_network import DarknetNetwork, dump_values, load_values
from droptrack.training.log import Step, TrainingLog, running_average
from droptrack.training.pytorch.devices import (
    leave_signals_to_the_first_process,
    mean_over_ranks,
    other_ranks,
)
from droptrack.training.pytorch.loss import yolo_loss
from droptrack.training.pytorch.pictures import (
    Augmentation,
    Batches,
    DrawPicture,
    TrainingPictures,
    collate,
)

NAN = float("nan")


@dataclass(frozen=True)
class Settings:
    """How to train, beside what the ``.cfg`` says."""

    iterations: int  # batches in all
    batch: int  # pictures an iteration, over all devices
    subdivisions: int  # parts that a device's share of a batch is computed in
    optimizer: str  # "sgd": Darknet's, by the cfg; "adamw": less iterations, half a cosine
    learning_rate: float
    window: tuple[int, int] | None  # see Augmentation
    sizes: tuple[float, float] | None  # range of the factor on the network's size
    seed: int
    workers: int  # processes a device that prepare pictures
    save_every: int  # iterations between checkpoints
    map_every: int  # iterations between measurements of the mAP
    map_images: int  # validation pictures they use
    patience: int  # mAPs without a new best that end the training; 0: never
    devices: tuple[str, ...]  # one process each: ("cuda:0", "cuda:1")
    bf16: bool  # the network computes in bfloat16; weights, gradients and loss are float32


@dataclass(frozen=True)
class Job:
    """What to train on what.

    `start`: weights to begin from. With `resume`, goes on from the checkpoint in `out`. `draw`
    makes the training pictures instead of the data set.
    """

    cfg: Cfg
    data: DataSet
    out: Path
    settings: Settings
    start: Path | None = None
    resume: bool = False
    draw: DrawPicture | None = None


def train(job: Job) -> Generator[Step, None, None]:
    """Train and yield after each iteration; all files go into the folder `out` of the job.

    By the cfg's stem: ``_last.weights`` and ``_checkpoint.pt`` every `save_every` iterations and
    whenever the training stops, ``_best.weights`` at the best mAP, ``_final.weights`` at the end;
    ``training.csv`` and ``training.png``. Raises DroptrackError when the loss is no number.
    """
    with other_ranks(job.settings.devices, job.settings.workers, _train_along, job):
        yield from _train(job, 0)


def _train_along(job: Job, rank: int) -> None:
    for _ in _train(job, rank):
        pass


def _train(job: Job, rank: int) -> Generator[Step, None, None]:
    """The training loop of one device. Rank 0 also measures, saves and logs."""
    cfg, data, out, settings = job.cfg, job.data, job.out, job.settings
    torch.manual_seed(settings.seed)
    torch.multiprocessing.set_sharing_strategy("file_system")  # type: ignore[no-untyped-call]
    device = torch.device(settings.devices[rank])
    network = DarknetNetwork(cfg).to(device)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    if job.start is not None:
        load_values(network, read_weights(job.start, cfg).values)
    optimizer = _optimizer(network, cfg, settings)
    checkpoint = out / f"{cfg.path.stem}_checkpoint.pt"
    first = _restore(checkpoint, network, optimizer) if job.resume else 0
    model: nn.Module = network
    if len(settings.devices) > 1:
        model = DistributedDataParallel(network)

    augmentation = Augmentation.of(cfg, settings.window, settings.sizes)
    loader = DataLoader(
        TrainingPictures(data, augmentation, job.draw),
        batch_sampler=Batches(
            len(data.train),
            settings.batch,
            first,
            settings.iterations,
            settings.seed,
            augmentation.random,
            (rank, len(settings.devices)),
        ),
        num_workers=settings.workers,
        collate_fn=collate,
        worker_init_fn=_quiet_worker,
        pin_memory=device.type == "cuda",
        prefetch_factor=4 if settings.workers else None,
    )

    def save(iteration: int, name: str) -> None:
        _save_weights(network, out / f"{cfg.path.stem}_{name}.weights", iteration * settings.batch)

    done = first  # iterations that the log has: one that is broken off is done again
    began = time.perf_counter()
    with TrainingLog(out, first) if rank == 0 else nullcontext() as log:
        try:
            for iteration, (images, truths) in enumerate(loader, start=first + 1):
                rate = learning_rate(iteration, cfg, settings)
                for group in optimizer.param_groups:
                    group["lr"] = rate
                terms = _step(model, network, optimizer, images, truths, settings)
                loss, regression, objectness, classes, rewritten, finite = mean_over_ranks(terms)
                if log is None:
                    continue
                mean_ap = NAN
                if iteration % settings.map_every == 0 or iteration == settings.iterations:
                    mean_ap = validation_map(network, data.valid[: settings.map_images])
                    if mean_ap > max(log.mean_aps, default=0.0):
                        save(iteration, "best")
                now = time.perf_counter()
                step = Step(
                    iteration,
                    loss,
                    running_average(log.average_loss, loss),
                    regression,
                    objectness,
                    classes,
                    rewritten,
                    rate,
                    now - began,
                    iteration * settings.batch,
                    mean_ap,
                )
                began = now
                log.append(step)
                done = iteration
                if done % settings.save_every == 0:
                    save(done, "last")
                    _save_checkpoint(checkpoint, network, optimizer, done)
                yield step
                if finite < 1:
                    raise DroptrackError(
                        f"{out}: the loss or its gradient is no number any more at iteration "
                        f"{iteration}, at a rate of {rate:g}; start again, in another --out, with "
                        "a smaller --learning-rate"
                    )
                if log.is_stale(settings.patience):
                    break
            if rank == 0:
                save(done, "final")
        except DroptrackError as error:  # a worker's comes wrapped in its traceback
            last = str(error).strip().splitlines()[-1]
            raise DroptrackError(last.removeprefix("droptrack.DroptrackError: ")) from None
        finally:
            if rank == 0:
                save(done, "last")
                _save_checkpoint(checkpoint, network, optimizer, done)


def _step(
    model: nn.Module,
    network: DarknetNetwork,
    optimizer: torch.optim.Optimizer,
    images: Tensor,
    truths: Tensor,
    settings: Settings,
) -> Tensor:
    """One gradient step on images (B, 3, H, W) uint8 and truths (T, 6).

    The batch goes through the network in `subdivisions` parts. Returns (6,): the number that
    Darknet prints as the loss (`Step`), the three parts of the loss, the share of rewritten truths,
    and 1 if all was finite. If not, no step is made: what is learnt until here stays intact.
    """
    model.train()
    device = next(network.parameters()).device
    optimizer.zero_grad(set_to_none=True)
    terms = torch.zeros(5, device=device)
    for part, last in _parts(images, truths, settings.subdivisions):
        pixels, boxes = (tensor.to(device, non_blocking=True) for tensor in part)
        inputs = (pixels.float() / 255).contiguous(memory_format=torch.channels_last)
        waits = isinstance(model, DistributedDataParallel) and not last
        with cast(DistributedDataParallel, model).no_sync() if waits else nullcontext():
            with torch.autocast(device.type, torch.bfloat16, enabled=settings.bf16):
                maps = [raw.float() for raw in model(inputs)]
            for raw in maps:
                raw.retain_grad()
            loss = yolo_loss(network.cfg, maps, boxes)
            loss.total.backward()  # type: ignore[no-untyped-call]
        rewritten = loss.regression.new_tensor(loss.n_rewritten / max(1, loss.n_truths))
        numbers = [darknet_loss(maps), loss.regression, loss.objectness, loss.classes, rewritten]
        terms += torch.stack(numbers).detach() / settings.subdivisions
    for parameter in network.parameters():
        if parameter.grad is not None:
            parameter.grad /= settings.subdivisions
    norm = torch.nn.utils.clip_grad_norm_(network.parameters(), 1000.0)
    finite = torch.isfinite(norm + terms.sum())
    if finite:
        optimizer.step()
    return torch.cat([terms, finite.float()[None]])


def _parts(
    images: Tensor, truths: Tensor, count: int
) -> Iterator[tuple[tuple[Tensor, Tensor], bool]]:
    """Equal parts of a batch, and whether each is the last."""
    size = len(images) // count
    for start in range(0, len(images), size):
        mine = truths[(truths[:, 0] >= start) & (truths[:, 0] < start + size)].clone()
        mine[:, 0] -= start
        yield (images[start : start + size], mine), start + size >= len(images)


def darknet_loss(maps: Sequence[Tensor]) -> Tensor:
    """What Darknet prints as the loss of maps whose gradients are known."""
    squares = [raw.grad.square().sum() for raw in maps if raw.grad is not None]
    return torch.stack(squares).mean() * len(maps[0])


def learning_rate(iteration: int, cfg: Cfg, settings: Settings) -> float:
    """The rate of an iteration (from 1).

    sgd: Darknet's, rate * (n / burn_in)^power at first, then times each of ``scales`` after its of
    ``steps``. adamw: a linear start over 2 % of the iterations, then half a cosine to nothing.
    """
    if settings.optimizer == "adamw":
        start = max(1, settings.iterations // 50)
        progress = (iteration - start) / max(1, settings.iterations - start)
        ramp = min(1.0, iteration / start)
        return settings.learning_rate * ramp * (1 + math.cos(math.pi * max(0.0, progress))) / 2
    burn_in = cfg.net.integer("burn_in", 0)
    if iteration < burn_in:
        return float(settings.learning_rate * (iteration / burn_in) ** cfg.net.number("power", 4))
    steps, scales = cfg.net.numbers("steps", ()), cfg.net.numbers("scales", ())
    passed = [scale for step, scale in zip(steps, scales, strict=True) if iteration > step]
    return settings.learning_rate * float(np.prod(passed))


def _optimizer(network: DarknetNetwork, cfg: Cfg, settings: Settings) -> torch.optim.Optimizer:
    """As Darknet, weight decay acts on the kernels only, not on biases and batch normalisation."""
    kernels = [p for p in network.parameters() if p.ndim == 4]
    others = [p for p in network.parameters() if p.ndim != 4]
    if settings.optimizer == "adamw":
        groups = [{"params": kernels, "weight_decay": 0.01}, {"params": others, "weight_decay": 0}]
        return torch.optim.AdamW(groups, lr=settings.learning_rate)
    decay = cfg.net.number("decay", 0.0001)
    return torch.optim.SGD(
        [{"params": kernels, "weight_decay": decay}, {"params": others, "weight_decay": 0}],
        lr=settings.learning_rate,
        momentum=cfg.net.number("momentum", 0.9),
    )


def validation_map(network: DarknetNetwork, images: Sequence[Path]) -> float:
    """mAP@0.50 by Darknet's definition (scores above 0.005, suppression at 0.45) on images."""
    return average_precision(_validate(network, images)).average_precision


@torch.no_grad()
def _validate(
    network: DarknetNetwork, images: Sequence[Path]
) -> Iterator[tuple[Detections, Detections]]:
    network.eval()
    device = next(network.parameters()).device
    size = (network.cfg.width, network.cfg.height)
    for path in images:
        image = read_image(path)
        height, width = image.shape[:2]
        rgb = np.ascontiguousarray(cv2.resize(image, size)[..., ::-1])
        inputs = torch.from_numpy(rgb).to(device).permute(2, 0, 1)[None].float() / 255
        with torch.autocast(device.type, torch.bfloat16):
            maps = network(inputs.contiguous(memory_format=torch.channels_last))
        rows = [
            decode_head(raw[0].float().cpu().numpy(), head, MIN_SCORE)
            for raw, head in zip(maps, network.heads, strict=True)
        ]
        found = select(np.concatenate(rows), width, height, MIN_SCORE, MAX_IOU, greedy=True)
        yield found, read_ground_truth(path, width, height)


def _quiet_worker(_: int) -> None:
    """One thread a worker."""
    leave_signals_to_the_first_process()
    cv2.setNumThreads(1)


def _save_weights(network: DarknetNetwork, path: Path, seen: int) -> None:
    write_weights(path, Weights(WEIGHTS_VERSION, seen, dump_values(network)))


def _save_checkpoint(
    path: Path,
    network: DarknetNetwork,
    optimizer: torch.optim.Optimizer,
    iteration: int,
) -> None:
    state = {
        "network": network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "iteration": iteration,
    }
    with replacing(path) as partial:
        torch.save(state, partial)


def _restore(path: Path, network: DarknetNetwork, optimizer: torch.optim.Optimizer) -> int:
    if not path.exists():
        raise DroptrackError(f"{path}: no checkpoint to resume from; start without --resume")
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
    except (RuntimeError, KeyError, ValueError, EOFError) as error:
        reason = str(error).splitlines()[0]
        raise DroptrackError(f"{path}: is no checkpoint of this network: {reason}") from None
    return int(state["iteration"])
