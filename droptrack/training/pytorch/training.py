"""Training without Darknet: a ``.cfg`` and a Darknet data set -> ``.weights``, with PyTorch."""

import math
import signal
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader

from droptrack.errors import DroptrackError
from droptrack.interrupts import signals_held, whole
from droptrack.network.darknet_weights import read_start
from droptrack.network.torch_network import DarknetNetwork, dump_values, load_values
from droptrack.training.log import Step, TrainingLog, diverged, running_average
from droptrack.training.pytorch.checkpoint import restore, save_checkpoint, save_weights
from droptrack.training.pytorch.devices import mean_over_ranks, other_ranks
from droptrack.training.pytorch.images import (
    Augmentation,
    Batches,
    TrainingImages,
    collate,
    quiet_worker,
    share_by_files,
)
from droptrack.training.pytorch.memory import memory_kept
from droptrack.training.pytorch.optimisation import gradient_step, learning_rate, make_optimizer
from droptrack.training.pytorch.settings import Job
from droptrack.training.pytorch.validation import mean_average_precision

BATCHES_AHEAD = 4  # that each worker prepares


def train(job: Job) -> Generator[Step, None, None]:
    """Train and yield after each iteration; all files go into the folder `out` of the job.

    By the cfg's stem: ``_last.weights`` and ``_checkpoint.pt`` every `save_every` iterations and
    whenever the training stops, ``_best.weights`` at the best mAP, ``_final.weights`` at the end;
    ``training.csv`` and ``training.png``. Raises DroptrackError when the loss diverges.
    """
    others = other_ranks(job.settings.devices, job.settings.workers, _train_along, job)
    with memory_kept(), others:
        yield from _lead(job)


def _train_along(job: Job, rank: int) -> None:
    """Train on a device that is not the first."""
    with _short_errors():
        for _ in Learner(job, rank).iterations():
            pass


def _lead(job: Job) -> Generator[Step, None, None]:
    """Train on the first device, which also measures, saves and logs."""
    settings, learner = job.settings, Learner(job, 0)
    done = learner.first  # iterations that the log has: one that is interrupted is done again
    began = time.perf_counter()
    with TrainingLog(job.out, done) as log, _short_errors():
        try:
            for trained in learner.iterations():
                mean_ap = _mean_ap(learner, log, trained.iteration)
                now = time.perf_counter()
                step = Step(
                    iteration=trained.iteration,
                    loss=trained.loss,
                    average_loss=running_average(log.average_loss, trained.loss),
                    regression=trained.regression,
                    objectness=trained.objectness,
                    classes=trained.classes,
                    rewritten=trained.rewritten,
                    learning_rate=trained.learning_rate,
                    seconds=now - began,
                    images=trained.iteration * settings.batch,
                    mean_ap=mean_ap,
                )
                began = now
                with whole():  # so that the log and what is saved agree
                    log.append(step)
                    done = step.iteration
                if done % settings.save_every == 0:
                    learner.save_last(done)
                yield step
                if not trained.finite:
                    raise diverged(job.out, step)
                if log.is_stale(settings.patience):
                    break
            learner.save("final", done)
        finally:
            learner.save_last(done)


@dataclass(frozen=True, kw_only=True)
class Trained:
    """What an iteration did, as a mean over all devices; see `Step`."""

    iteration: int
    learning_rate: float
    loss: float
    regression: float
    objectness: float
    classes: float
    rewritten: float
    finite: bool


class Learner:
    """The network on one device, and what trains it with this device's share of the batches."""

    def __init__(self, job: Job, rank: int) -> None:
        settings = job.settings
        torch.manual_seed(settings.seed)
        share_by_files()
        self.job, self.rank = job, rank
        self.device = torch.device(settings.devices[rank])
        self.network = DarknetNetwork(job.cfg).to(self.device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        if job.start is not None:
            values = dump_values(self.network)
            start = read_start(job.start, job.cfg).values
            values[: len(start)] = start
            load_values(self.network, values)
        self.optimizer = make_optimizer(self.network, job.cfg, settings)
        self.first = 0  # iterations done before
        if job.resume:
            self.first = restore(job.file("checkpoint.pt"), self.network, self.optimizer)
        together = len(settings.devices) > 1
        self.model: nn.Module = DistributedDataParallel(self.network) if together else self.network

    def iterations(self) -> Iterator[Trained]:
        """Train to the end, one iteration after the other."""
        cfg, settings = self.job.cfg, self.job.settings
        with signals_held(signal.SIGINT, signal.SIGTERM):
            batches = iter(self._batches())
        for iteration, batch in enumerate(batches, start=self.first + 1):
            rate = learning_rate(iteration, cfg, settings)
            for group in self.optimizer.param_groups:
                group["lr"] = rate
            terms = gradient_step(self.model, self.network, self.optimizer, batch, settings)
            loss, regression, objectness, classes, rewritten, finite = mean_over_ranks(terms)
            yield Trained(
                iteration=iteration,
                learning_rate=rate,
                loss=loss,
                regression=regression,
                objectness=objectness,
                classes=classes,
                rewritten=rewritten,
                finite=finite == 1,
            )

    def _batches(self) -> DataLoader[Any]:
        """The device's share of each batch that is left: images and ground truths, `collate`."""
        job, settings = self.job, self.job.settings
        augmentation = replace(
            Augmentation.of(job.cfg, settings.window, settings.sizes),
            droplets=settings.droplets,
            negatives=settings.negatives,
        )
        return DataLoader(
            TrainingImages(job.data, augmentation, job.draw),
            batch_sampler=Batches(
                len(job.data.train),
                settings.batch,
                self.first,
                settings.iterations,
                settings.seed,
                augmentation.random,
                share=(self.rank, len(settings.devices)),
            ),
            num_workers=settings.workers,
            # a fork of a process that has threads may wait for ever for one of their locks
            multiprocessing_context="spawn" if settings.workers else None,
            collate_fn=collate,
            worker_init_fn=quiet_worker,
            pin_memory=self.device.type == "cuda",
            prefetch_factor=BATCHES_AHEAD if settings.workers else None,
        )

    def save(self, name: str, iteration: int) -> None:
        """Write the weights, which have done so many iterations, to ``<cfg>_<name>.weights``."""
        path = self.job.file(f"{name}.weights")
        save_weights(path, self.network, iteration * self.job.settings.batch)

    def save_last(self, iteration: int) -> None:
        """Write what an interrupted training resumes from, and its weights."""
        self.save("last", iteration)
        save_checkpoint(self.job.file("checkpoint.pt"), self.network, self.optimizer, iteration)


def _mean_ap(learner: Learner, log: TrainingLog, iteration: int) -> float:
    """The mAP after an iteration, NaN if none is due then; saves the weights if it is the best."""
    job, settings = learner.job, learner.job.settings
    if iteration % settings.map_every and iteration != settings.iterations:
        return math.nan
    images = job.data.valid[: settings.map_images]
    mean_ap = mean_average_precision(learner.network, images, bf16=settings.bf16)
    if mean_ap > max(log.mean_aps, default=0.0):
        learner.save("best", iteration)
    return mean_ap


@contextmanager
def _short_errors() -> Iterator[None]:
    """The error of a process that prepares images comes wrapped in its traceback: unwrap it."""
    try:
        yield
    except DroptrackError as error:
        last = str(error).strip().splitlines()[-1]
        raise DroptrackError(last.removeprefix("droptrack.DroptrackError: ")) from None
