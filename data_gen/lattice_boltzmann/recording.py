"""Runs a simulation and records it: frames, truth, checks, checkpoints; resumes bit for bit.

While a run goes on, its folder holds `frames/` (PNG) and `checkpoint.npz`; at the end video.avi,
truth.csv, checks.csv and three pictures are made from them, and the frames are removed.
"""

import contextlib
import csv
import json
import shutil
import signal
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from data_gen.lattice_boltzmann.camera import Camera, capture
from droptrack.data.arrays import Floats
from droptrack.data.files import replacing
from droptrack.data.trajectories import BOX_CENTRE, TrajectoryWriter, sorted_trajectories
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.errors import DroptrackError
from droptrack.progress import progress_bar
from droptrack.version import __version__

CHECK_STEPS = 50  # between looks for instability
PICTURES = ("start", "middle", "end")


class Simulation(Protocol):
    """What is recorded."""

    name: str
    parameters: Mapping[str, object]

    @property
    def step(self) -> int:
        """Steps done."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in nodes."""

    @property
    def device(self) -> str:
        """What it runs on."""

    def run(self, steps: int) -> None:
        """Advance."""

    def patches(self) -> list[tuple[Floats, Floats]]:
        """For every droplet: its fraction (h, w) in 0..1, and the [y, x] of that array's corner."""

    def shade(self) -> Floats:
        """Brightness (H, W) in 0..1, y up."""

    def unstable(self) -> str | None:
        """What has gone wrong, if anything; cheap, asked every few steps."""

    def checks(self) -> dict[str, float]:
        """Values to watch."""

    def finished(self) -> bool:
        """Whether what was to be seen has been."""

    def arrays(self) -> dict[str, Any]:
        """The state, for a checkpoint."""

    def load(self, arrays: Mapping[str, Any]) -> None:
        """Go on from a checkpoint's state."""


@dataclass(frozen=True)
class Recording:
    """How to record: the first and the last step, steps a frame, frames a second, a checkpoint
    every so many frames.
    """  # noqa: D205

    first: int
    last: int
    every: int
    fps: int
    camera: Camera
    checkpoint_frames: int = 20

    def __post_init__(self) -> None:
        if self.every < 1 or self.last < self.first + self.every or self.checkpoint_frames < 1:
            raise DroptrackError("--steps should be one frame or more, --every one step or more")


def truth_rows(simulation: Simulation, frame: int, scale: int) -> Floats:
    """Rows [frame, id, x, y, box cx, cy, w, h, area] of the droplets, in px, y down.

    x, y: centre of mass where the fraction exceeds 1/2; box and area: of that region. A droplet of
    which nothing is left has no row.
    """
    rows = []
    height = simulation.size[1]
    for k, (fraction, corner) in enumerate(simulation.patches()):
        mask = fraction > 0.5
        if not mask.any():
            continue
        y, x = np.nonzero(mask)
        weight = fraction[mask]
        cx = corner[1] + np.average(x + 0.5, weights=weight)
        cy = height - corner[0] - np.average(y + 0.5, weights=weight)
        left, right = corner[1] + x.min(), corner[1] + x.max() + 1
        top, bottom = height - corner[0] - y.max() - 1, height - corner[0] - y.min()
        box = [(left + right) / 2, (top + bottom) / 2, right - left, bottom - top]
        lengths = scale * np.array([cx, cy, *box])
        rows.append([frame, k + 1, *lengths, scale**2 * mask.sum()])
    return np.array(rows, float).reshape(-1, 9)


