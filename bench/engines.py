"""Speed of tracking with each engine, ``python -m bench.engines``.

The droplets of a video, 1200 x 600 px and 50 of them, are tracked from its file to trajectories
without the annotated video; the plain loop of VideoCapture.read, readNetFromDarknet at 416 x 416
and NMSBoxes reads it, too. All take turns; ratios to the plain loop are of the same turn. "all
cores" is the processors' time for a frame, which says more than the clock on a shared machine.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from bench.drawn import drawn_images, write_video
from bench.random_network import random_weights
from data_gen.scenes.scene_kinds import SCENES
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.frames import Frame, grey_frame
from droptrack.data.stage_times import STAGES
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.data.video import Video
from droptrack.detection.detector import Detector, Engine
from droptrack.detection.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.detection.engines.opencv_dnn import OpenCvEngine, reads_darknet
from droptrack.errors import DroptrackError
from droptrack.evaluation.network_scores import darknet_detector, one_by_one, score_detections
from droptrack.network.bundled import BUNDLED, BUNDLED_WEIGHTS, find_cfg, find_network
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, resized
from droptrack.network.darknet_weights import read_weights, write_weights
from droptrack.network.pruning import NO_PRUNING, pruned
from droptrack.network.quantisation import (
    Calibration,
    find_calibration,
    merge_ranges,
    quantised_layers,
    sha256_of,
    write_calibration,
)
from droptrack.options import SizeOption
from droptrack.pipeline.config import MAX_IOU, MIN_SCORE
from droptrack.pipeline.loop import track_frames
from droptrack.pipeline.results import FURTHER_COLUMNS, Results
from droptrack.tracking.appearance import describe_nothing
from droptrack.tracking.choice import TrackerConfig, make_tracker

PLAIN_SIZE = (416, 416)  # the input in the plain loop
FULL_SIZE = (416, 224)  # of the full YOLOv3
SIZES = "832x416,896x448,960x480,1024x512,1216x608"  # of the tiny network

SizesOption = Annotated[str, typer.Option(help="Inputs of the bundled model, with commas.")]

app = new_app()
console = Console(width=140)


def plain_loop(video: Path, cfg: Cfg, weights: Path, n_frames: int) -> int:
    """The loop of a first attempt; returns the number of frames."""
    if not reads_darknet():
        raise DroptrackError(f"the plain loop needs OpenCV 4; this is {cv2.__version__}")
    network = cv2.dnn.readNetFromDarknet(str(cfg.path), str(weights))
    outputs = network.getUnconnectedOutLayersNames()
    capture = cv2.VideoCapture(str(video))
    n = 0
    while n < n_frames:
        ok, frame = capture.read()
        if not ok:
            break
        height, width = frame.shape[:2]
        network.setInput(cv2.dnn.blobFromImage(frame, 1 / 255, PLAIN_SIZE, swapRB=True))
        rows = np.concatenate(network.forward(outputs))
        rows = rows[rows[:, 5] > MIN_SCORE]
        boxes = rows[:, :4] * [width, height, width, height]
        boxes[:, :2] -= boxes[:, 2:] / 2
        cv2.dnn.NMSBoxes(boxes.tolist(), rows[:, 5].tolist(), MIN_SCORE, MAX_IOU)
        n += 1
    return n


def track(
    frames: Iterator[tuple[int, Frame]], detector: Detector, out: Path, batch: int = 1
) -> Results:
    """Track the droplets of frames."""
    tracker, _ = make_tracker(TrackerConfig())
    with TrajectoryWriter(out, {}, FURTHER_COLUMNS) as rows:
        results = Results(rows)
        for _ in track_frames(frames, detector, tracker, describe_nothing, results, batch=batch):
            pass
    return results


@dataclass(frozen=True, kw_only=True)
class Case:
    """One line of the table: a network on an engine, or the plain loop without one."""

    name: str
    cfg: Cfg
    weights: Path
    n_frames: int
    detector: Detector | None


@dataclass
class Measured:
    """What was measured of a case, turn by turn."""

    rates: list[float] = field(default_factory=list)  # frames a second
    stages: list[dict[str, float]] = field(default_factory=list)  # ms a frame
    work: list[float] = field(default_factory=list)  # processor time, ms a frame


def measure(cases: list[Case], video: Path, turns: int, folder: Path, batch: int) -> None:
    """Run the cases and the plain loop in turn; print medians and ratios to the plain loop."""
    first = cases[0]
    plain = Case(
        name=f"{PLAIN_SIZE[0]} x {PLAIN_SIZE[1]}, plain loop",
        cfg=plain_cfg(first.cfg, folder),
        weights=first.weights,
        n_frames=first.n_frames,
        detector=None,
    )
    measured = {case.name: Measured() for case in (plain, *cases)}
    for _ in range(turns):
        for case in (plain, *cases):
            run_case(case, video, folder, batch, measured[case.name])
            console.print(f"{case.name}: {measured[case.name].rates[-1]:.1f} frames/s")
    table = Table("", "frames/s", "ratio", "all cores", *STAGES, title="ms a frame")
    for name, own in measured.items():
        ratios = [a / b for a, b in zip(own.rates, measured[plain.name].rates, strict=True)]
        spent = [
            f"{statistics.median(turn[f'{stage}_ms'] for turn in own.stages):.2f}"
            for stage in STAGES
            if own.stages
        ]
        table.add_row(
            name,
            f"{statistics.median(own.rates):.1f}",
            f"{statistics.median(ratios):.2f}",
            f"{statistics.median(own.work):.1f}",
            *spent,
        )
    console.print(table)


def run_case(case: Case, video: Path, folder: Path, batch: int, measured: Measured) -> None:
    """Run a case once and add what it took."""
    start, start_work = time.perf_counter(), time.process_time()
    if case.detector is None:
        n = plain_loop(video, case.cfg, case.weights, case.n_frames)
    else:
        source = islice(Video(str(video)).numbered(), case.n_frames)
        results = track(source, case.detector, folder / "t.csv", batch)
        n = results.n_frames
        measured.stages.append(results.times.milliseconds_a_frame(n))
    measured.rates.append(n / (time.perf_counter() - start))
    measured.work.append(1e3 * (time.process_time() - start_work) / n)


def detector(cfg: Cfg, weights: Path, backend: str, precision: str) -> Detector | None:
    """A detector, or None (said) where there is none."""
    try:
        network = Network(cfg, weights, threshold=MIN_SCORE, max_iou=MAX_IOU)
        return choose_detector(network, Backend(backend), Precision(precision))
    except DroptrackError as error:
        console.print(f"left out: {error}")
        return None


ENGINES = (
    ("opencv", "fp32"),
    ("opencv", "auto"),
    ("torch", "fp32"),
    ("openvino", "fp32"),
    ("openvino", "bf16"),
    ("openvino", "int8"),
    ("torch-cuda", "fp16"),
)


def cases_of(name: str, cfg: Cfg, weights: Path, n_frames: int) -> list[Case]:
    """A network on every engine that is here."""
    found = [detector(cfg, weights, *engine) for engine in ENGINES]
    by_name = {made.engine.name: made for made in found if made is not None}
    return [
        Case(
            name=f"{name} {cfg.width} x {cfg.height}, {engine}",
            cfg=cfg,
            weights=weights,
            n_frames=n_frames,
            detector=made,
        )
        for engine, made in by_name.items()
    ]


def random_full(folder: Path) -> tuple[Cfg, Path]:
    """The full YOLOv3 with random weights at FULL_SIZE, calibrated for speed only."""
    cfg = resized(read_cfg(BUNDLED / "yolov3.cfg"), *FULL_SIZE)
    weights = random_weights(cfg, np.random.default_rng(0))
    path = folder / "yolov3.weights"
    write_weights(path, weights)
    if find_spec("openvino") is None:
        return cfg, path
    from droptrack.detection.engines.openvino import output_ranges

    shape = (cfg.height, cfg.width, 3)
    images = [np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)]
    ranges = merge_ranges(cfg, output_ranges(cfg, weights, quantised_layers(cfg), images))
    calibration = Calibration(
        weights_sha256=sha256_of(path),
        width=cfg.width,
        height=cfg.height,
        ranges=ranges,
        n_calibrated=len(images),
        n_checked=0,
        map_fp32=(0, 0),
        map_int8=(0, 0),
        pruning=NO_PRUNING,
    )
    write_calibration(path, calibration)
    return cfg, path


@app.command()
@one_line_errors
def speed(
    size: SizeOption = None,
    frames: Annotated[int, typer.Option(min=1, help="Frames for the bundled model.")] = 300,
    full_frames: Annotated[
        int, typer.Option(min=0, help="Frames for the full YOLOv3; 0: leave it out.")
    ] = 40,
    turns: Annotated[int, typer.Option(min=1, help="Times that all are measured.")] = 3,
    batch: Annotated[int, typer.Option(min=1, help="Frames a network takes at once.")] = 1,
) -> None:
    """Frames a second end to end, against the plain loop."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        video = folder / "video.avi"
        write_video(video, frames)
        cases = cases_of("tiny", *find_network(size=size), frames)
        measure(cases, video, turns, folder, batch)
        if full_frames:
            cases = cases_of("full", *random_full(folder), full_frames)
            measure(cases, video, turns, folder, batch)


