"""Tracks on a real sequence whose identities are known: missed, false, switched."""

import tempfile
from pathlib import Path

import numpy as np

import droptrack
from droptrack.data.sources.image_files import NUMBERS, image_files
from droptrack.data.trajectories import Trajectories, read_trajectories

SEQUENCES = ("plug_sequence",)  # folders of numbered images, with NAME_truth.csv beside them


def score_sequence(folder: Path, weights: Path | None) -> dict[str, str]:
    """How the droplets of a folder of images are tracked, with the scale that the images suggest.

    Only whole droplets have labels, and only frames that exist count: `_counted`.
    """
    truth, _ = read_trajectories(folder.with_name(f"{folder.name}_truth.csv"))
    with tempfile.TemporaryDirectory() as out:
        run = droptrack.track(
            folder, out=out, weights=weights, scale="auto", annotated_video=False, progress=False
        )
        found, settings = run.trajectories, run.report.settings
    report = droptrack.evaluate(truth, _counted(found, truth, folder))
    kept = ("n_positions", "n_missed", "n_false", "n_switches")
    return {"scale": str(settings["scale"]), **{key: str(report.summary[key]) for key in kept}}


def _counted(found: Trajectories, truth: Trajectories, folder: Path) -> Trajectories:
    """Rows of frames that exist, less those of a track before and after it is on a labelled plug.

    There the plug is cut by the field stop, or by the image's edge. Rows in between, and all of a
    track that is on no plug, count.
    """
    numbers = np.array([int(NUMBERS.split(path.stem)[-2]) for path in image_files(folder)])
    exists = np.isin(found.frame, numbers - numbers.min())
    on_plug = np.zeros(len(found.frame), bool)
    for frame in np.unique(truth.frame):
        rows, plugs = found.frame == frame, truth.frame == frame
        apart = np.hypot(found.x[rows, None] - truth.x[plugs], found.y[rows, None] - truth.y[plugs])
        on_plug[rows] = (apart <= truth.boxes[plugs, 2] / 2).any(axis=1)
    counted = exists.copy()
    for track in np.unique(found.track_id[on_plug]):
        rows = found.track_id == track
        first, last = np.flatnonzero(rows & on_plug)[[0, -1]]
        counted[rows] &= np.isin(np.flatnonzero(rows), np.arange(first, last + 1))
    return found[counted]
