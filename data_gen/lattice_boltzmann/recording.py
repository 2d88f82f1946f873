"""Runs a simulation and records it: frames, ground truth, checks, checkpoints.

During a run its folder holds `frames/` (PNG) and `checkpoint.npz`; at the end video.avi, truth.csv,
checks.csv and three images are made from them, and the frames are removed. An interrupted run
resumes bit for bit.
"""

import contextlib
import csv
import json
import shutil
import signal
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_gen.lattice_boltzmann.camera import Camera, capture
from data_gen.lattice_boltzmann.settings import Device, usable_device, use_threads
from data_gen.lattice_boltzmann.simulation import AnySimulation, P, Simulation
from droptrack.data.arrays import Floats, Rows
from droptrack.data.files import replacing, write_text
from droptrack.data.sources.image_files import write_image_file
from droptrack.data.trajectories import BOX_CENTRE, TrajectoryWriter, sorted_trajectories
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.errors import DroptrackError
from droptrack.progress import progress_bar
from droptrack.version import __version__

CHECK_STEPS = 50  # between checks for instability
SNAPSHOTS = ("start", "middle", "end")  # frames that are kept as images
AREA_AND_AXES = ("area", "major_px", "minor_px", "angle_rad")  # columns after the boxes
STATE = "state_"  # before the names of a checkpoint's arrays of the state


@dataclass(frozen=True, kw_only=True)
class Recording:
    """How to record. Raises DroptrackError where there would be less than one frame."""

    first: int  # step of the first frame
    last: int  # step after which no frame comes
    every: int  # steps per frame
    fps: int  # frames per second of the video
    camera: Camera
    checkpoint_frames: int = 20  # frames per checkpoint

    def __post_init__(self) -> None:
        if self.every < 1 or self.last < self.first + self.every or self.checkpoint_frames < 1:
            raise DroptrackError("--steps should be one frame or more, --every one step or more")


def record(
    kind: type[Simulation[P, Any]],
    params: P,
    out: Path,
    recording: Recording,
    *,
    device: Device = "cpu",
    threads: int = 0,
    resume: bool = False,
    say: Callable[[str], object] = print,
) -> str:
    """Run a simulation from its start and record it in a folder; returns a summary.

    On `threads` of the CPU, 0 for all, or on a GPU; `say` is told why `auto` does not use one.
    Raises DroptrackError for what is not installed, and when the simulation goes unstable.
    """
    use_threads(threads)
    usable = usable_device(device, say)
    simulation = kind(params, kind.initial_state(params), usable)
    return SimulationRecorder(simulation, out, recording).run(resume=resume)


