"""The stage ``data_sets``: the paper's two, of scenes a and b and of scene c."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.reproduction.folder import Reproduction
from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.data.darknet_dataset import read_data_file, read_ground_truth, read_image
from droptrack.progress import progress_bar

DATA_SETS = {"tiny": "a and b", "full": "c"}  # and the scenes in them


def data_file(of: Reproduction, name: str) -> Path:
    """The obj.data of a data set."""
    return of.folder("data_sets") / name / "obj.data"


def make_data_sets(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Draw what is missing of both data sets, and count what is in them."""
    found = {}
    settings = of.settings
    for name, scenes in DATA_SETS.items():
        recipe = Recipe(
            scene=name, images=settings.images, valid=settings.valid, seed=settings.seed
        )
        folder = of.folder("data_sets") / name
        with progress_bar("images") as progress:
            task = progress.add_task(name, total=settings.images + settings.valid, note="")
            for done in make_dataset(folder, recipe, os.cpu_count() or 1):
                progress.update(task, completed=done)
        data = read_data_file(folder / "obj.data")
        found[name] = {
            "scenes": scenes,
            "n_images": len(data.train),
            "n_valid": len(data.valid),
            "n_droplets_valid": sum(_n_droplets(path) for path in data.valid),
        }
        say(f"{folder}: {len(data.train)} + {len(data.valid)} images")
    return found


def _n_droplets(path: Path) -> int:
    height, width = read_image(path).shape[:2]
    return len(read_ground_truth(path, width, height))