def plain_cfg(cfg: Cfg, folder: Path) -> Cfg:
    """The network at PLAIN_SIZE in a file of its own, for the plain loop."""
    path = folder / f"{cfg.path.stem}-plain.cfg"
    path.write_text(cfg_text(resized(cfg, *PLAIN_SIZE)))
    return read_cfg(path)


@app.command()
@one_line_errors
def network(
    sizes: SizesOption = SIZES,
    repeat: Annotated[int, typer.Option(min=1, help="Times that all are measured.")] = 9,
) -> None:
    """Processor time of the networks alone, ms of all cores a grey image, and their ratios.

    In turns, the plain loop's network first; int8 at the sizes for which it is calibrated.
    """
    with tempfile.TemporaryDirectory() as name:
        engines = network_engines(sizes.split(","), Path(name))
        times: dict[str, list[float]] = {key: [] for key in engines}
        frame = grey_frame(SCENES["c"](np.random.default_rng(0)).image)
        for turn in range(repeat + 1):
            for key, engine in engines.items():
                prepared = engine.prepare([frame])
                start = time.process_time()
                engine.start(prepared).result()
                if turn:  # the first is slower
                    times[key].append(1e3 * (time.process_time() - start))
        table = Table("network", "ms, all cores", "ratio")
        base = statistics.median(next(iter(times.values())))
        for key, own in times.items():
            median = statistics.median(own)
            table.add_row(key, f"{median:.1f}", f"{base / median:.2f}")
        console.print(table)


