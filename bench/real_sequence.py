"""Tracks on a real sequence whose identities are known: missed, false, switched."""

import tempfile
from pathlib import Path

import numpy as np

import droptrack
from droptrack.data.sources.image_files import NUMBERS, image_files
from droptrack.data.trajectories import Trajectories, read_trajectories

SEQUENCES = ("plug_sequence",)  # folders of numbered images, with NAME_truth.csv beside them


def score_sequence(folder: Path, weights: Path | None) -> dict[str, float]:
    """How the droplets of a folder of images are tracked, with the scale that the images suggest.

    Only whole droplets have labels, and only frames that exist count: other rows count neither way.
    """
    truth, _ = read_trajectories(folder.with_name(f"{folder.name}_truth.csv"))
    with tempfile.TemporaryDirectory() as out:
        run = droptrack.track(
            folder, out=out, weights=weights, scale="auto", annotated_video=False, progress=False
        )
        found, settings = run.trajectories, run.report.settings
    report = droptrack.evaluate(truth, _counted(found, folder))
    kept = ("n_positions", "n_missed", "n_false", "n_switches")
    scores = {key: float(str(report.summary[key])) for key in kept}
    return {"scale": float(str(settings["scale"])), **scores}


def _counted(found: Trajectories, folder: Path) -> Trajectories:
    """Rows of frames that exist, of droplets that no edge cuts."""
    numbers = np.array([int(NUMBERS.split(path.stem)[-2]) for path in image_files(folder)])
    whole = found.columns["at_edge"] != 1
    return found[whole & np.isin(found.frame, numbers - numbers.min())]