def ground_truth_rows(simulation: AnySimulation, frame: int, scale: int) -> Floats:
    """Rows (N, 12) [frame, id, x, y, box cx, cy, w, h, *AREA_AND_AXES] of the droplets, px, y down.

    x, y: centre of mass where the fraction exceeds 1/2; box, area and axes: of that region. A
    droplet of which nothing is left has no row.
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
        major, minor, angle = axes_of(x, -y)
        rows.append(
            [frame, k + 1, *lengths, scale**2 * mask.sum(), scale * major, scale * minor, angle]
        )
    return np.array(rows, float).reshape(-1, 8 + len(AREA_AND_AXES))


def axes_of(x: Rows, y: Rows) -> tuple[float, float, float]:
    """Major and minor axis, in nodes, of the ellipse with the second moments of nodes x, y (M,).

    And the angle of the major axis from x towards y, in (-pi/2, pi/2]. A node is a unit square.
    """
    xx, yy, xy = x.var() + 1 / 12, y.var() + 1 / 12, ((x - x.mean()) * (y - y.mean())).mean()
    middle, spread = (xx + yy) / 2, float(np.hypot((xx - yy) / 2, xy))
    return (
        float(4 * np.sqrt(middle + spread)),
        float(4 * np.sqrt(middle - spread)),
        float(np.arctan2(2 * xy, xx - yy) / 2),
    )


class SimulationRecorder:
    """A recording in a folder: what is known of each frame, and the files made from it."""

    def __init__(self, simulation: AnySimulation, out: Path, recording: Recording) -> None:
        self.simulation, self.out, self.recording = simulation, out, recording
        self.ground_truth: list[Floats] = []  # rows of each frame
        self.checks: list[list[float]] = []  # frame, step and values
        self.check_names: list[str] = []
        self._checkpoint = out / "checkpoint.npz"
        self._stop = False
        self._about = {
            "version": __version__,
            "simulation": simulation.name,
            "parameters": dict(simulation.parameters),
            "recording": asdict(recording),
            "ground_truth": AREA_AND_AXES,
        }

    @property
    def n_frames(self) -> int:
        """Frames recorded."""
        return len(self.ground_truth)

    def run(self, *, resume: bool) -> str:
        """Run to the end; returns a summary. Raises DroptrackError when the run goes unstable."""
        if resume:
            self._load()
        else:
            self._start_folder()
        start, first_step = time.perf_counter(), self.simulation.step
        with stopped_by_signals(self._ask_to_stop):
            self._loop()
        elapsed = time.perf_counter() - start
        self._write_video()
        self._write_ground_truth()
        self._write_checks()
        shutil.rmtree(self._frame(0).parent)
        return self._summary(self.simulation.step - first_step, elapsed)

    def _summary(self, steps: int, seconds: float) -> str:
        speed = steps / seconds if steps else 0.0
        width, height = self.simulation.size
        parts = (
            f"{self.out / 'video.avi'}: {self.n_frames} frames, {self.simulation.step} steps",
            f"{speed:.4g} steps/s, {speed * width * height / 1e6:.3g} million lattice updates/s "
            f"on {self.simulation.device}",
            self.simulation.outcome(),
        )
        return "; ".join(part for part in parts if part)

    def _frame(self, index: int) -> Path:
        return self.out / "frames" / f"{index:06d}.png"

    def _start_folder(self) -> None:
        if self._checkpoint.exists():
            raise DroptrackError(
                f"{self.out}: holds a run already; give --resume or another folder"
            )
        self._frame(0).parent.mkdir(parents=True, exist_ok=True)
        write_text(self.out / "parameters.json", json.dumps(self._about, indent=2) + "\n")

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
                completed=self.n_frames,
                note="starting",
            )
            while self.n_frames < frames and not (self.n_frames and simulation.finished()):
                clock, before = time.perf_counter(), simulation.step
                self._advance(recording.first + self.n_frames * recording.every)
                speed = (simulation.step - before) / (time.perf_counter() - clock)
                values = self._record()
                watched = " ".join(f"{name} {value:.4g}" for name, value in values.items())
                updates = speed * width * height / 1e6
                note = f"{speed:.0f} steps/s, {updates:.1f} M updates/s, {watched}"
                progress.update(task, completed=self.n_frames, note=note)
                if self.n_frames % recording.checkpoint_frames == 0:
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
                last = "; the last checkpoint is kept" if self._checkpoint.exists() else ""
                raise DroptrackError(
                    f"{self.simulation.name}: unstable at step {self.simulation.step}: "
                    f"{trouble}{last}"
                )

    def _record(self) -> dict[str, float]:
        """Keep a frame and what is known of it; returns what was checked."""
        index, camera = self.n_frames, self.recording.camera
        write_image_file(self._frame(index), capture(self.simulation.shade(), camera, index))
        values = self.simulation.checks()
        self.check_names = list(values)
        rows = ground_truth_rows(self.simulation, index, camera.scale)
        self.checks = [*self.checks[:index], [index, self.simulation.step, *values.values()]]
        self.ground_truth.append(rows)
        return values

    def _save(self) -> None:
        """Write the checkpoint: complete or not at all."""
        if not self.n_frames:
            return  # nothing yet that would be lost
        counts = [len(rows) for rows in self.ground_truth]
        with replacing(self._checkpoint) as partial:
            np.savez(
                partial,
                about=json.dumps(self._about),
                truth=np.concatenate(self.ground_truth),
                counts=np.array(counts, np.int64),
                checks=np.array(self.checks, float),
                check_names=np.array(self.check_names),
                **{STATE + name: array for name, array in self.simulation.arrays().items()},
            )

    def _load(self) -> None:
        """Resume from the checkpoint; raises DroptrackError where it is not of this run."""
        data = read_checkpoint(self._checkpoint)
        other = _difference(json.loads(str(data["about"])), json.loads(json.dumps(self._about)))
        if other:
            raise DroptrackError(
                f"{self._checkpoint}: is of another run, with other {other}; give the same options"
            )
        missing = [i for i in range(len(data["counts"])) if not self._frame(i).exists()]
        if missing:
            raise DroptrackError(
                f"{self.out}: frame {missing[0]} of the run is missing, as the run is complete or "
                "files were removed; run anew in another folder"
            )
        self.ground_truth = list(np.split(data["truth"], np.cumsum(data["counts"])[:-1]))
        self.checks = data["checks"].tolist()
        self.check_names = data["check_names"].tolist()
        self.simulation.load(
            {k.removeprefix(STATE): v for k, v in data.items() if k.startswith(STATE)}
        )

    def _video_info(self) -> VideoInfo:
        scale = self.recording.camera.scale
        width, height = (scale * length for length in self.simulation.size)
        return VideoInfo(width, height, self.recording.fps, self.n_frames)

    def _write_video(self) -> None:
        """The video, and its first, middle and last frame as images."""
        with (
            replacing(self.out / "video.avi") as partial,
            VideoWriter(partial, self._video_info(), "MJPG") as video,
        ):
            for index in range(self.n_frames):
                image = cv2.imread(str(self._frame(index)))
                if image is None:
                    raise DroptrackError(f"{self._frame(index)}: cannot be read back")
                video.write(np.asarray(image, np.uint8))
        places = (0, self.n_frames // 2, self.n_frames - 1)
        for name, index in zip(SNAPSHOTS, places, strict=True):
            with replacing(self.out / f"{name}.png") as partial:
                partial.write_bytes(self._frame(index).read_bytes())

    def _write_ground_truth(self) -> None:
        info, recording = self._video_info(), self.recording
        about = {
            "made by": f"droptrack {__version__}, data_gen.simulate {self.simulation.name}",
            "parameters": "in parameters.json",
            "video": f"video.avi, {info.width} x {info.height} px, {recording.fps} frames/s",
            "steps": f"{recording.first} + {recording.every} a frame",
            "units": "px and px^2; centre of mass, box, area and axes of where the droplet's "
            "fraction exceeds 1/2",
        }
        rows = np.concatenate(self.ground_truth)
        ids, ones = rows[:, :2].astype(np.int64), np.ones(len(rows))
        table = sorted_trajectories(
            frame=ids[:, 0],
            track_id=ids[:, 1],
            x=rows[:, 2],
            y=rows[:, 3],
            boxes=rows[:, 4:8],
            scores=ones,
            observed=ones.astype(bool),
        )  # rows are in order already
        extra = (*BOX_CENTRE, *AREA_AND_AXES)
        with (
            replacing(self.out / "truth.csv") as partial,
            TrajectoryWriter(partial, about, extra) as writer,
        ):
            writer.write(table, (rows[:, 4], rows[:, 5], *rows[:, 8:].T))

    def _write_checks(self) -> None:
        with (
            replacing(self.out / "checks.csv") as partial,
            partial.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["frame", "step", *self.check_names])
            writer.writerows(
                [int(row[0]), int(row[1]), *(f"{value:.8g}" for value in row[2:])]
                for row in self.checks
            )


def read_checkpoint(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a checkpoint; raises DroptrackError where there is none or it is damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            data = dict(stored)
    except FileNotFoundError:
        raise DroptrackError(f"{path}: no such file, so there is no run to resume") from None
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise DroptrackError(f"{path}: cannot be read as a checkpoint: {error}") from None
    if "about" not in data:
        raise DroptrackError(f"{path}: is no checkpoint of a simulation")
    return data


def _difference(theirs: dict[str, Any], ours: dict[str, Any]) -> str:
    """The first part in which a run differs from ours, with its names; empty where none does."""
    for part, mine in ours.items():
        other = theirs.get(part)
        if other == mine:
            continue
        if isinstance(mine, dict) and isinstance(other, dict):
            return f"{part} {', '.join(name for name in mine if other.get(name) != mine[name])}"
        return part
    return ""


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
