"""Command: a Darknet data set of synthetic images, ``python -m data_gen.make_dataset``."""

import os
from pathlib import Path
from typing import Annotated

import typer

from data_gen.scenes.dataset import Recipe, SceneChoice, make_dataset
from droptrack.command_line import new_app, one_line_errors
from droptrack.errors import DroptrackError
from droptrack.progress import progress_bar

app = new_app()


@app.command()
@one_line_errors
def main(
    scene: Annotated[SceneChoice, typer.Option(help="Scene to draw, or a mixture of scenes.")],
    out: Annotated[Path, typer.Option(help="Folder to write the data set to.")],
    images: Annotated[int, typer.Option(min=1, help="Number of training images.")] = 10_000,
    valid: Annotated[int, typer.Option(min=0, help="Number of validation images.")] = 1_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same one gives the same bytes.")] = 0,
    degraded: Annotated[
        float,
        typer.Option(
            min=0, max=1, help="Share of images with blur, uneven light, low contrast and noise."
        ),
    ] = 0.0,
    spoilt: Annotated[
        float | None, typer.Option(min=0, max=1, hidden=True, help="Former name of --degraded.")
    ] = None,
    workers: Annotated[
        int, typer.Option(min=0, help="Number of processes; 0: one per processor core.")
    ] = 0,
) -> None:
    """Make a Darknet data set of synthetic droplets; run again to resume an interrupted run."""
    recipe = Recipe(
        scene=scene.value,
        images=images,
        valid=valid,
        seed=seed,
        degraded=degraded if spoilt is None else spoilt,
    )
    with progress_bar("images") as progress:
        task = progress.add_task(str(out), total=images + valid, note="")
        try:
            for done in make_dataset(out, recipe, workers or os.cpu_count() or 1):
                progress.update(task, completed=done)
        except KeyboardInterrupt:
            raise DroptrackError(f"{out}: interrupted; the same command resumes it") from None
    typer.echo(
        f"{out / 'obj.data'}: {images} training and {valid} validation images, scene {scene}"
    )


if __name__ == "__main__":
    app()
