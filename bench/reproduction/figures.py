"""Figures of a reproduction from what its stages left: read the data, draw, write."""

from pathlib import Path
from typing import Any

import numpy as np

from bench.reproduction import plots
from bench.reproduction.data_sets import data_file
from bench.reproduction.folder import Reproduction
from bench.reproduction.networks import PAPER_NAMES
from bench.reproduction.simulations import TITLES, Clip, clips
from bench.reproduction.tracking import OURS, PAPERS_WAY, result_folder
from droptrack.data.darknet_dataset import read_data_file, read_ground_truth, read_image
from droptrack.data.frames import Frame
from droptrack.data.trajectories import Trajectories, read_trajectories
from droptrack.data.video import Video

# of the paper's figures 7, 9 and 15; the last does not say which
FRAMES = {"shear": (18, 19, 20, 21), "constriction": (5, 6, 8, 9), "sine": (30, 31, 32, 33)}


def draw_all(of: Reproduction, folder: Path) -> list[str]:
    """Draw every figure that there is data for; returns their names."""
    made = {
        "scenes": _scenes(of),
        "flows": _flows(of),
    }
    logs = {
        PAPER_NAMES[name]: found["log"]
        for name, found in of.result("networks").items()
        if found.get("log")
    }
    if logs:
        made["training"] = plots.training(logs)
    for clip in clips(of):
        if clip.degraded:
            continue
        truth, _ = read_trajectories(clip.truth)
        rows = rows_of(of, clip, OURS)
        made[f"{clip.flow}_frames"] = _frames(of, clip)
        if clip.flow != "sine":
            made[f"{clip.flow}_paths"] = plots.paths(rows, _size(clip))
        if clip.flow != "constriction":
            made[f"{clip.flow}_y"] = plots.inferred_and_true(truth, rows, longest(truth, 4))
    evaluation = of.result("evaluation")["methods"]
    made["methods"] = plots.methods(evaluation, [clip_title(name) for name in evaluation])
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in made.items():
        plots.save(folder, name, figure)
    return list(made)


def clip_title(name: str) -> str:
    """What is in a video, by its name.

    >>> clip_title("sine_degraded")
    "the paper's test video, degraded"
    """
    flow, _, degraded = name.partition("_")
    return TITLES[flow] + (", degraded" if degraded else "")


def longest(truth: Trajectories, n: int) -> list[int]:
    """The n droplets that must be found in the most frames; of equals the first."""
    ids, counts = np.unique(truth.track_id[truth.scores > 0], return_counts=True)
    order = np.argsort(-counts, kind="stable")[:n]
    return sorted(ids[order].tolist())


def rows_of(of: Reproduction, clip: Clip, method: str) -> Trajectories:
    """The trajectories that a method gave of a video."""
    return read_trajectories(result_folder(of, clip, method) / "trajectories.csv")[0]


def _size(clip: Clip) -> tuple[int, int]:
    info = Video(str(clip.video)).info
    return info.width, info.height


def _scenes(of: Reproduction) -> Any:
    images = []
    for name, scene, index in (("tiny", "a", 0), ("tiny", "b", 1), ("full", "c", 0)):
        path = read_data_file(data_file(of, name)).train[index]
        image = read_image(path)
        height, width = image.shape[:2]
        images.append((scene, image, read_ground_truth(path, width, height)))
        if scene == "b":
            label = path.with_suffix(".txt").read_text()
    return plots.scenes(images, label)


def _flows(of: Reproduction) -> Any:
    found = {}
    for clip in clips(of):
        if clip.flow != "sine" and not clip.degraded:
            n = Video(str(clip.video)).info.n_frames
            found[TITLES[clip.flow]] = list(_images(clip, (0, n // 2, n - 1)).values())
    return plots.flows(found)


def _frames(of: Reproduction, clip: Clip) -> Any:
    """Four frames, as the paper shows them: with DeepSORT's identities."""
    rows = rows_of(of, clip, PAPERS_WAY)
    return plots.frames_with_boxes(_images(clip, FRAMES[clip.flow]), rows)


def _images(clip: Clip, numbers: tuple[int, ...]) -> dict[int, Frame]:
    """Frames of a video by their numbers, those that it has."""
    return {
        number: frame for number, frame in Video(str(clip.video)).numbered() if number in numbers
    }
