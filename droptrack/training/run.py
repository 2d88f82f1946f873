"""One training from its checks to its end: choice of the trainer, run folder, progress."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from droptrack.data.darknet_dataset import DataSet, read_data_file
from droptrack.data.files import write_text
from droptrack.errors import DroptrackError
from droptrack.evaluation.network_scores import mean_average_precision
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, with_options
from droptrack.network.darknet_weights import read_start
from droptrack.progress import progress_bar
from droptrack.training.checks import (
    check_for_darknet,
    check_for_torch,
    check_images,
    check_network,
    check_window,
)
from droptrack.training.config import DrawImage, Trainer, TrainingConfig, TrainingPrecision
from droptrack.training.darknet.binary import (
    Darknet,
    DarknetSettings,
    find_darknet,
    furthest_weights,
    identify,
)
from droptrack.training.darknet.training import DarknetTraining
from droptrack.training.log import Step, write_run_file


@dataclass(frozen=True)
class TrainingRun:
    """A training that is ready to start: the cfg in its run folder, what trains, and its steps."""

    network: Cfg
    about: Mapping[str, object]
    steps: Generator[Step, None, None]


def train(config: TrainingConfig, say: Callable[[str], None] = lambda _: None) -> float:
    """Train a network on a Darknet data set, with a progress bar; returns the best mAP@0.50.

    `say` is told what trains. The run folder gets the ``.cfg`` as trained, training.csv and
    training.png, run.json, and the weights ``<cfg>_last``, ``_best`` and ``_final``; of Darknet
    also its data file and darknet.log. Raises DroptrackError for what cannot be trained, before it
    starts, for a training that fails, and, with what to do next, for one that is interrupted.
    """
    run = prepare(config)
    say(f"{config.out}: training with {run.about['trainer']}")
    return _show(run)


def prepare(config: TrainingConfig) -> TrainingRun:
    """Check all that a training needs, and make its run folder. Raises DroptrackError."""
    network = effective_cfg(config)
    data = read_data_file(config.data)
    check_network(network, data)
    check_images(network, data)
    if config.weights is not None:
        read_start(config.weights, network)
    binary = _choose(config)
    if binary is None:
        run = _prepare_torch(config, network, data)
    else:
        run = _prepare_darknet(config, network, data, binary)
    write_run_file(config.out, run.about)
    return run


def effective_cfg(config: TrainingConfig) -> Cfg:
    """The ``.cfg`` with the changes of a configuration."""
    changes = {
        "max_batches": config.iterations,
        "batch": config.batch,
        "subdivisions": config.subdivisions,
        "learning_rate": config.learning_rate,
    }
    changed = {key: f"{value}" for key, value in changes.items() if value}
    return with_options(read_cfg(config.cfg), changed, {})


def _choose(config: TrainingConfig) -> Darknet | None:
    """The Darknet that is to train, or None for PyTorch."""
    only_torch = config.only_torch()
    if config.trainer is Trainer.torch or (config.trainer is Trainer.auto and only_torch):
        return None
    if only_torch:
        raise DroptrackError(f"{only_torch[0]}: only PyTorch can do this: --trainer torch")
    path = find_darknet(config.darknet)
    if path is None and config.trainer is Trainer.darknet:
        raise DroptrackError("--trainer darknet: found none; name it: --darknet FILE, or $DARKNET")
    return None if path is None else identify(path)


def _prepare_darknet(
    config: TrainingConfig, network: Cfg, data: DataSet, binary: Darknet
) -> TrainingRun:
    check_for_darknet(network, data, config.out)
    network = make_run_folder(config.out, network, resume=config.resume)
    settings = DarknetSettings(
        gpus=config.gpus,
        save_every=config.save_every,
        map_every=config.map_every,
        patience=config.patience,
        hang_seconds=config.hang_minutes * 60,
    )

    def score(weights: Path) -> float:
        return mean_average_precision(network, weights, data.valid[: config.map_images])

    training = DarknetTraining(binary, network, data, config.out, settings, score)
    about = {**binary.about(), **asdict(settings)}
    return TrainingRun(network, about, training.steps(config.weights, config.resume))


def _prepare_torch(config: TrainingConfig, network: Cfg, data: DataSet) -> TrainingRun:
    if find_spec("torch") is None:
        raise DroptrackError(
            "found no Darknet (--darknet, $DARKNET, PATH), and no PyTorch: "
            "pip install 'droptrack[train]'"
        )
    from droptrack.training.pytorch.devices import choose_devices, machine
    from droptrack.training.pytorch.settings import Job, TorchSettings
    from droptrack.training.pytorch.training import train as train_with_torch

    check_for_torch(network)
    check_window(config.window)
    net = network.net
    batch, subdivisions = net.integer("batch"), net.integer("subdivisions", 1)
    settings = TorchSettings(
        iterations=net.integer("max_batches"),
        batch=batch,
        subdivisions=subdivisions,
        optimizer=config.optimizer.value,
        learning_rate=net.number("learning_rate"),
        window=config.window,
        sizes=config.sizes,
        seed=config.seed,
        workers=config.workers,
        save_every=config.save_every,
        map_every=config.map_every,
        map_images=config.map_images,
        patience=config.patience,
        devices=choose_devices(config.gpus, batch, subdivisions),
        bf16=config.precision is TrainingPrecision.bf16,
        frozen_statistics=config.frozen_statistics,
        droplets=config.droplets,
        negatives=config.negatives,
    )
    draw = image_source(config.draw) if config.draw else None
    network = make_run_folder(config.out, network, resume=config.resume)
    job = Job(
        cfg=network,
        data=data,
        out=config.out,
        settings=settings,
        start=config.weights,
        resume=config.resume,
        draw=draw,
    )
    return TrainingRun(network, {**machine(), **asdict(settings)}, train_with_torch(job))


def image_source(scene: str) -> DrawImage:
    """Draws images of a scene; a package that can do so says so by an entry point."""
    for source in entry_points(group="droptrack.pictures"):
        drawn: DrawImage = source.load()(scene)
        return drawn
    raise DroptrackError("--draw: nothing is installed that draws images; install data_gen")


def make_run_folder(out: Path, network: Cfg, *, resume: bool) -> Cfg:
    """Make the run folder, never over another; returns the cfg as it lies there."""
    if out.exists() and any(out.iterdir()) and not resume:
        raise DroptrackError(f"{out}: is not empty; choose another --out, or resume with --resume")
    if resume and not out.exists():
        raise DroptrackError(f"{out}: does not exist; start without --resume")
    out.mkdir(parents=True, exist_ok=True)
    path = out / network.path.name
    write_text(path, cfg_text(network))
    return read_cfg(path)


def _show(run: TrainingRun) -> float:
    """Train to the end on a progress bar; returns the best mAP."""
    out, total = run.network.path.parent, run.network.net.integer("max_batches")
    best = last = float("nan")
    with progress_bar("iterations") as progress:
        task = progress.add_task(run.network.path.stem, total=total, note="")
        try:
            for step in run.steps:
                if step.mean_ap == step.mean_ap:
                    last, best = step.mean_ap, np.fmax(best, step.mean_ap)
                note = (
                    f"loss {step.average_loss:.3f} mAP {last:.4f} best {best:.4f} rate "
                    f"{step.learning_rate:.2g} {step.images} images"
                )
                progress.update(task, completed=step.iteration, note=note)
        except KeyboardInterrupt:
            run.steps.close()
            found = furthest_weights(out, run.network)
            if found is None:
                raise DroptrackError(
                    f"{out}: interrupted before the first snapshot; start again, in another --out"
                ) from None
            raise DroptrackError(
                f"{out}: interrupted; --resume resumes from iteration {found[1]}"
            ) from None
    return float(best)
