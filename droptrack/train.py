"""Command: train a network, ``python -m droptrack.train``."""

import functools
import math
import signal
from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.errors import DroptrackError
from droptrack.network.bundled import parse_size
from droptrack.training.config import (
    DEFAULT_WORKERS,
    Optimizer,
    Trainer,
    TrainingConfig,
    TrainingPrecision,
)
from droptrack.training.run import train

app = new_app()


def parse_range(text: str, option: str) -> tuple[float, float]:
    """``0.5,1.2`` -> two numbers; raises DroptrackError naming the option."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise DroptrackError(f"{option} {text}: should be two numbers, A,B") from None
    if not 0 < low <= high < math.inf:
        raise DroptrackError(f"{option} {text}: the first should be the smaller one, above 0")
    return low, high


@app.command()
@one_line_errors
def main(
    cfg: Annotated[Path, typer.Option(help="Network description (.cfg).")],
    data: Annotated[Path, typer.Option(help="Data set (obj.data).")],
    out: Annotated[Path, typer.Option(help="Run folder, for everything the training writes.")],
    trainer: Annotated[
        Trainer, typer.Option(help="What trains; auto: Darknet if it is found, else PyTorch.")
    ] = Trainer.auto,
    darknet: Annotated[
        Path | None, typer.Option(help="Darknet binary; default: $DARKNET, else on the PATH.")
    ] = None,
    weights: Annotated[
        Path | None, typer.Option(help="Weights to start from; default: random ones.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Resume from the last snapshot in --out.")] = False,
    iterations: Annotated[
        int, typer.Option(min=0, help="Iterations in all; 0: max_batches of the cfg.")
    ] = 0,
    batch: Annotated[int, typer.Option(min=0, help="Images an iteration; 0: the cfg's.")] = 0,
    subdivisions: Annotated[
        int, typer.Option(min=0, help="Parts of a batch computed one by one; 0: the cfg's.")
    ] = 0,
    rate: Annotated[
        float, typer.Option("--learning-rate", min=0, help="Learning rate; 0: the cfg's.")
    ] = 0,
    gpus: Annotated[str, typer.Option(help="GPUs to use, e.g. 0,1; default: the first.")] = "",
    save_every: Annotated[
        int, typer.Option(min=1, help="Save a snapshot after every N iterations.")
    ] = 100,
    map_every: Annotated[
        int, typer.Option(min=1, help="Measure the mAP after about every N iterations.")
    ] = 500,
    map_images: Annotated[
        int,
        typer.Option(min=1, help="Measure it on the first N validation images; Darknet: on all."),
    ] = 200,
    patience: Annotated[
        int, typer.Option(min=0, help="Stop after N mAPs without a new best; 0: never.")
    ] = 0,
    hang_minutes: Annotated[
        float, typer.Option(min=0.01, help="Stop a Darknet that prints nothing for N minutes.")
    ] = 30,
    optimizer: Annotated[
        Optimizer, typer.Option(help="PyTorch: sgd is Darknet's; adamw needs fewer iterations.")
    ] = Optimizer.sgd,
    window: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="PyTorch: train on random windows of this size, px."),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="PyTorch: range of a random factor on the input size."),
    ] = None,
    droplets: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="PyTorch: diameters, px of the input, that have a label; others have none.",
        ),
    ] = None,
    negatives: Annotated[
        float, typer.Option(min=0, max=1, help="PyTorch: share of images shown as negatives.")
    ] = 0,
    frozen_statistics: Annotated[
        bool,
        typer.Option(
            "--frozen-statistics",
            help="PyTorch: batch normalisation keeps its statistics, as at the end of a training.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="PyTorch: same seed, same batches.")] = 0,
    draw: Annotated[
        str,
        typer.Option(
            help="PyTorch: draw endless new images of a scene, or set_up.npz of droptrack adapt."
        ),
    ] = "",
    precision: Annotated[
        TrainingPrecision, typer.Option(help="PyTorch: what the network computes in.")
    ] = TrainingPrecision.bf16,
    workers: Annotated[
        int, typer.Option(min=0, help="PyTorch: processes a GPU that prepare images.")
    ] = DEFAULT_WORKERS,
) -> None:
    """Train a network on a Darknet data set, with Darknet or PyTorch, and write its weights.

    The run folder gets the .cfg as trained, training.csv and training.png, run.json, and the
    weights <cfg>_last, _best and _final; of Darknet also its data file and darknet.log.
    """
    config = TrainingConfig(
        cfg=cfg,
        data=data,
        out=out,
        trainer=trainer,
        darknet=darknet,
        weights=weights,
        resume=resume,
        iterations=iterations,
        batch=batch,
        subdivisions=subdivisions,
        learning_rate=rate,
        gpus=gpus,
        save_every=save_every,
        map_every=map_every,
        map_images=map_images,
        patience=patience,
        hang_minutes=hang_minutes,
        optimizer=optimizer,
        window=None if window is None else parse_size(window, "--window"),
        sizes=None if sizes is None else parse_range(sizes, "--sizes"),
        droplets=None if droplets is None else parse_range(droplets, "--droplets"),
        negatives=negatives,
        frozen_statistics=frozen_statistics,
        seed=seed,
        draw=draw,
        precision=precision,
        workers=workers,
    )
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: it can be resumed
    best = train(config, functools.partial(typer.echo, err=True))
    typer.echo(f"{out}: best mAP@0.50 {best:.4f}; weights {cfg.stem}_best and _final")


if __name__ == "__main__":
    app()