class SimulationRecorder:
    """A recording in a folder."""

    def __init__(self, simulation: Simulation, out: Path, recording: Recording) -> None:
        self.simulation, self.out, self.recording = simulation, out, recording
        self.truth: list[Floats] = []
        self.checks: list[list[float]] = []
        self.check_names: list[str] = []
        self._frames = out / "frames"
        self._stop = False
        self._about = {
            "version": __version__,
            "simulation": simulation.name,
            "parameters": dict(simulation.parameters),
            "recording": asdict(recording),
        }

    def run(self, *, resume: bool) -> str:
        """Run to the end; returns a summary. Raises DroptrackError when the run goes unstable."""
        if resume:
            self._load()
        else:
            if (self.out / "checkpoint.npz").exists():
                raise DroptrackError(
                    f"{self.out}: holds a run already; give --resume or another folder"
                )
            self._frames.mkdir(parents=True, exist_ok=True)
            text = json.dumps(self._about, indent=2)
            (self.out / "parameters.json").write_text(text + "\n", encoding="utf-8")
        start, first_step = time.perf_counter(), self.simulation.step
        with stopped_by_signals(self._ask_to_stop):
            self._loop()
        elapsed = time.perf_counter() - start
        self._finish()
        done = self.simulation.step - first_step
        width, height = self.simulation.size
        speed = done / elapsed if done else 0.0
        return (
            f"{self.out / 'video.avi'}: {len(self.truth)} frames, {self.simulation.step} steps; "
            f"{speed:.4g} steps/s, {speed * width * height / 1e6:.3g} million lattice updates/s "
            f"on {self.simulation.device}"
        )

    def _ask_to_stop(self, *_: object) -> None:
        self._stop = True

    def _loop(self) -> None:
        simulation, recording = self.simulation, self.recording
        width, height = simulation.size
        frames = (recording.last - recording.first) // recording.every + 1
        with progress_bar("frames") as progress:
            task = progress.add_task(
                f"{simulation.name} on {simulation.device}",
                total=frames,
                completed=len(self.truth),
                note="starting",
            )
            while len(self.truth) < frames and not (self.truth and simulation.finished()):
                clock, before = time.perf_counter(), simulation.step
                self._advance(recording.first + len(self.truth) * recording.every)
                speed = (simulation.step - before) / (time.perf_counter() - clock)
                values = self._record()
                watched = " ".join(f"{name} {value:.4g}" for name, value in values.items())
                updates = speed * width * height / 1e6
                note = f"{speed:.0f} steps/s, {updates:.1f} M updates/s, {watched}"
                progress.update(task, completed=len(self.truth), note=note)
                if len(self.truth) % recording.checkpoint_frames == 0:
                    self._save()
        self._save()

    def _advance(self, until: int) -> None:
        """Run to a step; stop at once where the simulation goes unstable."""
        while self.simulation.step < until:
            if self._stop:
                self._save()
                raise KeyboardInterrupt
            self.simulation.run(min(CHECK_STEPS, until - self.simulation.step))
            trouble = self.simulation.unstable()
            if trouble:
                kept = (self.out / "checkpoint.npz").exists()
                last = "; the last checkpoint is kept" if kept else ""
                raise DroptrackError(
                    f"{self.simulation.name}: unstable at step {self.simulation.step}: "
                    f"{trouble}{last}"
                )

    def _record(self) -> dict[str, float]:
        index = len(self.truth)
        image = capture(self.simulation.shade(), self.recording.camera, index)
        write_png(self._frames / f"{index:06d}.png", image)
        values = self.simulation.checks()
        self.check_names = list(values)
        rows = truth_rows(self.simulation, index, self.recording.camera.scale)
        self.checks = [*self.checks[:index], [index, self.simulation.step, *values.values()]]
        self.truth.append(rows)
        return values

    def _save(self) -> None:
        """Write the checkpoint: complete or not at all."""
        if not self.truth:
            return  # nothing yet that would be lost
        counts = [len(rows) for rows in self.truth]
        with replacing(self.out / "checkpoint.npz") as partial:
            np.savez(
                partial,
                about=json.dumps(self._about),
                truth=np.concatenate(self.truth),
                counts=np.array(counts, np.int64),
                checks=np.array(self.checks, float),
                check_names=np.array(self.check_names),
                **{f"state_{name}": array for name, array in self.simulation.arrays().items()},
            )

    def _load(self) -> None:
        path = self.out / "checkpoint.npz"
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                data = dict(stored)
        except FileNotFoundError:
            raise DroptrackError(f"{path}: no such file, so there is no run to resume") from None
        except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise DroptrackError(f"{path}: cannot be read as a checkpoint: {error}") from None
        if "about" not in data:
            raise DroptrackError(f"{path}: is no checkpoint of a simulation")
        theirs, ours = json.loads(str(data["about"])), json.loads(json.dumps(self._about))
        for part in ours:
            if theirs.get(part) != ours[part]:
                different = part
                if isinstance(ours[part], dict) and isinstance(theirs.get(part), dict):
                    names = [n for n in ours[part] if theirs[part].get(n) != ours[part][n]]
                    different = f"{part} {', '.join(names)}"
                raise DroptrackError(
                    f"{path}: is of another run, with other {different}; give the same options"
                )
        missing = [
            i for i in range(len(data["counts"])) if not (self._frames / f"{i:06d}.png").exists()
        ]
        if missing:
            raise DroptrackError(
                f"{self.out}: frame {missing[0]} of the run is missing, as the run is complete or "
                "files were removed; run anew in another folder"
            )
        self.truth = list(np.split(data["truth"], np.cumsum(data["counts"])[:-1]))
        self.checks = data["checks"].tolist()
        self.check_names = data["check_names"].tolist()
        prefix = "state_"
        self.simulation.load(
            {k.removeprefix(prefix): v for k, v in data.items() if k.startswith(prefix)}
        )

    def _finish(self) -> None:
        """Video, truth, checks and pictures from what was recorded."""
        n, camera = len(self.truth), self.recording.camera
        width, height = (camera.scale * length for length in self.simulation.size)
        info = VideoInfo(width, height, self.recording.fps, n)
        with VideoWriter(self.out / "video.avi", info, "MJPG") as video:
            for index in range(n):
                path = self._frames / f"{index:06d}.png"
                image = cv2.imread(str(path))
                if image is None:
                    raise DroptrackError(f"{path}: cannot be read back")
                video.write(np.asarray(image, np.uint8))
        for name, index in zip(PICTURES, (0, n // 2, n - 1), strict=True):
            shutil.copyfile(self._frames / f"{index:06d}.png", self.out / f"{name}.png")
        about = {
            "made by": f"droptrack {__version__}, data_gen.simulate {self.simulation.name}",
            "parameters": "in parameters.json",
            "video": f"video.avi, {width} x {height} px, {self.recording.fps} frames/s",
            "steps": f"{self.recording.first} + {self.recording.every} a frame",
            "units": "px and px^2; centre of mass, box and area of where the droplet's fraction "
            "exceeds 1/2",
        }
        rows = np.concatenate(self.truth)
        ids, ones = rows[:, :2].astype(np.int64), np.ones(len(rows))
        table = sorted_trajectories(
            ids[:, 0], ids[:, 1], rows[:, 2], rows[:, 3], rows[:, 4:8], ones, ones.astype(bool)
        )  # rows are in order already
        with TrajectoryWriter(self.out / "truth.csv", about, (*BOX_CENTRE, "area")) as writer:
            writer.write(table, (rows[:, 4], rows[:, 5], rows[:, 8]))
        with (self.out / "checks.csv").open("w", newline="", encoding="utf-8") as file:
            table_writer = csv.writer(file, lineterminator="\n")
            table_writer.writerow(["frame", "step", *self.check_names])
            table_writer.writerows(
                [int(row[0]), int(row[1]), *(f"{value:.8g}" for value in row[2:])]
                for row in self.checks
            )
        shutil.rmtree(self._frames)


@contextlib.contextmanager
def stopped_by_signals(handler: Callable[..., None]) -> Iterator[None]:
    """Call a handler on Ctrl-C and on a request to end; compiled code must not be interrupted."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.signal(s, handler) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def write_png(path: Path, image: Any) -> None:
    """Write an image; raises OSError where cv2 would only return false."""
    ok, data = cv2.imencode(".png", image)
    if not ok:
        raise DroptrackError(f"{path}: cannot be encoded")
    path.write_bytes(data.tobytes())
