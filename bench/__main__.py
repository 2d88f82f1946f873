"""Measure speed and accuracy: ``python -m bench``, or one of its commands."""

import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from bench.engines import DROPLETS, MAX_IOU, SCORE, write_video
from data_gen.scenes.dataset import Recipe, make_dataset
from data_gen.scenes.scene_kinds import SCENES
from droptrack.command_line import new_app
from droptrack.data.detections import Detections, labels
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.data.video import Video
from droptrack.detection.decoding import select
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Network, choose_detector
from droptrack.evaluation.average_precision import average_precision
from droptrack.evaluation.validation import darknet_detector
from droptrack.measurement.centre_of_mass import centres_of_mass, load_loops
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import read_cfg
from droptrack.pipeline.run import FURTHER_COLUMNS, Results
from droptrack.pipeline.threads import side_by_side
from droptrack.progress import progress_bar
from droptrack.tracking.appearance import describe_nothing
from droptrack.tracking.choice import TrackerName, make_tracker
from droptrack.tracking.deepsort import Parameters
from droptrack.tracking.recorder import Recorder

app = new_app()
console = Console()


@app.command()
def dataset(images: int = 10_000) -> None:
    """Seconds to make the paper's two data sets, on all cores."""
    for scene in ("tiny", "full"):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            for _ in make_dataset(
                Path(folder) / "data",
                Recipe(scene=scene, images=images, valid=0, seed=1),
                os.cpu_count() or 1,
            ):
                pass
            seconds = time.perf_counter() - start
        console.print(f"data set {scene}: {images} images in {seconds:.1f} s")


@app.command()
def stages(frames: int = 600) -> None:
    """Processor time a frame of each stage of tracking, one after the other."""
    spent: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def measure(stage: str) -> Iterator[None]:
        start = time.process_time()
        yield
        spent[stage] += time.process_time() - start

    with tempfile.TemporaryDirectory() as name, side_by_side(1):
        folder = Path(name)
        write_video(folder / "video.avi", frames + 1)
        cfg = read_cfg(find_cfg(BUNDLED_WEIGHTS))
        detector = choose_detector(Network(cfg, BUNDLED_WEIGHTS, SCORE, MAX_IOU))
        engine = detector.engine
        tracker, _ = make_tracker(TrackerName.droplet, Parameters())
        recorder = Recorder(tracker.delay + tracker.max_age)
        source = Video(str(folder / "video.avi")).numbered()
        # the first of each is slower
        detector.detect([next(source)[1]])
        load_loops()
        with TrajectoryWriter(folder / "trajectories.csv", {}, FURTHER_COLUMNS) as rows:
            results = Results(rows)
            for _ in range(frames):
                with measure("decode"):
                    index, frame = next(source)
                with measure("prepare"):
                    prepared = engine.prepare([frame])
                with measure("network"):
                    outputs = engine.start(prepared).result().outputs
                with measure("decode boxes"):
                    (chosen,) = engine.rows(outputs)
                    found = select(chosen, frame.shape[1], frame.shape[0], SCORE, MAX_IOU)
                with measure("track"):
                    update = tracker.update(found.boxes, describe_nothing(frame, found.boxes))
                with measure("centres of mass"):
                    centres, measured = centres_of_mass(frame, found.boxes)
                with measure("write"):
                    recorder.add(index, found, centres, measured, update)
                    results.n_frames += 1
                    results.take_final(recorder)
    title = f"1200 x 600 px, {DROPLETS} droplets, {engine.name}"
    table = Table("stage", "ms a frame", "%", title=title)
    for stage, seconds in spent.items():
        share = 100 * seconds / sum(spent.values())
        table.add_row(stage, f"{1e3 * seconds / frames:.2f}", f"{share:.0f}")
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
    detector = darknet_detector(read_cfg(find_cfg(BUNDLED_WEIGHTS)), BUNDLED_WEIGHTS)
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
