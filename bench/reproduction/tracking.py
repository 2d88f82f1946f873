"""The stage ``tracking``: every video by droptrack, and by what a user would pick instead."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

import droptrack
from bench.reproduction.classical import N_CHOSEN_ON, Method, best_setting, methods
from bench.reproduction.folder import Given, Reproduction
from bench.reproduction.linking import TRACKPY, Found, Linker, linkers
from bench.reproduction.networks import given_weights
from bench.reproduction.simulations import Clip, clips
from droptrack.data.arrays import Pixels
from droptrack.data.files import read_text, write_text
from droptrack.data.samples import spread
from droptrack.data.trajectories import Trajectories, read_trajectories, write_trajectories
from droptrack.data.video import Video
from droptrack.measurement.droplets import measure_droplets
from droptrack.pipeline.config import TrackingConfig
from droptrack.pipeline.open_detector import open_detector

OURS = "droptrack"
PAPERS_WAY = "YOLO + DeepSORT, box centres"
FULL = "YOLOv3 (full), droptrack"


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """Trajectories, the seconds that they took, from the file on, and what was chosen for them."""

    rows: Trajectories
    seconds: float
    setting: str = ""


class Watched:
    """A video whose droplets are found in several ways, each kind of detection made once."""

    def __init__(self, clip: Clip) -> None:
        self.clip = clip
        self.truth, _ = read_trajectories(clip.truth)
        counted = self.truth.scores > 0
        sizes = self.truth.boxes[counted, 2:]
        self.diameter = float(np.median(np.sqrt(sizes.prod(axis=1))))
        self.n_frames = Video(str(clip.video)).info.n_frames

    def grey(self) -> Iterator[tuple[int, Pixels]]:
        """Its frames as grey images (H, W)."""
        for number, frame in Video(str(self.clip.video)).numbered():
            yield number, np.ascontiguousarray(frame[..., 0])

    @cached_property
    def detections(self) -> tuple[list[tuple[int, Found]], float]:
        """What the bundled model finds, at measured centres of mass; and the seconds it took."""
        config = TrackingConfig(video=str(self.clip.video))
        video = Video(config.video)
        size = (video.info.width, video.info.height)
        opened = open_detector(config, size, video.samples, live=False, say=lambda _: None)
        start = time.perf_counter()
        found = []
        for number, frame in video.numbered():
            (boxes,) = opened.detector.detect([frame])
            measured = measure_droplets(frame, boxes.boxes)
            found.append((number, Found(measured.centres, measured.boxes[:, 2:])))
        return found, time.perf_counter() - start

    def chosen(self, settings: list[Method]) -> Method:
        """The setting that finds most on some frames."""
        numbers = set(spread(self.n_frames, N_CHOSEN_ON))
        return best_setting(settings, [one for one in self.grey() if one[0] in numbers], self.truth)


def slug(method: str) -> str:
    """A method's name for a folder.

    >>> slug("YOLO + DeepSORT, box centres")
    'yolo_deepsort_box_centres'
    """
    return "_".join("".join(c if c.isalnum() else " " for c in method.lower()).split())


def result_folder(of: Reproduction, clip: Clip, method: str) -> Path:
    """The folder of one method's trajectories of one video."""
    return of.folder("tracking") / clip.name / slug(method)


def track_all(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Track every video in every way that is not done yet."""
    found: dict[str, Any] = {}
    for clip in clips(of):
        watched = Watched(clip)
        found[clip.name] = {}
        for method, run in ways(of, watched).items():
            folder = result_folder(of, clip, method)
            about = folder / "about.json"
            if not about.exists():
                say(f"{clip.name}: {method}")
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder, run(folder), watched.n_frames)
            found[clip.name][method] = json.loads(read_text(about))
    return found


def depends_on(given: Given) -> list[object]:
    """What the stage depends on: the full network, where there is one."""
    return [given_weights(given, "full")]


def ways(of: Reproduction, watched: Watched) -> dict[str, Callable[[Path], Tracked]]:
    """Every way to track a video, by its name; each is given a folder for what it writes."""
    found: dict[str, Callable[[Path], Tracked]] = {
        OURS: partial(_by_droptrack, watched.clip),
        PAPERS_WAY: partial(_as_in_the_paper, watched.clip),
    }
    full = of.result("networks").get("full", {})
    if "weights" in full:
        found[FULL] = partial(_by_droptrack, watched.clip, weights=Path(full["weights"]))
    if not of.settings.alternatives:
        return found
    available = linkers()
    for name, link in available.items():
        found[f"our detections, {name}"] = partial(_linked, watched, link)
    if TRACKPY in available:
        for name, settings in methods(watched.diameter).items():
            found[f"{name}, {TRACKPY}"] = partial(_classical, watched, settings, available[TRACKPY])
    return found


def _by_droptrack(
    clip: Clip, folder: Path, tracker: str = "droplet", weights: Path | None = None
) -> Tracked:
    run = droptrack.track(
        clip.video, out=folder / "run", weights=weights, tracker=tracker, overwrite=True,
        annotated_video=False, progress=False,
    )  # fmt: skip
    seconds = float(str(run.report.summary["seconds"]))
    settings = run.report.settings
    model = f"{settings['model']} model, " if "model" in settings else ""
    return Tracked(rows=run.trajectories, seconds=seconds, setting=f"{model}{settings['backend']}")


def _as_in_the_paper(clip: Clip, folder: Path) -> Tracked:
    """DeepSORT, and the centre of the box for the centre of mass."""
    tracked = _by_droptrack(clip, folder, "deepsort")
    rows = tracked.rows
    at_box = replace(rows, x=rows.boxes[:, 0], y=rows.boxes[:, 1])
    return replace(tracked, rows=at_box)


def _linked(watched: Watched, link: Linker, _: Path) -> Tracked:
    found, seconds = watched.detections
    start = time.perf_counter()
    rows = link(found, watched.diameter)
    return Tracked(rows=rows, seconds=seconds + time.perf_counter() - start)


def _classical(watched: Watched, settings: list[Method], link: Linker, _: Path) -> Tracked:
    method = watched.chosen(settings)
    start = time.perf_counter()
    found = [(number, method.find(image)) for number, image in watched.grey()]
    rows = link(found, watched.diameter)
    return Tracked(rows=rows, seconds=time.perf_counter() - start, setting=method.setting)


def _write(folder: Path, tracked: Tracked, n_frames: int) -> None:
    """The trajectories and, last, what is to be known of them."""
    write_trajectories(folder / "trajectories.csv", tracked.rows, {"made by": "bench.reproduce"})
    about = {
        "seconds": tracked.seconds,
        "frames_per_second": n_frames / tracked.seconds,
        "setting": tracked.setting,
        "n_tracks": len(np.unique(tracked.rows.track_id)),
    }
    write_text(folder / "about.json", json.dumps(about, indent=1) + "\n")
