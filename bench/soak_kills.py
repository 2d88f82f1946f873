"""Runs of `bench.soak` that are killed at random moments: they go on to the same result.

Or they are refused in one line, and begun anew, as it says.
"""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.random_network import random_weights
from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.network.darknet_cfg import read_cfg
from droptrack.network.darknet_weights import write_weights

MAX_S = 600.0  # of one run
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # the same sums in each run
SMALL_CFG = """[net]
width=64
height=64
batch=2
subdivisions=1
learning_rate=0.001
max_batches=20
[convolutional]
batch_normalize=1
filters=8
size=3
stride=8
pad=1
activation=leaky
[convolutional]
filters=6
size=1
stride=1
activation=linear
[yolo]
mask=0
anchors=16,16
classes=1
num=1
"""
SHEAR = (
    *("width=70", "height=60", "core_radius=7", "shell_radius=22", "core_distance=9"),
    *("window=40", "rest_steps=10"),
)
FEW_IMAGES = (
    "from droptrack.adaptation import training_set as t; t.N_TRAIN, t.N_VALID = 12, 1; "
    "from droptrack.__main__ import app; app()"
)


@dataclass(frozen=True)
class Killable:
    """A command that is killed.

    `command`: that begins it, in a folder which it makes; `goes_on`: the options that it needs for
    going on. `result`: what is compared.
    """

    name: str
    command: Callable[[Path], list[str]]
    goes_on: tuple[str, ...]
    result: Callable[[Path], object]


def killables(folder: Path) -> list[Killable]:
    """Small ones of all that go on; their inputs are made in a folder."""
    data, cfg, video = folder / "data", folder / "small.cfg", folder / "droplets.avi"
    for _ in make_dataset(data, Recipe(scene="a", images=8, valid=2, seed=2), 1):
        pass
    cfg.write_text(SMALL_CFG, encoding="utf-8")
    drifting_discs(video)
    droptrack = [sys.executable, "-m", "droptrack"]
    train = ["train", "--trainer", "torch", "--workers", "0", "--precision", "fp32"]
    train += ["--save-every", "3", "--map-every", "5", "--map-images", "2"]
    train += ["--cfg", str(cfg), "--data", str(data / "obj.data"), "--out"]
    settings = [part for setting in SHEAR for part in ("--set", setting)]
    shear = ["shear", "--cores", "2", "--every", "10", "--steps", "1200", "--device", "cpu"]
    make = ["--scene", "a", "--images", "60", "--valid", "4", "--workers", "2", "--out"]
    adapt = ["adapt", str(video), "--scale", "1", "--iterations", "6", "--batch", "2"]
    adapt += ["--backend", "opencv", "--out"]
    return [
        Killable("train", lambda out: [*droptrack, *train, str(out)], ("--resume",), _trained),
        Killable(
            "simulate",
            lambda out: [
                *(sys.executable, "-m", "data_gen.simulate", *shear, *settings),
                *("--threads", "1", "--out", str(out)),
            ],
            ("--resume",),
            _files_of("truth.csv", "video.avi", "checks.csv", "start.png", "end.png"),
        ),
        Killable(
            "make_dataset",
            lambda out: [sys.executable, "-m", "data_gen.make_dataset", *make, str(out)],
            (),
            _files_of("**/*.jpg", "**/*.txt", "obj.data"),
        ),
        Killable(
            "adapt",
            lambda out: [sys.executable, "-c", FEW_IMAGES, *adapt, str(out)],
            ("--resume",),
            _files_of("adapted.weights", "adapted.cfg", "dataset/**/*.txt", "dataset/**/*.jpg"),
        ),
        Killable("calibrate", _calibrate(folder, data), (), _calibrated),
    ]


def _calibrate(folder: Path, data: Path) -> Callable[[Path], list[str]]:
    cfg = read_cfg(folder / "small.cfg")
    weights = random_weights(cfg, np.random.default_rng(0))
    options = [
        "--images",
        "2",
        "--checked",
        "2",
        "--size",
        "64x64",
        "--data",
        str(data / "obj.data"),
    ]

    def command(out: Path) -> list[str]:
        out.mkdir(exist_ok=True)
        write_weights(out / "small.weights", weights)
        network = ["--cfg", str(cfg.path), "--weights", str(out / "small.weights")]
        return [sys.executable, "-m", "droptrack.calibrate", *options, *network]

    return command


def _calibrated(out: Path) -> object:
    (path,) = out.glob("*.npz")
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[name].tolist() for name in sorted(arrays)}


def _trained(out: Path) -> object:
    """The weights, and the log but for the times and the average, which has 6 digits there."""
    rows = [line.split(",") for line in (out / "training.csv").read_text().splitlines()]
    left_out = [rows[0].index(name) for name in ("seconds", "average_loss")]
    kept = [[v for i, v in enumerate(row) if i not in left_out] for row in rows]
    return kept, _files_of("*_final.weights", "*_best.weights")(out)


def _files_of(*patterns: str) -> Callable[[Path], object]:
    def result(out: Path) -> object:
        return {
            str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
            for pattern in patterns
            for path in sorted(out.glob(pattern))
        }

    return result


def drifting_discs(path: Path) -> None:
    """Five discs that move on, with some noise."""
    rng = np.random.default_rng(0)
    with VideoWriter(path, VideoInfo(320, 160, 25, 20), "MJPG") as video:
        for t in range(20):
            image = np.full((160, 320), 40, np.uint8)
            for i in range(-1, 5):
                cv2.circle(image, (30 + 70 * i + 6 * t, 80), 20, 220, -1, cv2.LINE_AA)
            noisy = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
            video.write(np.repeat(noisy[:, :, None], 3, axis=2))


def killed(one: Killable, folder: Path, rng: np.random.Generator, n: int) -> Iterator[str | None]:
    """Kill a run `n` times; yields what went wrong each time, None where nothing did."""
    began = time.perf_counter()
    first = _run(one.command(folder / "whole"), MAX_S)
    if first is None or first[0]:
        raise RuntimeError(f"{one.name}: {first}")
    usual, expected = time.perf_counter() - began, one.result(folder / "whole")
    out = folder / "killed"
    for number in range(n + 1):
        goes_on = out.exists() and any(out.iterdir())
        # the last is left alone, and begins anew where it is refused
        seconds = MAX_S if number == n else float(rng.uniform(0.05, 1.1)) * usual
        ended = _run([*one.command(out), *(one.goes_on if goes_on else ())], seconds)
        if ended is not None and ended[0] and number == n and _is_one_line(ended[1]):
            shutil.rmtree(out, ignore_errors=True)
            ended = _run(one.command(out), MAX_S)
        yield _judged(one, out, ended, expected)
        if ended is not None:
            shutil.rmtree(out, ignore_errors=True)


def _judged(
    one: Killable, out: Path, ended: tuple[int, str] | None, expected: object
) -> str | None:
    if ended is None:
        return None
    if ended[0]:
        return None if _is_one_line(ended[1]) else ended[1][-2000:]
    return None if one.result(out) == expected else f"{one.name}: another result"


def _is_one_line(said: str) -> bool:
    """Whether a command said why it ended, and nothing of how."""
    lines = [line for line in said.splitlines() if line.startswith("droptrack: ")]
    return len(lines) == 1 and "Traceback" not in said


def _run(command: list[str], seconds: float) -> tuple[int, str] | None:
    """Exit code and stderr of a command; None if it is killed, with all that it began."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, **ONE_THREAD},
    )
    try:
        said = process.communicate(timeout=seconds)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return None
    return process.returncode, said
