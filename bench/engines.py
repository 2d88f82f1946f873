"""Speed of tracking with each engine, ``python -m bench.engines``.

A video of 1200 x 600 px with 50 droplets is followed end to end, from its file to trajectories
without the annotated video, and read by the plain loop of VideoCapture.read, readNetFromDarknet
and NMSBoxes at 416 x 416. All take turns; ratios to the plain loop are of the same turn. "all
cores" is the processors' time for a frame, which says more than the clock where others work too.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from bench.random_network import random_weights
from data_gen.scenes.dataset import JPEG_QUALITY
from data_gen.scenes.scene_kinds import SCENES
from data_gen.scenes.shapes import WHITE, draw_ellipses
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.degradation import degrade
from droptrack.data.detections import Detections, labels
from droptrack.data.frames import Frame, grey_frame
from droptrack.data.stage_times import STAGES
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.data.video import Video, VideoInfo, VideoWriter
from droptrack.detection.detector import Detector, Engine
from droptrack.detection.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.detection.engines.opencv_dnn import OpenCvEngine
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import average_precision
from droptrack.evaluation.validation import darknet_detector
from droptrack.network.bundled import BUNDLED, BUNDLED_WEIGHTS, find_cfg, parse_size
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, resized
from droptrack.network.darknet_weights import read_weights, write_weights
from droptrack.network.pruning import NOTHING, pruned
from droptrack.network.quantisation import (
    Calibration,
    find_calibration,
    joined,
    quantised_layers,
    sha256_of,
    write_calibration,
)
from droptrack.pipeline.run import FURTHER_COLUMNS, Results, follow
from droptrack.tracking.appearance import describe_nothing
from droptrack.tracking.choice import TrackerName, make_tracker
from droptrack.tracking.deepsort import Parameters

SIZE = (1200, 600)
DROPLETS = 50
SCORE, MAX_IOU = 0.4, 0.3
SIZES = "832x416,896x448,960x480,1024x512,1216x608"  # of the tiny network

app = new_app()
console = Console(width=140)


def write_video(path: Path, n_frames: int) -> None:
    """Fifty droplets in five rows that drift and sway, as JPEG pictures."""
    row, column = np.divmod(np.arange(DROPLETS), 10)
    radii = np.random.default_rng(0).uniform(16, 30, DROPLETS)
    with VideoWriter(path, VideoInfo(*SIZE, 25, n_frames), "MJPG", JPEG_QUALITY) as video:
        for t in range(n_frames):
            x = 60 + 116 * column + 20 * np.sin(0.05 * t + row)
            y = 70 + 115 * row + 20 * np.cos(0.07 * t + column)
            canvas = np.zeros(SIZE[::-1], np.uint8)
            draw_ellipses(canvas, np.column_stack([x, y, radii, radii, 0 * x]), WHITE)
            video.write(np.repeat(canvas[..., None], 3, axis=2))


def plain_loop(video: Path, cfg: Cfg, weights: Path, n_frames: int) -> int:
    """What everybody writes first; returns the number of frames."""
    network = cv2.dnn.readNetFromDarknet(str(cfg.path), str(weights))
    outputs = network.getUnconnectedOutLayersNames()
    capture = cv2.VideoCapture(str(video))
    n = 0
    while n < n_frames:
        ok, frame = capture.read()
        if not ok:
            break
        height, width = frame.shape[:2]
        network.setInput(cv2.dnn.blobFromImage(frame, 1 / 255, (416, 416), swapRB=True))
        rows = np.concatenate(network.forward(outputs))
        rows = rows[rows[:, 5] > SCORE]
        boxes = rows[:, :4] * [width, height, width, height]
        boxes[:, :2] -= boxes[:, 2:] / 2
        cv2.dnn.NMSBoxes(boxes.tolist(), rows[:, 5].tolist(), SCORE, MAX_IOU)
        n += 1
    return n


def track(
    frames: Iterator[tuple[int, Frame]], detector: Detector, out: Path, batch: int = 1
) -> Results:
    """Follow the droplets of frames."""
    tracker, _ = make_tracker(TrackerName.droplet, Parameters())
    with TrajectoryWriter(out, {}, FURTHER_COLUMNS) as rows:
        results = Results(rows)
        for _ in follow(frames, detector, tracker, describe_nothing, results, batch=batch):
            pass
    return results


@dataclass(frozen=True)
class Case:
    """One line of the table: a network on an engine, or the plain loop without one."""

    name: str
    cfg: Cfg
    weights: Path
    n_frames: int
    detector: Detector | None


def measure(cases: list[Case], video: Path, turns: int, folder: Path, batch: int) -> None:
    """Run the cases and the plain loop in turn; print medians and ratios to the plain loop."""
    first = cases[0]
    small = cfg_416(first.cfg, folder)
    plain = Case("416 x 416, plain loop", small, first.weights, first.n_frames, None)
    cases = [plain, *cases]
    rates: dict[str, list[float]] = {case.name: [] for case in cases}
    stages: dict[str, list[dict[str, float]]] = {case.name: [] for case in cases}
    work: dict[str, list[float]] = {case.name: [] for case in cases}
    for _ in range(turns):
        for case in cases:
            start, start_work = time.perf_counter(), time.process_time()
            if case.detector is None:
                n = plain_loop(video, case.cfg, case.weights, case.n_frames)
            else:
                source = islice(Video(str(video)).numbered(), case.n_frames)
                results = track(source, case.detector, folder / "t.csv", batch)
                n = results.n_frames
                stages[case.name].append(results.times.milliseconds_a_frame(n))
            rates[case.name].append(n / (time.perf_counter() - start))
            work[case.name].append(1e3 * (time.process_time() - start_work) / n)
    table = Table("", "frames/s", "ratio", "all cores", *STAGES, title="ms a frame")
    base = rates[cases[0].name]
    for case in cases:
        own = rates[case.name]
        ratios = [a / b for a, b in zip(own, base, strict=True)]
        spent = [
            f"{statistics.median(turn[f'{stage}_ms'] for turn in stages[case.name]):.2f}"
            for stage in STAGES
            if stages[case.name]
        ]
        table.add_row(
            case.name,
            f"{statistics.median(own):.1f}",
            f"{statistics.median(ratios):.2f}",
            f"{statistics.median(work[case.name]):.1f}",
            *spent,
        )
    console.print(table)


def detector(cfg: Cfg, weights: Path, backend: str, precision: str) -> Detector | None:
    """A detector, or None (said) where there is none."""
    try:
        network = Network(cfg, weights, SCORE, MAX_IOU)
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
        Case(f"{name} {cfg.width} x {cfg.height}, {engine}", cfg, weights, n_frames, made)
        for engine, made in by_name.items()
    ]


def random_full(folder: Path) -> tuple[Cfg, Path]:
    """The full YOLOv3 with weights by chance, calibrated for speed only, at 416 x 224."""
    from droptrack.detection.engines.openvino import output_ranges

    cfg = resized(read_cfg(BUNDLED / "yolov3.cfg"), 416, 224)
    weights = random_weights(cfg, np.random.default_rng(0))
    path = folder / "yolov3.weights"
    write_weights(path, weights)
    pictures = [np.random.default_rng(1).integers(0, 256, (224, 416, 3)).astype(np.uint8)]
    ranges = joined(cfg, output_ranges(cfg, weights, quantised_layers(cfg), pictures))
    made = Calibration(sha256_of(path), 416, 224, ranges, 1, 0, (0, 0), (0, 0), NOTHING)
    write_calibration(path, cfg, made)
    return cfg, path


@app.command()
@one_line_errors
def speed(
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="The tiny network's input; default the cfg's.")
    ] = None,
    frames: Annotated[int, typer.Option(min=1, help="Of the video, for the tiny network.")] = 300,
    full_frames: Annotated[int, typer.Option(min=0, help="For the full network; 0: none.")] = 40,
    turns: Annotated[int, typer.Option(min=1)] = 3,
    batch: Annotated[int, typer.Option(min=1, help="Frames a network takes at once.")] = 1,
) -> None:
    """Frames a second end to end, against the plain loop."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        video = folder / "video.avi"
        write_video(video, frames)
        cfg = read_cfg(find_cfg(BUNDLED_WEIGHTS))
        if size is not None:
            cfg = resized(cfg, *parse_size(size))
        cases = cases_of("tiny", cfg, BUNDLED_WEIGHTS, frames)
        measure(cases, video, turns, folder, batch)
        if full_frames:
            cases = cases_of("full", *random_full(folder), full_frames)
            measure(cases, video, turns, folder, batch)


