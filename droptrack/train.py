"""Command: train a network, ``python -m droptrack.train``."""

import os
import signal
from collections.abc import Callable, Generator, Mapping
from dataclasses import asdict
from enum import StrEnum
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import read_data_file
from droptrack.errors import DroptrackError
from droptrack.evaluation.network_scores import mean_average_precision
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, with_options
from droptrack.network.darknet_weights import read_weights
from droptrack.progress import progress_bar
from droptrack.training.checks import (
    check_for_darknet,
    check_for_torch,
    check_network,
    check_pictures,
)
from droptrack.training.darknet.binary import (
    Darknet,
    DarknetSettings,
    find_darknet,
    furthest_weights,
    identify,
)
from droptrack.training.darknet.training import DarknetTraining
from droptrack.training.log import Step, write_run_file


class Trainer(StrEnum):
    """What does the training."""

    darknet = "darknet"
    torch = "torch"
    auto = "auto"


class Optimizer(StrEnum):
    """How the torch trainer follows the gradient."""

    sgd = "sgd"
    adamw = "adamw"


class Precision(StrEnum):
    """What the torch trainer's network computes in."""

    bf16 = "bf16"
    fp32 = "fp32"


Picture = tuple[NDArray[np.uint8], NDArray[np.float64]]  # (H, W, 3) BGR; boxes (N, 4) px


def parse_pair(text: str | None, separator: str, option: str) -> tuple[float, float] | None:
    """``416x224`` or ``0.5,1.2`` -> two numbers; raises DroptrackError naming the option."""
    if text is None:
        return None
    try:
        first, second = (float(part) for part in text.lower().split(separator))
    except ValueError:
        raise DroptrackError(f"{option} {text}: should be two numbers, A{separator}B") from None
    return first, second


def effective_cfg(cfg: Cfg, iterations: int, batch: int, subdivisions: int, rate: float) -> Cfg:
    """The cfg with the command's changes; 0 leaves what the cfg says."""
    changes = {
        "max_batches": iterations,
        "batch": batch,
        "subdivisions": subdivisions,
        "learning_rate": rate,
    }
    return with_options(cfg, {key: f"{value}" for key, value in changes.items() if value}, {})


app = new_app()


@app.command()
@one_line_errors
def main(
    cfg: Annotated[Path, typer.Option(help="Network description (.cfg).")],
    data: Annotated[Path, typer.Option(help="Data set (obj.data).")],
    out: Annotated[Path, typer.Option(help="Run folder, for everything the training writes.")],
    trainer: Annotated[
        Trainer, typer.Option(help="What trains; auto: Darknet where there is one, else PyTorch.")
    ] = Trainer.auto,
    darknet: Annotated[
        Path | None, typer.Option(help="Darknet binary; else $DARKNET, else on the PATH.")
    ] = None,
    weights: Annotated[Path | None, typer.Option(help="Weights to start from.")] = None,
    resume: Annotated[bool, typer.Option(help="Go on from the last snapshot in --out.")] = False,
    iterations: Annotated[int, typer.Option(min=0, help="0: max_batches of the cfg.")] = 0,
    batch: Annotated[int, typer.Option(min=0, help="Pictures an iteration; 0: the cfg's.")] = 0,
    subdivisions: Annotated[
        int, typer.Option(min=0, help="Parts of a batch computed one by one; 0: the cfg's.")
    ] = 0,
    rate: Annotated[float, typer.Option("--learning-rate", min=0, help="0: the cfg's.")] = 0,
    gpus: Annotated[str, typer.Option(help="GPUs to use, e.g. 0,1; default: the first.")] = "",
    save_every: Annotated[int, typer.Option(min=1, help="Iterations a snapshot.")] = 100,
    map_every: Annotated[int, typer.Option(min=1, help="Iterations a mAP, about.")] = 500,
    map_images: Annotated[int, typer.Option(min=1, help="Pictures a mAP of ours.")] = 200,
    patience: Annotated[
        int, typer.Option(min=0, help="Stop after so many mAPs without a new best; 0: never.")
    ] = 0,
    hang_minutes: Annotated[
        float, typer.Option(min=0.01, help="Stop a Darknet that says nothing for so long.")
    ] = 30,
    optimizer: Annotated[
        Optimizer, typer.Option(help="PyTorch: sgd is Darknet's; adamw needs fewer iterations.")
    ] = Optimizer.sgd,
    window: Annotated[
        str | None, typer.Option(help="PyTorch: random windows of this size, e.g. 416x224.")
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(help="PyTorch: range of the factor on the input's size, e.g. 0.5,1.2."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="PyTorch: same seed, same batches.")] = 0,
    draw: Annotated[
        str, typer.Option(help="PyTorch: draw endless new pictures of a scene, e.g. tiny or full.")
    ] = "",
    precision: Annotated[
        Precision, typer.Option(help="PyTorch: what the network computes in.")
    ] = Precision.bf16,
    workers: Annotated[
        int, typer.Option(min=0, help="PyTorch: processes a GPU that prepare pictures.")
    ] = min(8, max(1, (os.cpu_count() or 2) - 1)),
) -> None:
    """Train a network on a Darknet data set, with Darknet or PyTorch, and write its weights.

    The run folder gets the .cfg as trained, training.csv and training.png, run.json, and the
    weights <cfg>_last, _best and _final; of Darknet also its data file and darknet.log.
    """
    network = effective_cfg(read_cfg(cfg), iterations, batch, subdivisions, rate)
    pictures = read_data_file(data)
    check_network(network, pictures)
    check_pictures(network, pictures)
    if weights is not None:
        read_weights(weights, network)
    only_torch = {
        "--optimizer adamw": optimizer is Optimizer.adamw,
        "--window": window is not None,
        "--sizes": sizes is not None,
        "--draw": bool(draw),
    }
    binary = _choose(trainer, darknet, [name for name, given in only_torch.items() if given])
    steps: Generator[Step, None, None]
    if binary is not None:
        check_for_darknet(network, pictures, out)
        network = _run_folder(out, network, resume)
        darknet_settings = DarknetSettings(gpus, save_every, map_every, patience, hang_minutes * 60)
        training = DarknetTraining(
            binary,
            network,
            pictures,
            out,
            darknet_settings,
            lambda path: mean_average_precision(network, path, pictures.valid[:map_images]),
        )
        about = {**binary.about(), **asdict(darknet_settings)}
        steps = training.steps(weights, resume)
    else:
        if find_spec("torch") is None:
            raise DroptrackError(
                "found no Darknet (--darknet, $DARKNET, PATH), and no PyTorch: "
                "pip install 'droptrack[train]'"
            )
        from droptrack.training.pytorch.devices import choose_devices, machine
        from droptrack.training.pytorch.training import Job, Settings, train

        check_for_torch(network)
        pair = parse_pair(window, "x", "--window")
        if pair and any(side < 32 or side % 32 for side in pair):
            raise DroptrackError(f"--window {window}: both should be multiples of 32")
        settings = Settings(
            network.net.integer("max_batches"),
            network.net.integer("batch"),
            network.net.integer("subdivisions", 1),
            optimizer.value,
            network.net.number("learning_rate"),
            (int(pair[0]), int(pair[1])) if pair else None,
            parse_pair(sizes, ",", "--sizes"),
            seed,
            workers,
            save_every,
            map_every,
            map_images,
            patience,
            choose_devices(
                gpus, network.net.integer("batch"), network.net.integer("subdivisions", 1)
            ),
            precision is Precision.bf16,
        )
        source = _picture_source(draw) if draw else None
        network = _run_folder(out, network, resume)
        about = {**machine(), **asdict(settings)}
        steps = train(Job(network, pictures, out, settings, weights, resume, source))
    write_run_file(out, about)
    best = _show(steps, network, about)
    typer.echo(f"{out}: best mAP@0.50 {best:.4f}; weights {network.path.stem}_best and _final")


