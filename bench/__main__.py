"""Measure speed and accuracy: ``python -m bench``, or one of its commands."""

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from data_gen.make_dataset import Recipe, make_dataset
from data_gen.scenes import SCENES
from droptrack.appearance import describe
from droptrack.centroid import centres_of_mass
from droptrack.command_line import new_app, progress_bar
from droptrack.darknet_files import read_cfg
from droptrack.deepsort import Parameters, Tracker
from droptrack.detections import Detections, labels
from droptrack.detector import Detector
from droptrack.engine_choice import Backend, Network, choose_detector
from droptrack.metrics import average_precision
from droptrack.network_choice import SHIPPED, SHIPPED_WEIGHTS, find_cfg
from droptrack.video import Frame

app = new_app()
console = Console()


def milliseconds(action: Callable[[], object], repeat: int) -> float:
    """The median time of an action, after one that is not counted."""
    action()
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        action()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def shipped(threshold: float) -> Detector:
    """The network that ships, in OpenCV."""
    cfg = read_cfg(find_cfg(SHIPPED_WEIGHTS))
    return choose_detector(Network(cfg, SHIPPED_WEIGHTS, threshold, 0.45), Backend.opencv)


def colour(image: np.ndarray) -> Frame:
    """A grey picture as a frame."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


@app.command()
def dataset(images: int = 10_000) -> None:
    """Seconds to make the paper's two data sets, on all cores."""
    for scene in ("tiny", "full"):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            for _ in make_dataset(
                Path(folder) / "data", Recipe(scene, images, 0, 1), os.cpu_count() or 1
            ):
                pass
            seconds = time.perf_counter() - start
        console.print(f"data set {scene}: {images} images in {seconds:.1f} s")


@app.command()
def stages(repeat: int = 15) -> None:
    """Milliseconds a frame of each stage of tracking, and the network against a plain loop's."""
    rng = np.random.default_rng(0)
    scene = next(
        s for s in (SCENES["c"](np.random.default_rng(n)) for n in range(99)) if len(s.boxes) >= 50
    )
    frame, boxes = colour(scene.image), scene.boxes[:50]
    detector = shipped(0.4)
    tracker = Tracker(Parameters())
    table = Table("stage", "ms a frame", title=f"1200 x 600 px, {len(boxes)} droplets")
    cfg = SHIPPED / "yolov3-tiny.cfg"
    plain = cv2.dnn.readNetFromDarknet(str(cfg), str(SHIPPED_WEIGHTS))

    def plain_416() -> None:
        plain.setInput(cv2.dnn.blobFromImage(frame, 1 / 255, (416, 416), swapRB=True))
        plain.forward(plain.getUnconnectedOutLayersNames())

    def update() -> None:
        shaken = boxes + rng.normal(0, 0.2, boxes.shape)
        tracker.update(shaken, describe(frame, shaken))

    for name, action in (
        ("detect, shipped size", lambda: detector.detect([frame])),
        ("OpenCV alone, 416 x 416", plain_416),
        ("centres of mass", lambda: centres_of_mass(frame, boxes)),
        ("describe and track", update),
    ):
        table.add_row(name, f"{milliseconds(action, repeat):.2f}")
    console.print(table)


def pairs(
    detector: Detector, scene: str, images: int, seed: int
) -> Iterator[tuple[Detections, Detections]]:
    """What is found on fresh pictures of a scene, through JPEG as in a data set, and the truth."""
    for index in range(images):
        drawn = SCENES[scene](np.random.default_rng([seed, 2, index]))
        jpeg = cv2.imencode(".jpg", drawn.image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        frame = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
        yield detector.detect([frame])[0], labels(drawn.boxes)


def _counted(
    items: Iterator[tuple[Detections, Detections]], progress: Progress, task: TaskID
) -> Iterator[tuple[Detections, Detections]]:
    for item in items:
        yield item
        progress.advance(task)


@app.command()
def accuracy(images: int = 1000, seed: int = 2026) -> None:
    """MAP@0.50 of the network that ships on fresh pictures of each scene (Darknet's definition)."""
    detector = shipped(0.005)
    table = Table("scene", "mAP@0.50", "precision", "recall", "droplets", title="scores above 0.25")
    for scene in SCENES:
        with progress_bar("images") as progress:
            task = progress.add_task(scene, total=images, note="")
            found = pairs(detector, scene, images, seed)
            result = average_precision(_counted(found, progress, task))
        table.add_row(
            scene,
            f"{result.average_precision:.4f}",
            f"{result.precision:.4f}",
            f"{result.recall:.4f}",
            str(result.n_truths),
        )
    console.print(table)


@app.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Without a command: everything."""
    if context.invoked_subcommand is None:
        dataset()
        stages()
        accuracy()


if __name__ == "__main__":
    app()
