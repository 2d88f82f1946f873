"""Command: train a network, ``python -m droptrack.train``."""

from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from droptrack import DroptrackError
from droptrack.command_line import new_app, one_line_errors, progress_bar
from droptrack.darknet_files import read_cfg, yolo_heads
from droptrack.dataset import read_data_file


class Trainer(StrEnum):
    """What does the training."""

    darknet = "darknet"
    torch = "torch"
    auto = "auto"


class Optimizer(StrEnum):
    """How the torch trainer follows the gradient."""

    sgd = "sgd"
    adamw = "adamw"


def parse_pair(text: str | None, separator: str, option: str) -> tuple[float, float] | None:
    """``416x224`` or ``0.5,1.2`` -> two numbers; raises DroptrackError naming the option."""
    if text is None:
        return None
    try:
        first, second = (float(part) for part in text.lower().split(separator))
    except ValueError:
        raise DroptrackError(f"{option} {text}: should be two numbers, A{separator}B") from None
    return first, second


app = new_app()


@app.command()
@one_line_errors
def main(
    cfg: Annotated[Path, typer.Option(help="Network description (.cfg).")],
    data: Annotated[Path, typer.Option(help="Data set (obj.data).")],
    out: Annotated[Path, typer.Option(help="Folder for weights, log and checkpoints.")],
    trainer: Annotated[Trainer, typer.Option(help="What trains.")] = Trainer.auto,
    weights: Annotated[Path | None, typer.Option(help="Weights to start from.")] = None,
    resume: Annotated[bool, typer.Option(help="Go on from the checkpoint in --out.")] = False,
    iterations: Annotated[int, typer.Option(min=0, help="0: max_batches of the cfg.")] = 0,
    batch: Annotated[int, typer.Option(min=0, help="Pictures an iteration; 0: the cfg's.")] = 0,
    optimizer: Annotated[
        Optimizer, typer.Option(help="sgd is Darknet's; adamw needs fewer iterations.")
    ] = Optimizer.sgd,
    rate: Annotated[float, typer.Option("--learning-rate", min=0, help="0: the cfg's.")] = 0,
    window: Annotated[
        str | None, typer.Option(help="Train on random windows of this size, e.g. 416x224.")
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(help="Range of the random factor on the input's size, e.g. 0.5,1.2."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    workers: Annotated[int, typer.Option(min=0, help="Processes preparing pictures.")] = 1,
    save_every: Annotated[int, typer.Option(min=1, help="Iterations a checkpoint.")] = 100,
    map_every: Annotated[int, typer.Option(min=1, help="Iterations a mAP.")] = 500,
    map_images: Annotated[int, typer.Option(min=1, help="Pictures a mAP.")] = 200,
) -> None:
    """Train a network on a Darknet data set and write Darknet weights."""
    if trainer is Trainer.darknet:
        raise DroptrackError("--trainer darknet: not built yet; use --trainer torch")
    if find_spec("torch") is None:
        raise DroptrackError("training needs PyTorch: pip install 'droptrack[train]'")
    from droptrack.torch_train import Settings, train

    network, pictures = read_cfg(cfg), read_data_file(data)
    if {head.classes for head in yolo_heads(network)} != {len(pictures.names)}:
        raise DroptrackError(f"{cfg}: classes= should be {len(pictures.names)}, as in {data}")
    pair = parse_pair(window, "x", "--window")
    if pair and any(side < 32 or side % 32 for side in pair):
        raise DroptrackError(f"--window {window}: both should be multiples of 32")
    settings = Settings(
        iterations or network.net.integer("max_batches"),
        batch or network.net.integer("batch"),
        optimizer.value,
        rate or network.net.number("learning_rate"),
        (int(pair[0]), int(pair[1])) if pair else None,
        parse_pair(sizes, ",", "--sizes"),
        seed,
        workers,
        save_every,
        map_every,
        map_images,
    )
    if out.exists() and any(out.iterdir()) and not resume:
        raise DroptrackError(f"{out}: is not empty; choose another --out, or go on with --resume")
    out.mkdir(parents=True, exist_ok=True)
    mean_ap = float("nan")
    with progress_bar("iterations") as progress:
        task = progress.add_task(cfg.stem, total=settings.iterations, note="")
        iteration = 0
        try:
            for step in train(network, pictures, out, settings, weights, resume):
                iteration = step.iteration
                mean_ap = step.mean_ap if step.mean_ap == step.mean_ap else mean_ap
                rate_now = settings.batch / step.seconds
                note = f"loss {step.loss:.3f} mAP {mean_ap:.4f} {rate_now:.0f} images/s"
                progress.update(task, completed=iteration, note=note)
        except KeyboardInterrupt:
            raise DroptrackError(
                f"{out}: stopped after iteration {iteration}; --resume goes on from there"
            ) from None
    final = out / f"{cfg.stem}_final.weights"
    typer.echo(f"{final}: mAP@0.50 {mean_ap:.4f} on {settings.map_images} validation images")


if __name__ == "__main__":
    app()
