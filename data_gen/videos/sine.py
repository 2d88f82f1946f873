"""The paper's test video (appendix D): droplets on predefined paths.

x(t + 1) = x(t) + A,  y(t + 1) = y(t) + B sin(k x(t))    (Eq. D1)
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.scenes.shapes import WHITE, draw_ellipses
from droptrack.data.arrays import Floats
from droptrack.data.files import replacing
from droptrack.data.trajectories import Trajectories, sorted_trajectories, write_trajectories
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.errors import DroptrackError
from droptrack.progress import progress_bar
from droptrack.version import __version__

GAP_PX = 4.0  # between droplets, and to the upper and lower edge


@dataclass(frozen=True, kw_only=True)
class SineVideo:
    """Everything that decides the video. Raises DroptrackError for impossible radii."""

    droplets: int = 12
    frames: int = 200
    width: int = 1200
    height: int = 600
    radius: tuple[float, float] = (16.0, 30.0)  # minimum and maximum, px
    a: float = 5.0  # step in x, px per frame
    b: float = 5.0  # maximum step in y, px per frame
    k: float = 5.0  # radians per px
    fps: int = 25
    seed: int = 0

    def __post_init__(self) -> None:
        low, high = self.radius
        if not 2 <= low <= high:
            raise DroptrackError(f"--radius {low:g} {high:g}: should rise from 2 px or more")


def sine_path(start: Floats, n_frames: int, a: float, b: float, k: float) -> Floats:
    """Positions (T, 2) px of a droplet from `start` (2,) by Eq. D1; k in radians per px."""
    x = start[0] + a * np.arange(n_frames)
    y = start[1] + b * np.concatenate([[0.0], np.cumsum(np.sin(k * x[:-1]))])
    return np.column_stack([x, y])


def place_droplets(
    rng: np.random.Generator,
    n: int,
    size: tuple[int, int],
    n_frames: int,
    radius: tuple[float, float],
    motion: tuple[float, float, float],
) -> tuple[Floats, Floats]:
    """Paths (N, T, 2) and radii (N,) of droplets that start in the left half and never touch.

    `size`: width and height of the image; `motion`: A, B and k of Eq. D1. Raises
    DroptrackError if no room is found.
    """
    width, height = size
    paths: list[Floats] = []
    radii: list[float] = []
    for _ in range(1000 * n):
        if len(paths) == n:
            return np.array(paths), np.array(radii)
        r = rng.uniform(*radius)
        start = np.array([rng.uniform(r, max(r, width / 2)), rng.uniform(r, height - r)])
        path = sine_path(start, n_frames, *motion)
        if path[:, 1].min() < r + GAP_PX or path[:, 1].max() > height - r - GAP_PX:
            continue
        if all(
            np.hypot(*(path - other).T).min() > r + s + GAP_PX
            for other, s in zip(paths, radii, strict=True)
        ):
            paths.append(path)
            radii.append(r)
    raise DroptrackError(
        f"no room for {n} droplets of radius {radius[0]:g} to {radius[1]:g} px in "
        f"{width} x {height} px; take fewer or smaller ones"
    )


def ground_truth_of(paths: Floats, radii: Floats, width: int) -> Trajectories:
    """Trajectories of paths (N, T, 2): rows while any of a droplet is in the image.

    Score 1 while all of it is, else 0: a droplet cut off by the edge need not be found.
    """
    n, n_frames = paths.shape[:2]
    droplet, frame = np.meshgrid(np.arange(n), np.arange(n_frames), indexing="ij")
    x, y, r = paths[..., 0], paths[..., 1], np.repeat(radii[:, None], n_frames, axis=1)
    visible = (x - r < width) & (x + r > 0)
    whole = (x - r >= 0) & (x + r <= width)
    boxes = np.stack([x, y, 2 * r, 2 * r], axis=-1)
    return sorted_trajectories(
        frame=frame[visible].astype(np.int64),
        track_id=droplet[visible].astype(np.int64) + 1,
        x=x[visible],
        y=y[visible],
        boxes=boxes[visible],
        scores=whole[visible].astype(float),
        observed=np.ones(int(visible.sum()), bool),
    )


def write_sine_video(out: Path, settings: SineVideo) -> None:
    """Write video.avi and truth.csv to a folder; raises DroptrackError for too many droplets."""
    s = settings
    rng = np.random.default_rng(s.seed)
    paths, radii = place_droplets(
        rng, s.droplets, (s.width, s.height), s.frames, s.radius, (s.a, s.b, s.k)
    )
    out.mkdir(parents=True, exist_ok=True)
    about = {
        "made by": f"droptrack {__version__}, data_gen.simulate sine",
        "parameters": f"A={s.a:g} B={s.b:g} k={s.k:g} seed={s.seed} "
        f"radius={s.radius[0]:g}..{s.radius[1]:g}",
        "video": f"video.avi, {s.width} x {s.height} px, {s.fps} frames/s",
        "units": "px; score 0 marks droplets cut off by the picture's edge",
    }
    info = VideoInfo(s.width, s.height, s.fps, s.frames)
    with (
        progress_bar("frames") as progress,
        replacing(out / "video.avi") as partial,
        VideoWriter(partial, info, "MJPG") as video,
    ):
        for t in progress.track(range(s.frames), description="sine", total=s.frames):
            canvas = np.zeros((s.height, s.width), np.uint8)
            discs = np.column_stack([paths[:, t], radii, radii, np.zeros(len(radii))])
            visible = np.abs(discs[:, 0] - s.width / 2) < s.width / 2 + radii
            draw_ellipses(canvas, discs[visible], WHITE)
            video.write(np.repeat(canvas[..., None], 3, axis=2))
    write_trajectories(out / "truth.csv", ground_truth_of(paths, radii, s.width), about)