def _choose(trainer: Trainer, given: Path | None, only_torch: list[str]) -> Darknet | None:
    """The Darknet that is to train, or None for PyTorch."""
    if trainer is Trainer.torch or (trainer is Trainer.auto and only_torch):
        return None
    if only_torch:
        raise DroptrackError(f"{only_torch[0]}: only PyTorch can do this: --trainer torch")
    path = find_darknet(given)
    if path is None and trainer is Trainer.darknet:
        raise DroptrackError("--trainer darknet: found none; name it: --darknet FILE, or $DARKNET")
    return None if path is None else identify(path)


def _picture_source(scene: str) -> Callable[[np.random.Generator], Picture]:
    """Draws pictures of a scene; whoever can do so says so by an entry point."""
    for source in entry_points(group="droptrack.pictures"):
        drawn: Callable[[np.random.Generator], Picture] = source.load()(scene)
        return drawn
    raise DroptrackError("--draw: nothing is installed that draws pictures; install data_gen")


def _run_folder(out: Path, network: Cfg, resume: bool) -> Cfg:
    """Make the run folder, never over another; returns the cfg as it lies there."""
    if out.exists() and any(out.iterdir()) and not resume:
        raise DroptrackError(f"{out}: is not empty; choose another --out, or go on with --resume")
    if resume and not out.exists():
        raise DroptrackError(f"{out}: is not there to go on with; start without --resume")
    out.mkdir(parents=True, exist_ok=True)
    path = out / network.path.name
    path.write_text(cfg_text(network), encoding="utf-8")
    return read_cfg(path)


def _show(steps: Generator[Step, None, None], network: Cfg, about: Mapping[str, object]) -> float:
    """Follow a training to its end on a progress bar; returns the best mAP."""
    out, total = network.path.parent, network.net.integer("max_batches")
    typer.echo(f"{out}: training with {about['trainer']}", err=True)
    best = last = float("nan")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # whoever ends it may go on, too
    with progress_bar("iterations") as progress:
        task = progress.add_task(network.path.stem, total=total, note="")
        try:
            for step in steps:
                if step.mean_ap == step.mean_ap:
                    last, best = step.mean_ap, np.fmax(best, step.mean_ap)
                note = (
                    f"loss {step.average_loss:.3f} mAP {last:.4f} best {best:.4f} rate "
                    f"{step.learning_rate:.2g} {step.images} images"
                )
                progress.update(task, completed=step.iteration, note=note)
        except KeyboardInterrupt:
            steps.close()
            found = furthest_weights(out, network)
            if found is None:
                raise DroptrackError(
                    f"{out}: stopped before the first snapshot; start again, in another --out"
                ) from None
            raise DroptrackError(
                f"{out}: stopped; --resume goes on from iteration {found[1]}"
            ) from None
    return float(best)


if __name__ == "__main__":
    app()
