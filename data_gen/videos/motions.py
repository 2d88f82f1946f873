"""Droplets that are hard to track: their ground truth and a detector's faulty output.

There are no images: a tracker sees only boxes.
"""

from pathlib import Path

import numpy as np

from data_gen.videos.motion_kinds import HEIGHT, WIDTH, Motion
from data_gen.videos.motion_paths import events_of, move
from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from droptrack.data.files import write_text
from droptrack.data.mot_files import write_detections
from droptrack.data.trajectories import Trajectories, sorted_trajectories, write_trajectories
from droptrack.version import __version__


def ground_truth_of(paths: Floats, diameters: Floats, aspect: float = 1.0) -> Trajectories:
    """Those droplets that are wholly in the image; `aspect`: their width, in heights."""
    shape = np.array([np.sqrt(aspect), 1 / np.sqrt(aspect)])
    margin = diameters[..., None] * shape / 2
    whole = ((paths >= margin) & (paths <= [WIDTH, HEIGHT] - margin)).all(axis=2)
    droplet, frame = np.nonzero(whole)
    size = diameters[whole]
    boxes = np.column_stack([paths[whole], size[:, None] * shape])
    return sorted_trajectories(
        frame=frame.astype(np.int64),
        track_id=droplet.astype(np.int64) + 1,
        x=boxes[:, 0],
        y=boxes[:, 1],
        boxes=boxes,
        scores=np.ones(len(size)),
        observed=np.ones(len(size), bool),
    )


def detect(rng: np.random.Generator, truth: Trajectories, motion: Motion) -> list[Detections]:
    """What a detector would find, frame by frame: some missed, some false, all a little off."""
    found = []
    shape = np.array([np.sqrt(motion.aspect), 1 / np.sqrt(motion.aspect)])
    there = np.ones(motion.frames, bool)
    if motion.images_missing:
        there = rng.random(motion.frames) >= motion.images_missing
    for frame in range(motion.frames):
        if not there[frame]:
            found.append(Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64)))
            continue
        boxes = truth.boxes[truth.frame == frame]
        n_false = rng.poisson(motion.false * len(boxes))
        boxes = boxes[rng.random(len(boxes)) >= motion.missing]
        size = motion.diameter * rng.uniform(0.8, 1.2, (n_false, 1)) * shape
        false = np.hstack([rng.uniform(0, 1, (n_false, 2)) * [WIDTH, HEIGHT], size])
        noise = rng.normal(0, 1, boxes.shape) * motion.jitter * boxes[:, 2:3]
        noise[:, 2:] = np.maximum(noise[:, 2:], -0.5 * boxes[:, 2:])
        boxes = rng.permutation(np.vstack([boxes + noise, false]))
        found.append(Detections(boxes, np.ones(len(boxes)), np.zeros(len(boxes), np.int64)))
    return found


def make(motion: Motion, seed: int) -> tuple[Trajectories, list[Detections]]:
    """The ground truth of a motion and what a detector finds of it in each frame."""
    rng = np.random.default_rng(seed)
    truth = ground_truth_of(*move(rng, motion), motion.aspect)
    return truth, detect(rng, truth, motion)


def write_motion(out: Path, motion: Motion, seed: int) -> int:
    """Write detections.txt and truth.csv to a folder; returns the number of droplets.

    And events.csv, where droplets coalesce or break up.
    """
    truth, found = make(motion, seed)
    out.mkdir(parents=True, exist_ok=True)
    about = {
        "made by": f"droptrack {__version__}, data_gen.simulate motions",
        "parameters": f"{motion}, seed={seed}",
        "video": f"none, {WIDTH:g} x {HEIGHT:g} px",
    }
    write_trajectories(out / "truth.csv", truth, about)
    write_detections(out / "detections.txt", found)
    if events := events_of(motion, seed):
        lines = [
            f"{one.frame},{motion.kind},{' '.join(map(str, one.parents))},"
            f"{' '.join(map(str, one.children))},{one.x:.6f},{one.y:.6f}\n"
            for one in sorted(events, key=lambda one: one.frame)
        ]
        text = "frame,kind,parents,children,x,y\n" + "".join(lines)
        write_text(out / "events.csv", text)
    return len(np.unique(truth.track_id))
