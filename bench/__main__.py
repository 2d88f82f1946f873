"""Measure speed and accuracy: ``python -m bench``, or one of its commands."""

import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from bench.drawn import DROPLETS, SEED, drawn_images, write_video
from bench.real import SETS
from bench.real import run as run_real
from data_gen.scenes.dataset import Recipe, make_dataset
from data_gen.scenes.scene_kinds import SCENES
from droptrack.command_line import new_app
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.data.video import Video
from droptrack.detection.decoding import select
from droptrack.detection.engine_choice import Network, choose_detector
from droptrack.evaluation.network_scores import darknet_detector, one_by_one, score_detections
from droptrack.measurement.centre_of_mass import centres_of_mass, load_loops
from droptrack.network.bundled import find_network
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE
from droptrack.pipeline.results import FURTHER_COLUMNS, Results
from droptrack.pipeline.threads import side_by_side
from droptrack.progress import with_progress
from droptrack.tracking.appearance import describe_nothing
from droptrack.tracking.choice import TrackerConfig, make_tracker
from droptrack.tracking.session import TrackingSession

app = new_app()
console = Console()


@app.command()
def dataset(
    images: Annotated[int, typer.Option(min=1, help="Training images of each data set.")] = 10_000,
) -> None:
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
def stages(
    frames: Annotated[int, typer.Option(min=1, help="Frames of the video.")] = 600,
) -> None:
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
        detector = choose_detector(Network(*find_network(), threshold=MIN_SCORE, max_iou=MAX_IOU))
        engine = detector.engine
        tracker, _ = make_tracker(TrackerConfig())
        session = TrackingSession(tracker)
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
                    found = select(chosen, frame.shape[1], frame.shape[0], MIN_SCORE, MAX_IOU)
                with measure("centres of mass"):
                    centres, measured = centres_of_mass(frame, found.boxes)
                with measure("track"):
                    descriptors = describe_nothing(frame, found.boxes)
                    final = session.add(index, found, centres, measured, descriptors)
                with measure("write"):
                    results.write(final)
    title = f"1200 x 600 px, {DROPLETS} droplets, {engine.name}"
    table = Table("stage", "ms a frame", "%", title=title)
    for stage, seconds in spent.items():
        share = 100 * seconds / sum(spent.values())
        table.add_row(stage, f"{1e3 * seconds / frames:.2f}", f"{share:.0f}")
    console.print(table)


@app.command()
def accuracy(
    images: Annotated[int, typer.Option(min=1, help="Images of each scene.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same images.")] = SEED,
) -> None:
    """MAP@0.50 of the bundled model on new images of each scene (Darknet's definition)."""
    detect = one_by_one(darknet_detector(*find_network()))
    table = Table("scene", "mAP@0.50", "precision", "recall", "droplets", title="scores above 0.25")
    for scene in SCENES:
        labelled = with_progress(drawn_images(scene, images, seed=seed), images, scene, "images")
        result = score_detections(detect, labelled)
        table.add_row(
            scene,
            f"{result.average_precision:.4f}",
            f"{result.precision:.4f}",
            f"{result.recall:.4f}",
            str(result.n_ground_truths),
        )
    console.print(table)


@app.command()
def real(
    folder: Annotated[Path, typer.Argument(help="A folder for each set: images, Darknet labels.")],
    weights: Annotated[Path | None, typer.Option(help="Default: the bundled model.")] = None,
    sets: Annotated[str, typer.Option(help="Sets, with commas.")] = ",".join(SETS),
) -> None:
    """What is found on real, labelled images, by droptrack and by what one would use instead."""
    run_real(folder, weights, sets.split(","))


@app.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Without a command: everything."""
    if context.invoked_subcommand is None:
        dataset()
        stages()
        accuracy()


if __name__ == "__main__":
    app()