def network_engines(sizes: list[str], folder: Path) -> dict[str, Engine]:
    """The bundled model in OpenCV, then in OpenVINO at each size, then the full YOLOv3; by name."""
    small = plain_cfg(read_cfg(find_cfg(BUNDLED_WEIGHTS)), folder)
    engines: dict[str, Engine] = {
        f"{small.width}x{small.height} opencv fp32, plain loop": OpenCvEngine(
            small, read_weights(BUNDLED_WEIGHTS, small), "opencv", "fp32", MIN_SCORE
        )
    }
    for cfg, weights in [*(find_network(size=size) for size in sizes), random_full(folder)]:
        calibration = find_calibration(weights, cfg)
        for precision in ("fp32", "bf16", "int8")[: 3 if calibration else 2]:
            name = f"{cfg.path.stem} {cfg.width}x{cfg.height} openvino {precision}"
            engines[name] = engine_of(cfg, weights, precision, calibration)
    return engines


def engine_of(cfg: Cfg, weights: Path, precision: str, calibration: Calibration | None) -> Engine:
    """OpenVINO, in int8 as calibrated."""
    from droptrack.detection.engines.openvino import OpenVinoEngine

    values = read_weights(weights, cfg)
    if precision != "int8" or calibration is None:
        return OpenVinoEngine(cfg, values, precision, MIN_SCORE, None, streams=2)
    smaller = pruned(cfg, values, calibration.pruning)
    return OpenVinoEngine(*smaller, precision, MIN_SCORE, calibration.ranges, streams=2)


@app.command()
@one_line_errors
def accuracy(
    sizes: SizesOption = SIZES,
    images: Annotated[int, typer.Option(min=1, help="Images of each scene.")] = 200,
    scenes: Annotated[str, typer.Option(help="Scenes, a letter each.")] = "cd",
    degraded: Annotated[bool, typer.Option("--degraded", help="Degrade the images.")] = False,
    spoilt: Annotated[bool, typer.Option("--spoilt", hidden=True)] = False,
) -> None:
    """MAP@0.50 of the bundled model by input size, precision and scene."""
    table = Table("input", "precision", *(f"scene {scene}" for scene in scenes))
    for size in sizes.split(","):
        for precision in (Precision.fp32, Precision.bf16, Precision.int8):
            try:
                detector = darknet_detector(
                    *find_network(size=size), backend=Backend.openvino, precision=precision
                )
            except DroptrackError as error:
                console.print(f"left out: {error}")
                continue
            found = []
            for scene in scenes:
                labelled = drawn_images(scene, images, degraded=degraded or spoilt)
                scores = score_detections(one_by_one(detector), labelled)
                found.append(f"{scores.average_precision:.4f}")
            table.add_row(size, precision, *found)
    console.print(table)


@app.command()
@one_line_errors
def memory(
    counts: Annotated[str, typer.Option(help="Numbers of frames, with commas.")] = "500,20000",
) -> None:
    """Peak memory of tracking videos of several lengths, each in a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        video = Path(name) / "video.avi"
        write_video(video, 250)
        for count in counts.split(","):
            arguments = [sys.executable, "-m", "bench.engines", "track-again", str(video), count]
            subprocess.run(arguments, check=True)


@app.command()
@app.command("follow-again", hidden=True)
@one_line_errors
def track_again(video: Path, frames: int) -> None:
    """Track a video again and again until so many frames are done; prints the peak memory."""

    def endless() -> Iterator[tuple[int, Frame]]:
        number = 0
        while True:
            for frame in Video(str(video)):
                yield number, frame
                number += 1

    found = choose_detector(Network(*find_network(), threshold=MIN_SCORE, max_iou=MAX_IOU))
    start = time.perf_counter()
    results = track(islice(endless(), frames), found, video.with_suffix(".csv"))
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    console.print(
        f"{found.engine.name}: {results.n_frames} frames, {len(results.paths.table())} droplets, "
        f"peak memory {peak:.0f} MB, {results.n_frames / seconds:.1f} frames/s"
    )


@app.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Without a command: speed."""
    if context.invoked_subcommand is None:
        speed()


if __name__ == "__main__":
    app()