def cfg_416(cfg: Cfg, folder: Path) -> Cfg:
    """The network at 416 x 416 in a file of its own, for the plain loop."""
    path = folder / f"{cfg.path.stem}-416.cfg"
    path.write_text(cfg_text(resized(cfg, 416, 416)))
    return read_cfg(path)


@app.command()
@one_line_errors
def network(
    sizes: Annotated[str, typer.Option(help="Inputs, with commas.")] = SIZES,
    repeat: Annotated[int, typer.Option(min=1)] = 9,
) -> None:
    """Processor time of the networks alone, ms of all cores a grey picture, and their ratios.

    In turns, the plain loop's network first; int8 at the sizes for which it is calibrated.
    """
    with tempfile.TemporaryDirectory() as name:
        shipped = read_cfg(find_cfg(BUNDLED_WEIGHTS))
        small = cfg_416(shipped, Path(name))
        engines: dict[str, Engine] = {
            "416x416 opencv fp32, plain loop": OpenCvEngine(
                small, read_weights(BUNDLED_WEIGHTS, small), "opencv", "fp32", SCORE
            )
        }
        networks = [
            (resized(shipped, *parse_size(size)), BUNDLED_WEIGHTS) for size in sizes.split(",")
        ]
        for cfg, weights in [*networks, random_full(Path(name))]:
            calibration = find_calibration(weights, cfg)
            for precision in ("fp32", "bf16", "int8")[: 3 if calibration else 2]:
                engines[f"{cfg.path.stem} {cfg.width}x{cfg.height} openvino {precision}"] = (
                    engine_of(cfg, weights, precision, calibration)
                )
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


