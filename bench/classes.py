"""A network trained for droplets with no, one, or several cells: ``python -m bench.classes DIR``.

Draws a data set and a video, trains a small network with PyTorch (minutes), and says how well it
finds each class, and how many rows and tracks of the video have the right one.
"""

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

import droptrack
from data_gen.scenes.shapes import Canvas, draw_ellipses, ellipse_boxes
from data_gen.videos.motions import ground_truth_of
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.arrays import Floats
from droptrack.data.darknet_dataset import read_data_file
from droptrack.data.trajectories import read_trajectories, write_trajectories
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.evaluation.network_scores import evaluate_network
from droptrack.evaluation.trajectory_scores import match
from droptrack.network.bundled import find_network
from droptrack.training.config import Optimizer, Trainer, TrainingConfig
from droptrack.training.run import train

NAMES = ("empty", "one cell", "several cells")
CELLS = "0,1,2+"
MEAN_CELLS = 0.8  # a droplet
SIZE = (480, 240)
GROUND, INSIDE, RING, CELL = 130, 140, 40, 60
RING_PX, CELL_PX = 3.0, (3.0, 4.5)
COLUMNS, LINES = 8, 4
PITCH = 56  # px between droplets
TRIES = 60  # places for a droplet's cells
VALID = 60  # images
INPUT = (384, 192)  # px of the network's input
NET = """[net]
batch=8
subdivisions=1
width={width}
height={height}
channels=3
momentum=0.9
decay=0.0005
saturation=1.5
exposure=1.5
hue=.1
learning_rate=0.001
burn_in=20
max_batches=800
policy=steps
steps=600
scales=.1
"""
CONVOLUTION = """[convolutional]
batch_normalize=1
filters={filters}
size=3
stride=1
pad=1
activation=leaky
"""
HEAD = """[convolutional]
filters={filters}
size=1
stride=1
pad=1
activation=linear

[yolo]
mask=0,1,2
anchors=24,24, 29,29, 35,35
classes={classes}
num=3
jitter=.1
ignore_thresh=.7
truth_thresh=1
random=0
max=200
"""
app = new_app()


def draw(droplets: Floats, cells: list[Floats]) -> Canvas:
    """An image of droplets (N, 5), ellipses, with cells (C, 3): x, y off the centre and radius."""
    canvas = np.full(SIZE[::-1], GROUND, np.uint8)
    draw_ellipses(canvas, droplets, RING)
    draw_ellipses(canvas, droplets - [0, 0, RING_PX, RING_PX, 0], INSIDE)
    there = [
        [x + dx, y + dy, r, r, 0]
        for (x, y), some in zip(droplets[:, :2], cells, strict=True)
        for dx, dy, r in some
    ]
    draw_ellipses(canvas, np.array(there, float).reshape(-1, 5), CELL)
    return canvas


def cells_in(rng: np.random.Generator, radii: Floats) -> list[Floats]:
    """Cells at random, none upon another, in droplets of radii (N,); as many as find room."""
    found = []
    for radius, n in zip(radii, rng.poisson(MEAN_CELLS, len(radii)), strict=True):
        some: list[list[float]] = []
        for _ in range(TRIES):
            r = rng.uniform(*CELL_PX)
            away = (radius - RING_PX - r - 1) * np.sqrt(rng.random())
            angle = rng.uniform(0, 2 * np.pi)
            one = [away * np.cos(angle), away * np.sin(angle), r]
            free = all(np.hypot(one[0] - b[0], one[1] - b[1]) > r + b[2] + 1 for b in some)
            if len(some) < n and free:
                some.append(one)
        found.append(np.array(some).reshape(-1, 3))
    return found


def lattice(rng: np.random.Generator) -> Floats:
    """Droplets (N, 5) in lines, off their places at random."""
    line, column = np.divmod(np.arange(COLUMNS * LINES), COLUMNS)
    places = np.column_stack([44 + PITCH * column, 34 + PITCH * line])
    radii = rng.uniform(15, 22, (len(places), 1))
    return np.hstack([places + rng.uniform(-4, 4, places.shape), radii, radii, 0 * radii])


