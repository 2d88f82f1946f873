"""Command: a Darknet data set of synthetic pictures, ``python -m data_gen.make_dataset``."""

import functools
import json
import multiprocessing
import os
from collections.abc import Callable, Generator
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from data_gen.scenes.scene_kinds import HEIGHT, SCENES, WIDTH
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import image_name, label_text, write_data_file, write_scenes
from droptrack.data.degradation import degrade
from droptrack.data.files import write_text
from droptrack.errors import DroptrackError
from droptrack.progress import progress_bar

JPEG_QUALITY = 95


class SceneChoice(StrEnum):
    """One scene, or a mixture of scenes that take turns."""

    a = "a"
    b = "b"
    c = "c"
    d = "d"
    tiny = "tiny"  # the paper's data for YOLOv3-tiny
    full = "full"  # the paper's data for YOLOv3
    all = "all"  # what the network that ships was trained on


MIXTURES = {"tiny": "ab", "full": "c", "all": "abccdd"}


@dataclass(frozen=True)
class Recipe:
    """Everything that decides a data set's bytes."""

    scene: str
    images: int
    valid: int
    seed: int
    spoilt: float = 0.0  # share of the pictures that are shown as by a bad camera
    jpeg_quality: int = JPEG_QUALITY
    format: int = 1  # to be raised when the same seed gives other pictures

    def kinds(self) -> str:
        """The letters of the scenes that take turns."""
        return MIXTURES.get(self.scene, self.scene)


def write_image(folder: Path, recipe: Recipe, split: str, index: int) -> None:
    """Draw one image and write it and its labels; the label file last, whole, as a sign of success.

    The picture depends on the recipe, the split and the index only.
    """
    rng = np.random.default_rng([recipe.seed, ("train", "valid").index(split), index])
    kinds = recipe.kinds()
    scene = SCENES[kinds[index % len(kinds)]](rng)
    path = folder / image_name(split, index)
    quality = [cv2.IMWRITE_JPEG_QUALITY, recipe.jpeg_quality]
    spoilt = rng.random() < recipe.spoilt
    image = degrade(scene.image, rng) if spoilt else scene.image
    path.write_bytes(cv2.imencode(".jpg", image, quality)[1].tobytes())
    write_text(path.with_suffix(".txt"), label_text(scene.boxes, WIDTH, HEIGHT))


def picture_source(
    scene: str,
) -> Callable[[np.random.Generator], tuple[NDArray[np.uint8], NDArray[np.float64]]]:
    """What draws pictures (H, W, 3) and boxes (N, 4) px of a scene or mixture, for training.

    Raises DroptrackError for a scene that is not there.
    """
    if scene not in list(SceneChoice):
        raise DroptrackError(f"no scene {scene}; there are {', '.join(SceneChoice)}")
    return functools.partial(_draw_picture, MIXTURES.get(scene, scene))


def _draw_picture(
    kinds: str, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    scene = SCENES[kinds[rng.integers(len(kinds))]](rng)
    return np.repeat(scene.image[..., None], 3, axis=2), scene.boxes


def make_dataset(folder: Path, recipe: Recipe, workers: int) -> Generator[int, None, None]:
    """Write what is missing of a data set; yields the number of images that are there, as it grows.

    Raises DroptrackError if the folder holds something else.
    """
    _claim(folder, recipe)
    counts = {"train": recipe.images, "valid": recipe.valid}
    jobs = []
    for split, count in counts.items():
        (folder / split).mkdir(exist_ok=True)
        there = {entry.name for entry in os.scandir(folder / split) if entry.name.endswith(".txt")}
        jobs += [
            (split, i) for i in range(count) if Path(image_name("", i)).stem + ".txt" not in there
        ]
    done = sum(counts.values()) - len(jobs)
    yield done
    chunks = [jobs[start : start + 32] for start in range(0, len(jobs), 32)]
    if workers == 1:
        for chunk in chunks:
            done += _write_chunk((folder, recipe, chunk))
            yield done
    elif chunks:
        with multiprocessing.Pool(workers) as pool:
            for written in pool.imap_unordered(
                _write_chunk, ((folder, recipe, chunk) for chunk in chunks)
            ):
                done += written
                yield done
    kinds = recipe.kinds()
    scenes = {
        image_name(split, i): kinds[i % len(kinds)]
        for split in counts
        for i in range(counts[split])
    }
    write_scenes(folder, scenes)
    write_data_file(folder, ("droplet",), counts)


def _write_chunk(job: tuple[Path, Recipe, list[tuple[str, int]]]) -> int:
    folder, recipe, chunk = job
    cv2.setNumThreads(1)
    for split, index in chunk:
        write_image(folder, recipe, split, index)
    return len(chunk)


def _claim(folder: Path, recipe: Recipe) -> None:
    manifest = folder / "dataset.json"
    if manifest.exists():
        try:
            found = Recipe(**json.loads(manifest.read_text(encoding="utf-8")))
        except (ValueError, TypeError):
            raise DroptrackError(
                f"{manifest}: is damaged; delete {folder} or choose another"
            ) from None
        if found != recipe:
            differing = [key for key, value in vars(recipe).items() if vars(found)[key] != value]
            raise DroptrackError(
                f"{folder}: holds a data set of other {', '.join(differing)}; "
                "choose another folder with --out, or delete this one"
            )
    elif folder.exists() and any(folder.iterdir()):
        raise DroptrackError(f"{folder}: is not empty and no data set; choose another with --out")
    else:
        folder.mkdir(parents=True, exist_ok=True)
        manifest.write_text(json.dumps(asdict(recipe), indent=1) + "\n", encoding="utf-8")


app = new_app()


@app.command()
@one_line_errors
def main(
    scene: Annotated[SceneChoice, typer.Option(help="Kind of pictures, or a mixture.")],
    out: Annotated[Path, typer.Option(help="Folder to make.")],
    images: Annotated[int, typer.Option(min=1, help="Number of training images.")] = 10_000,
    valid: Annotated[int, typer.Option(min=0, help="Number of validation images.")] = 1_000,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
    spoilt: Annotated[
        float, typer.Option(min=0, max=1, help="Share of pictures as a bad camera shows them.")
    ] = 0.0,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0 for one a core.")] = 0,
) -> None:
    """Make a Darknet data set of synthetic droplets; run again to go on after an interruption."""
    recipe = Recipe(scene.value, images, valid, seed, spoilt)
    with progress_bar("images") as progress:
        task = progress.add_task(str(out), total=images + valid, note="")
        try:
            for done in make_dataset(out, recipe, workers or os.cpu_count() or 1):
                progress.update(task, completed=done)
        except KeyboardInterrupt:
            raise DroptrackError(
                f"{out}: interrupted; the same command goes on from here"
            ) from None
    typer.echo(
        f"{out / 'obj.data'}: {images} training and {valid} validation images, scene {scene}"
    )


if __name__ == "__main__":
    app()