def engine_of(cfg: Cfg, weights: Path, precision: str, calibration: Calibration | None) -> Engine:
    """OpenVINO, in int8 as calibrated."""
    from droptrack.detection.engines.openvino import OpenVinoEngine

    values = read_weights(weights, cfg)
    if precision != "int8" or calibration is None:
        return OpenVinoEngine(cfg, values, precision, SCORE, None, streams=2)
    smaller = pruned(cfg, values, calibration.pruning)
    return OpenVinoEngine(*smaller, precision, SCORE, calibration.ranges, streams=2)


@app.command()
@one_line_errors
def accuracy(
    sizes: Annotated[str, typer.Option(help="Inputs, with commas.")] = SIZES,
    images: Annotated[int, typer.Option(min=1, help="Of each scene.")] = 200,
    scenes: Annotated[str, typer.Option()] = "cd",
    spoilt: Annotated[
        bool, typer.Option("--spoilt", help="Pictures as a bad camera shows them.")
    ] = False,
) -> None:
    """MAP@0.50 of the network that ships by input size, precision and scene."""
    table = Table("input", "precision", *(f"scene {scene}" for scene in scenes))
    for size in sizes.split(","):
        cfg = resized(read_cfg(find_cfg(BUNDLED_WEIGHTS)), *parse_size(size))
        for precision in ("fp32", "bf16", "int8"):
            try:
                engine = darknet_detector(
                    cfg, BUNDLED_WEIGHTS, backend=Backend.openvino, precision=Precision(precision)
                )
            except DroptrackError as error:
                console.print(f"left out: {error}")
                continue
            found = [f"{mean_precision(engine, s, images, spoilt=spoilt):.4f}" for s in scenes]
            table.add_row(size, precision, *found)
    console.print(table)


def mean_precision(engine: Detector, scene: str, images: int, *, spoilt: bool) -> float:
    """On pictures that are in no data set, through JPEG as those are."""

    def pairs() -> Iterator[tuple[Detections, Detections]]:
        for index in range(images):
            drawn = SCENES[scene](np.random.default_rng([2026, 2, index]))
            jpeg = cv2.imencode(".jpg", drawn.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
            frame = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
            if spoilt:
                frame = degrade(frame, np.random.default_rng([2026, 3, index]))
            yield engine.detect([frame])[0], labels(drawn.boxes)

    return average_precision(pairs()).average_precision


@app.command()
@one_line_errors
def memory(counts: Annotated[str, typer.Option(help="Frames, with commas.")] = "500,20000") -> None:
    """Peak memory of tracking videos of several lengths, each in a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        video = Path(name) / "video.avi"
        write_video(video, 250)
        for count in counts.split(","):
            arguments = [sys.executable, "-m", "bench.engines", "follow-again", str(video), count]
            subprocess.run(arguments, check=True)


@app.command()
@one_line_errors
def follow_again(video: Path, frames: int) -> None:
    """Follow a video again and again until so many frames are done; prints the peak memory."""

    def endless() -> Iterator[tuple[int, Frame]]:
        number = 0
        while True:
            for frame in Video(str(video)):
                yield number, frame
                number += 1

    cfg = read_cfg(find_cfg(BUNDLED_WEIGHTS))
    found = choose_detector(Network(cfg, BUNDLED_WEIGHTS, SCORE, MAX_IOU))
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
