"""The stage ``speed``: frames a second of both networks, alone and from the file to trajectories.

Where no trained weights are at hand, weights are random: the network takes as long, but what it
finds is random, too.
"""

import os
import platform
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from bench.engines import detector
from bench.random_network import random_weights
from bench.reproduction.folder import Reproduction
from bench.reproduction.networks import PAPER_NAMES
from droptrack.data.frames import Frame, grey_frame
from droptrack.data.trajectories import TrajectoryWriter
from droptrack.data.video import Video
from droptrack.detection.detector import Detector
from droptrack.network.bundled import BUNDLED, find_network
from droptrack.network.darknet_cfg import Cfg, read_cfg, resized
from droptrack.network.darknet_weights import write_weights
from droptrack.pipeline.loop import track_frames
from droptrack.pipeline.results import FURTHER_COLUMNS, Results
from droptrack.tracking.choice import TrackerConfig, TrackerName, choose_descriptor, make_tracker

INPUT = (416, 416)  # of YOLO as it is mostly used; the paper does not say its own
REPEATED, REPEATED_FULL = 20, 5  # times that a network runs alone
ENGINES = (("opencv", "fp32"), ("openvino", "auto"), ("torch-cuda", "auto"))
# of the paper's table 1: an i3-2328M, an RTX 2060 Super
PAPER_FPS = {"YOLOv3-tiny": (2.44, 35.0), "YOLOv3": (0.25, 12.0)}


def measure_speed(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Time every network on every engine that is here, on the paper's test video."""
    folder, video = of.folder("speed"), of.folder("simulations") / "sine" / "video.avi"
    folder.mkdir(exist_ok=True)
    rows: list[dict[str, Any]] = []
    for name, cfg, weights, n_frames, repeated in _networks(of, folder):
        for backend, precision in ENGINES:
            if not _is_here(backend):
                continue
            made = detector(cfg, weights, backend, precision)
            if made is None:
                continue
            alone = _alone(made, repeated)
            deepsort, n_boxes = _end_to_end(made, video, folder, n_frames, TrackerName.deepsort)
            droplet, _ = _end_to_end(made, video, folder, n_frames, TrackerName.droplet)
            row = {
                "network": name,
                "input": f"{cfg.width} x {cfg.height}",
                "weights": "random" if weights.parent == folder else "trained",
                "engine": made.engine.name,
                "gpu": backend == "torch-cuda",
                "boxes_per_frame": n_boxes,
                "network_alone_fps": alone,
                "with_deepsort_fps": deepsort,
                "with_droptrack_fps": droplet,
            }
            say(f"{name} {row['input']}, {row['engine']}: {row['with_deepsort_fps']:.3g} frames/s")
            rows.append(row)
        if weights.parent == folder:
            weights.unlink()  # hundreds of MB
    return {"rows": rows, "machine": f"{processor()}, {cores()} cores", "gpu": _gpu()}


def _networks(of: Reproduction, folder: Path) -> Iterator[tuple[str, Cfg, Path, int, int]]:
    """Name, network, weights, frames to track, and how often it runs alone."""
    settings, trained = of.settings, of.result("networks")
    yield ("bundled model", *find_network(), settings.speed_frames, REPEATED)
    for key, stem, n_frames, repeated in (
        ("tiny", "yolov3-tiny", settings.speed_frames, REPEATED),
        ("full", "yolov3", settings.speed_frames_full, REPEATED_FULL),
    ):
        if not n_frames:
            continue
        if "weights" in trained[key]:
            cfg, weights = find_network(Path(trained[key]["weights"]))
        else:
            cfg = resized(read_cfg(BUNDLED / f"{stem}.cfg"), *INPUT)
            weights = folder / f"{stem}.weights"
            write_weights(weights, random_weights(cfg, np.random.default_rng(0)))
        yield PAPER_NAMES[key], cfg, weights, n_frames, repeated


def _alone(made: Detector, repeated: int) -> float:
    """Images a second through the network, one after the other."""
    engine = made.engine
    image = np.random.default_rng(0).integers(0, 256, (600, 1200)).astype(np.uint8)
    prepared = engine.prepare([grey_frame(image)])
    engine.start(prepared).result()
    times = []
    for _ in range(repeated):
        start = time.perf_counter()
        engine.start(prepared).result()
        times.append(time.perf_counter() - start)
    return 1 / float(np.median(times))


def _end_to_end(
    made: Detector, video: Path, folder: Path, n_frames: int, name: TrackerName
) -> tuple[float, float]:
    """Frames a second from the video's file to trajectories, without an annotated video.

    And the boxes of a frame, on average.
    """
    config = TrackerConfig(name=name)
    source: Iterator[tuple[int, Frame]] = islice(Video(str(video)).numbered(), n_frames)
    start = time.perf_counter()
    with TrajectoryWriter(folder / "rows.csv", {}, FURTHER_COLUMNS) as rows:
        results = Results(rows)
        made_tracker, describe = make_tracker(config)[0], choose_descriptor(config)
        for _ in track_frames(source, made, made_tracker, describe, results):
            pass
    (folder / "rows.csv").unlink()
    seconds = time.perf_counter() - start
    return results.n_frames / seconds, results.n_detections / results.n_frames


def _is_here(backend: str) -> bool:
    if backend == "openvino":
        return find_spec("openvino") is not None
    return backend != "torch-cuda" or bool(_gpu())


def _gpu() -> str:
    """The name of the GPU that PyTorch can use, or nothing."""
    if find_spec("torch") is None:
        return ""
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else ""


def processor() -> str:
    """The processor's name, as the system says it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
