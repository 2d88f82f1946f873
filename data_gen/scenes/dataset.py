"""Scenes drawn at random -> a Darknet data set, or images one by one for training."""

import functools
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

import cv2
import numpy as np

from data_gen.scenes.footage import ARRANGEMENTS, footage_scene
from data_gen.scenes.own_set_up import OwnDroplets
from data_gen.scenes.scene_kinds import HEIGHT, SCENES, WIDTH, Scene
from droptrack.data.arrays import Floats, Pixels
from droptrack.data.darknet_dataset import image_name, label_text, write_data_file, write_scenes
from droptrack.data.degradation import degrade
from droptrack.data.files import write_text
from droptrack.data.set_up import SUFFIX
from droptrack.data.sources.image_files import write_image_file
from droptrack.errors import DroptrackError
from droptrack.interrupts import signals_held

JPEG_QUALITY = 95


class SceneChoice(StrEnum):
    """One scene, or a mixture of scenes that take turns."""

    a = "a"
    b = "b"
    c = "c"
    d = "d"
    scattered = "scattered"
    packing = "packing"
    foam = "foam"
    confined = "confined"
    plugs = "plugs"
    stream = "stream"
    suspension = "suspension"
    empty = "empty"
    tiny = "tiny"  # the paper's data for YOLOv3-tiny
    full = "full"  # the paper's data for YOLOv3
    all = "all"  # what the bundled model was trained on
    footage = "footage"  # droplets as laboratories film them
    everything = "everything"  # both


FILE_KEYS = {"degraded": "spoilt"}  # names in dataset.json that are not a Recipe's
FOOTAGE = (
    *("plugs", "foam", "scattered", "foam", "plugs", "packing", "foam", "plugs", "scattered"),
    *("packing", "confined", "suspension", "stream", "empty"),
)
MIXTURES = {
    "tiny": tuple("ab"),
    "full": tuple("c"),
    "all": tuple("abccdd"),
    "footage": FOOTAGE,
    "everything": (*FOOTAGE, *"accddb"),
}
DRAWINGS: dict[str, Callable[[np.random.Generator], Scene]] = {
    **SCENES,
    **{name: functools.partial(footage_scene, name) for name in ARRANGEMENTS},
}


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Everything that decides a data set's bytes."""

    scene: str
    images: int
    valid: int
    seed: int
    degraded: float = 0.0  # share of the images
    jpeg_quality: int = JPEG_QUALITY
    format: int = 8  # to be raised when the same seed gives other images

    def kinds(self) -> tuple[str, ...]:
        """The names of the scenes that take turns."""
        return MIXTURES.get(self.scene, (self.scene,))


def write_image(folder: Path, recipe: Recipe, split: str, index: int) -> None:
    """Draw one image and write it and its labels; the label file last, whole, as a sign of success.

    The image depends on the recipe, the split and the index only.
    """
    rng = np.random.default_rng([recipe.seed, ("train", "valid").index(split), index])
    kinds = recipe.kinds()
    scene = DRAWINGS[kinds[index % len(kinds)]](rng)
    path = folder / image_name(split, index)
    degraded = rng.random() < recipe.degraded
    image = degrade(scene.image, rng) if degraded else scene.image
    write_image_file(path, image, recipe.jpeg_quality)
    write_text(path.with_suffix(".txt"), label_text(scene.boxes, WIDTH, HEIGHT))


def image_source(scene: str) -> Callable[[np.random.Generator], tuple[Pixels, Floats]]:
    """What draws images (H, W, 3) and boxes (N, 4) px of a scene or mixture, for training.

    Or of one's own droplets: `scene` is then the file that ``droptrack adapt`` made of a video.
    Raises DroptrackError for a scene that does not exist.
    """
    if scene.endswith(SUFFIX):
        return OwnDroplets.of_file(Path(scene))
    if scene not in list(SceneChoice):
        raise DroptrackError(f"no scene {scene}; there are {', '.join(SceneChoice)}")
    return functools.partial(_draw_image, MIXTURES.get(scene, (scene,)))


def _draw_image(kinds: tuple[str, ...], rng: np.random.Generator) -> tuple[Pixels, Floats]:
    scene = DRAWINGS[kinds[rng.integers(len(kinds))]](rng)
    return np.repeat(scene.image[..., None], 3, axis=2), scene.boxes


def make_dataset(folder: Path, recipe: Recipe, workers: int) -> Generator[int, None, None]:
    """Write what a data set lacks; yields the number of its images, as that grows.

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
        # not forked: a fork of a process that has threads may wait for ever for one of their locks
        pool = ProcessPoolExecutor(
            min(workers, len(chunks)), multiprocessing.get_context("spawn"), _begin_drawing
        )
        try:
            with signals_held(signal.SIGINT):
                written = [pool.submit(_write_chunk, (folder, recipe, chunk)) for chunk in chunks]
            for one in as_completed(written):
                done += one.result()
                yield done
        except BrokenProcessPool as error:
            raise DroptrackError(
                f"{folder}: a process that draws ended by itself (no memory left?); "
                "the same command goes on where it stopped, --workers 1 needs the least"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)
    kinds = recipe.kinds()
    scenes = {
        image_name(split, i): kinds[i % len(kinds)]
        for split in counts
        for i in range(counts[split])
    }
    write_scenes(folder, scenes)
    write_data_file(folder, ("droplet",), counts)


def _begin_drawing() -> None:
    """One image a core; Ctrl-C is the first process's to hear, and its end is that of this one."""
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    first = multiprocessing.parent_process()
    assert first is not None
    threading.Thread(target=_end_with, args=(first,), daemon=True).start()


def _end_with(process: multiprocessing.process.BaseProcess) -> None:
    process.join()
    os._exit(1)


def _write_chunk(job: tuple[Path, Recipe, list[tuple[str, int]]]) -> int:
    folder, recipe, chunk = job
    for split, index in chunk:
        write_image(folder, recipe, split, index)
    return len(chunk)


def _claim(folder: Path, recipe: Recipe) -> None:
    manifest = folder / "dataset.json"
    if manifest.exists():
        found = _read_manifest(manifest)
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
        values = {FILE_KEYS.get(key, key): value for key, value in asdict(recipe).items()}
        write_text(manifest, json.dumps(values, indent=1) + "\n")


def _read_manifest(path: Path) -> Recipe:
    names = {key: name for name, key in FILE_KEYS.items()}
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return Recipe(**{names.get(key, key): value for key, value in values.items()})
    except (ValueError, TypeError, AttributeError):
        raise DroptrackError(
            f"{path}: is damaged; delete {path.parent} or choose another"
        ) from None
