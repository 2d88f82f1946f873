"""What the network finds in four videos of the constriction, mistakes too, and ground truth.

``python tests/tracking/constriction_detections.py`` simulates the videos (minutes), finds the
droplets with the bundled model and writes ``tests/reference/constriction_detections.npz``. In them,
now and then, half a droplet gets a box of its own for some frames, or a box jumps.
"""

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.detections import Detections, labels
from droptrack.data.trajectories import Trajectories, read_trajectories, sorted_trajectories
from droptrack.data.video import Video
from droptrack.detection.engine_choice import Backend, Network, choose_detector
from droptrack.measurement.centre_of_mass import centres_of_mass
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import read_cfg

REFERENCE = Path(__file__).parents[1] / "reference" / "constriction_detections.npz"
SEEDS = (0, 1, 2, 3)
STEP_PX = 0.02  # to which places are kept
Frames = list[tuple[Detections, NDArray[np.float64]]]  # boxes, and centres of mass (M, 2)


def record(folder: Path) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Frame, centre and box of each detection, and frame, droplet, centre, box of ground truth.

    Lengths are in STEP_PX.
    """
    network = read_cfg(find_cfg(BUNDLED_WEIGHTS))
    detector = choose_detector(
        Network(network, BUNDLED_WEIGHTS, threshold=0.4, max_iou=0.3), Backend.opencv
    )
    found = []
    for number, frame in enumerate(Video(str(folder / "video.avi"))):
        boxes = detector.detect([frame])[0].boxes
        centres, _ = centres_of_mass(frame, boxes)
        rows = np.hstack([centres, boxes]) / STEP_PX
        found.append(np.column_stack([np.full(len(rows), number), rows]))
    truth, _ = read_trajectories(folder / "truth.csv")
    places = np.column_stack([truth.x, truth.y, truth.boxes]) / STEP_PX
    known = np.column_stack([truth.frame, truth.track_id, places, truth.scores])
    return np.concatenate(found).round().astype(np.int16), known.round().astype(np.int16)


def load(seed: int) -> tuple[Frames, Trajectories]:
    """Detections and centres of mass (M, 2) of each frame, and ground truth."""
    with np.load(REFERENCE) as arrays:
        found, known = arrays[f"found {seed}"], arrays[f"truth {seed}"]
    frames = []
    for number in range(int(found[:, 0].max()) + 1):
        rows = found[found[:, 0] == number, 1:] * STEP_PX
        ones = np.ones(len(rows))
        frames.append((Detections(rows[:, 2:], ones, np.zeros(len(rows), np.int64)), rows[:, :2]))
    places = known[:, 2:8] * STEP_PX
    return frames, sorted_trajectories(
        known[:, 0].astype(np.int64),
        known[:, 1].astype(np.int64),
        places[:, 0],
        places[:, 1],
        places[:, 2:],
        known[:, 8].astype(float),
        np.ones(len(known), bool),
    )


def without(frames: Frames, share: float, rng: np.random.Generator) -> Frames:
    """With a share of the boxes taken out."""
    kept = [np.flatnonzero(rng.random(len(found)) >= share) for found, _ in frames]
    return [(f[rows], centres[rows]) for (f, centres), rows in zip(frames, kept, strict=True)]


def with_more(frames: Frames, share: float, rng: np.random.Generator) -> Frames:
    """With boxes between a share of the boxes and the ones nearest to them."""
    result = []
    for found, centres in frames:
        boxes = found.boxes
        apart = np.hypot(*(boxes[:, None, :2] - boxes[None, :, :2]).transpose(2, 0, 1))
        np.fill_diagonal(apart, np.inf)
        rows = np.flatnonzero(rng.random(len(boxes)) < share)
        more = (boxes[rows] + boxes[apart.argmin(axis=1)[rows]]) / 2
        everything = labels(np.vstack([boxes, more]))
        result.append((everything, np.vstack([centres, more[:, :2]])))
    return result


if __name__ == "__main__":
    arrays: dict[str, Any] = {}
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(sys.argv[1]) / f"c{seed}" if len(sys.argv) > 1 else Path(name)
            if not (folder / "video.avi").exists():
                command = [sys.executable, "-m", "data_gen.simulate", "constriction"]
                subprocess.run([*command, "--seed", str(seed), "--out", str(folder)], check=True)
            arrays[f"found {seed}"], arrays[f"truth {seed}"] = record(folder)
    np.savez_compressed(REFERENCE, **arrays)
