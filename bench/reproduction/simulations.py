"""The stage ``simulations``: the paper's test video and its two flows, as drawn and degraded."""

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.reproduction.folder import Reproduction
from bench.reproduction.settings import Settings
from data_gen.lattice_boltzmann import constriction as constrictions
from data_gen.lattice_boltzmann import shear as shears
from data_gen.lattice_boltzmann.camera import Camera
from data_gen.lattice_boltzmann.recording import Recording, record
from data_gen.videos.sine import SineVideo, write_sine_video
from droptrack.data.degradation import add_noise, blur, light_unevenly, lower_contrast, to_pixels
from droptrack.data.frames import Frame
from droptrack.data.trajectories import read_trajectories
from droptrack.data.video import Video, VideoWriter

FLOWS = ("sine", "shear", "constriction")
TITLES = {
    "sine": "the paper's test video",
    "shear": "cores in a sheared shell",
    "constriction": "dense emulsion through a constriction",
}
CASES = {  # as the paper's sections name them
    "sine": "synthetic case",
    "shear": "multi-core emulsion",
    "constriction": "dense emulsion",
}
BLUR_PX, DARKEST, CONTRAST, BLACK, NOISE = 1.5, 0.5, 0.5, 20.0, 8.0  # of degraded videos


@dataclass(frozen=True)
class Clip:
    """A video of a flow, clean or degraded, and where its ground truth is."""

    flow: str
    degraded: bool
    folder: Path  # of the flow

    @property
    def name(self) -> str:
        """A name for files."""
        return f"{self.flow}_degraded" if self.degraded else self.flow

    @property
    def video(self) -> Path:
        """The video's file."""
        return self.folder / ("degraded.avi" if self.degraded else "video.avi")

    @property
    def truth(self) -> Path:
        """The ground truth's file."""
        return self.folder / "truth.csv"

    @property
    def complete(self) -> bool:
        """Whether the last file that is written of it is there."""
        if self.degraded:
            return self.video.exists()
        return (self.folder / ("truth.csv" if self.flow == "sine" else "checks.csv")).exists()


def clips(of: Reproduction) -> list[Clip]:
    """The videos: each flow clean, and degraded where that is wanted."""
    kinds = (False, True) if of.settings.degraded else (False,)
    return [Clip(flow, bad, of.folder("simulations") / flow) for flow in FLOWS for bad in kinds]


def command(settings: Settings, flow: str) -> str:
    """The command that makes the video of a flow."""
    s = settings
    options = {
        "sine": f"--frames {s.sine_frames} --seed {s.seed}",
        "shear": f"--cores {s.cores} --steps {s.shear_steps} --every {s.shear_every}",
        "constriction": f"--size {s.constriction} --droplets {s.droplets} --seed {s.seed}",
    }[flow]
    return f"python -m data_gen.simulate {flow} {options} --out DIR"


def simulate(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Make the videos that are missing; simulations go on from their last checkpoint."""
    found = {}
    for clip in clips(of):
        if not clip.complete:
            if clip.degraded:
                _degrade(clip.folder / "video.avi", clip.video)
            else:
                _make(of, clip, say)
        if not clip.degraded:
            found[clip.flow] = _about(of.settings, clip)
    return found


def _make(of: Reproduction, clip: Clip, say: Callable[[str], None]) -> None:
    s, out = of.settings, clip.folder
    if clip.flow == "sine":
        write_sine_video(out, SineVideo(frames=s.sine_frames, seed=s.seed))
        return
    resume = (out / "checkpoint.npz").exists()
    if clip.flow == "shear":
        cores = shears.shear_parameters(s.cores)
        first, steps, every = cores.rest_steps, s.shear_steps, s.shear_every
        run = partial(record, shears.Shear, cores)
    else:
        dense = constrictions.constriction_parameters(s.constriction, s.droplets, s.seed)
        first, steps = dense.rest_steps, s.constriction_steps
        every = constrictions.EVERY[s.constriction]
        run = partial(record, constrictions.Constriction, dense)
    recording = Recording(first=first, last=first + steps, every=every, fps=25, camera=Camera())
    say(run(out, recording, device=of.given.device, resume=resume, say=say))


def _about(settings: Settings, clip: Clip) -> dict[str, Any]:
    """What is in the video, and what was checked while it was simulated."""
    truth, _ = read_trajectories(clip.truth)
    info = Video(str(clip.video)).info
    found: dict[str, Any] = {
        "title": TITLES[clip.flow],
        "n_droplets": len(np.unique(truth.track_id)),
        "n_frames": info.n_frames,
        "size_px": [info.width, info.height],
        "diameter_px": float(np.median(np.sqrt(truth.boxes[:, 2:].prod(axis=1)))),
        "command": command(settings, clip.flow),
    }
    checks = clip.folder / "checks.csv"
    if checks.exists():
        with checks.open() as file:
            rows = list(csv.DictReader(file))
        found["steps"] = int(float(rows[-1]["step"]))
        found["max_mass_drift"] = max(float(row["mass_drift"]) for row in rows)
        found["max_pieces_of_a_droplet"] = max(float(row["pieces"]) for row in rows)
        if "through" in rows[-1]:
            found["n_through"] = int(float(rows[-1]["through"]))
        about = json.loads((clip.folder / "parameters.json").read_text())
        found["parameters"] = about["parameters"]
    return found


def _degrade(source: Path, out: Path) -> None:
    """The same video by a bad camera: out of focus, unevenly lit, of little contrast, noisy."""
    video = Video(str(source))
    partial_file = out.with_suffix(".partial.avi")
    with VideoWriter(partial_file, video.info, "MJPG") as writer:
        for index, frame in video.numbered():
            writer.write(degraded(frame, index))
    partial_file.replace(out)


def degraded(frame: Frame, index: int) -> Frame:
    """A frame (H, W, 3) as the bad camera shows it; its noise depends on its number."""
    rng = np.random.default_rng([7, index])
    light = np.linspace(1, DARKEST, frame.shape[1])
    levels = light_unevenly(blur(frame, BLUR_PX).astype(float), light)
    levels = lower_contrast(levels, CONTRAST, BLACK)
    return to_pixels(add_noise(levels, rng.standard_normal(frame.shape[:2]), NOISE))