def write_data_set(folder: Path, images: int, valid: int) -> Path:
    """Images with noise and Darknet's labels; returns obj.data."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    lists: dict[str, list[str]] = {"train": [], "valid": []}
    for index in range(images + valid):
        rng = np.random.default_rng([1, index])
        droplets = lattice(rng)
        droplets = droplets[rng.random(len(droplets)) < rng.uniform(0.3, 1)]
        cells = cells_in(rng, droplets[:, 2])
        path = folder / "images" / f"{index:05d}.png"
        _write(path, draw(droplets, cells), rng)
        lines = [
            f"{kind} " + " ".join(f"{value:.6f}" for value in box / np.tile(SIZE, 2))
            for kind, box in zip(_classes(cells), ellipse_boxes(droplets), strict=True)
        ]
        path.with_suffix(".txt").write_text("\n".join(lines) + "\n")
        lists["train" if index < images else "valid"].append(str(path.resolve()))
    for name, paths in lists.items():
        (folder / f"{name}.txt").write_text("\n".join(paths) + "\n")
    (folder / "obj.names").write_text("\n".join(NAMES) + "\n")
    data = folder / "obj.data"
    data.write_text(
        f"classes={len(NAMES)}\ntrain={folder.resolve()}/train.txt\n"
        f"valid={folder.resolve()}/valid.txt\nnames={folder.resolve()}/obj.names\n"
    )
    return data


def _classes(cells: list[Floats]) -> list[int]:
    return [min(len(some), len(NAMES) - 1) for some in cells]


def _write(path: Path, canvas: Canvas, rng: np.random.Generator) -> None:
    noisy = canvas + rng.normal(0, 4, canvas.shape)
    cv2.imwrite(str(path), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def write_video(folder: Path, n_frames: int) -> list[int]:
    """Droplets that sway, cells that turn in them; truth.csv beside it; returns their classes."""
    rng = np.random.default_rng(2)
    droplets = lattice(rng)
    cells = cells_in(rng, droplets[:, 2])
    spins = rng.uniform(-0.15, 0.15, len(droplets))
    paths = np.repeat(droplets[None, :, :2], n_frames, axis=0)
    t = np.arange(n_frames)[:, None]
    paths[..., 0] += 10 * np.sin(0.08 * t)
    paths[..., 1] += 6 * np.sin(0.11 * t)
    with VideoWriter(folder / "video.avi", VideoInfo(*SIZE, 25, n_frames), "MJPG", 95) as video:
        for k, places in enumerate(paths):
            turned = [_turned(some, spin * k) for some, spin in zip(cells, spins, strict=True)]
            canvas = draw(np.hstack([places, droplets[:, 2:]]), turned)
            noisy = np.clip(canvas + rng.normal(0, 4, canvas.shape), 0, 255).astype(np.uint8)
            video.write(np.repeat(noisy[..., None], 3, axis=2))
    by_droplet = paths.transpose(1, 0, 2)
    sizes = np.broadcast_to(2 * droplets[:, [2]], by_droplet.shape[:2])
    truth = ground_truth_of(by_droplet, sizes)
    write_trajectories(folder / "truth.csv", truth, {})
    return _classes(cells)


def _turned(cells: Floats, angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, r = cells.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, r])


def write_cfg(path: Path) -> None:
    """A network of six convolutions for droplets of this size and for these classes."""
    parts = [NET.format(width=INPUT[0], height=INPUT[1])]
    for filters in (16, 32, 64):
        parts += [CONVOLUTION.format(filters=filters), "[maxpool]\nsize=2\nstride=2\n"]
    parts += [CONVOLUTION.format(filters=64)] * 2
    parts.append(HEAD.format(filters=3 * (5 + len(NAMES)), classes=len(NAMES)))
    path.write_text("\n".join(parts))


@app.command()
@one_line_errors
def main(
    out: Annotated[Path, typer.Argument(help="Folder for all files.")],
    images: Annotated[int, typer.Option(min=8, help="Images to train on.")] = 400,
    iterations: Annotated[int, typer.Option(min=1, help="Of eight images.")] = 800,
    frames: Annotated[int, typer.Option(min=2, help="Frames of the video.")] = 60,
) -> None:
    """AP of each class on new images; rows and tracks of a video with the right class."""
    data = write_data_set(out / "data", images, VALID)
    write_cfg(out / "cells.cfg")
    config = TrainingConfig(
        cfg=out / "cells.cfg",
        data=data,
        out=out / "run",
        trainer=Trainer.torch,
        iterations=iterations,
        batch=8,
        learning_rate=0.002,
        optimizer=Optimizer.adamw,
    )
    train(config)
    weights = out / "run" / "cells_final.weights"
    report = evaluate_network(read_data_file(data), *find_network(weights, None))
    for key, value in report.summary.items():
        if key.startswith(("ap_50", "mean_average")):
            typer.echo(f"{key}: {value}")
    true_classes = write_video(out, frames)
    run = droptrack.track(
        out / "video.avi",
        out=out / "tracks",
        weights=weights,
        names=data,
        cells=CELLS,
        overwrite=True,
    )
    _print_tracks(out, run, true_classes)


def _print_tracks(out: Path, run: droptrack.TrackingRun, true_classes: list[int]) -> None:
    truth, _ = read_trajectories(out / "truth.csv")
    pairs = match(truth, run.trajectories)
    true = np.array(true_classes)[truth.track_id[pairs.truth] - 1]
    told = run.trajectories.columns["class_id"][pairs.result]
    ids = run.trajectories.track_id[pairs.result]
    voted = {int(str(row["track_id"])): row["class_id"] for row in run.report.droplets}
    right = [voted[int(k)] == int(np.median(true[ids == k])) for k in np.unique(ids)]
    for key in ("cells_observed", "cells_per_droplet", "poisson_p"):
        typer.echo(f"{key}: {run.report.summary[key]}")
    typer.echo(
        f"droplets of each class: {np.bincount(true_classes).tolist()}, found "
        f"{run.report.summary['n_of_class']}; rows {len(truth)}, found {len(told)}, right class "
        f"{(told == true).mean():.2%}; tracks {len(right)}, right class {sum(right)}"
    )


if __name__ == "__main__":
    app()
