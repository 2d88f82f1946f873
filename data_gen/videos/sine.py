"""The paper's test video (appendix D): droplets on predefined paths.

x(t + 1) = x(t) + A,  y(t + 1) = y(t) + B sin(k x(t))    (Eq. D1)
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from data_gen.scenes.shapes import WHITE, draw_ellipses
from droptrack.data.arrays import Floats
from droptrack.data.trajectories import Trajectories, sorted_trajectories, write_trajectories
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.errors import DroptrackError
from droptrack.progress import progress_bar
from droptrack.version import __version__

GAP_PX = 4.0  # between droplets, and to the upper and lower edge


def sine_path(start: Floats, n_frames: int, a: float, b: float, k: float) -> Floats:
    """Positions (T, 2) px of a droplet from `start` (2,) by Eq. D1; k in radians a pixel."""
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

    `size`: width and height of the picture; `motion`: A, B and k of Eq. D1. Raises
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


def truth_of(paths: Floats, radii: Floats, width: int) -> Trajectories:
    """The truth of paths (N, T, 2): rows while any of a droplet is in the picture.

    Score 1 while all of it is, else 0: a droplet cut off by the edge need not be found.
    """
    n, n_frames = paths.shape[:2]
    droplet, frame = np.meshgrid(np.arange(n), np.arange(n_frames), indexing="ij")
    x, y, r = paths[..., 0], paths[..., 1], np.repeat(radii[:, None], n_frames, axis=1)
    there = (x - r < width) & (x + r > 0)
    whole = (x - r >= 0) & (x + r <= width)
    boxes = np.stack([x, y, 2 * r, 2 * r], axis=-1)
    return sorted_trajectories(
        frame[there].astype(np.int64),
        droplet[there].astype(np.int64) + 1,
        x[there],
        y[there],
        boxes[there],
        whole[there].astype(float),
        np.ones(int(there.sum()), bool),
    )


def sine(
    out: Annotated[Path, typer.Option(help="Folder for video.avi and truth.csv.")],
    droplets: Annotated[int, typer.Option(min=1)] = 12,
    frames: Annotated[int, typer.Option(min=1)] = 200,
    width: Annotated[int, typer.Option(min=32)] = 1200,
    height: Annotated[int, typer.Option(min=32)] = 600,
    radius: Annotated[tuple[float, float], typer.Option(help="Least and largest, px.")] = (16, 30),
    a: Annotated[float, typer.Option("-A", help="Step in x a frame, px.")] = 5.0,
    b: Annotated[float, typer.Option("-B", help="Largest step in y a frame, px.")] = 5.0,
    k: Annotated[float, typer.Option("-k", help="Radians a pixel.")] = 5.0,
    fps: Annotated[int, typer.Option(min=1)] = 25,
    seed: Annotated[int, typer.Option(min=0)] = 0,
) -> None:
    """Droplets on the predefined paths of the paper's test video (Eq. D1)."""
    if not 2 <= radius[0] <= radius[1]:
        raise DroptrackError(f"--radius {radius[0]:g} {radius[1]:g}: should rise from 2 px or more")
    rng = np.random.default_rng(seed)
    paths, radii = place_droplets(rng, droplets, (width, height), frames, radius, (a, b, k))
    out.mkdir(parents=True, exist_ok=True)
    truth = truth_of(paths, radii, width)
    about = {
        "made by": f"droptrack {__version__}, data_gen.simulate sine",
        "parameters": f"A={a:g} B={b:g} k={k:g} seed={seed} radius={radius[0]:g}..{radius[1]:g}",
        "video": f"video.avi, {width} x {height} px, {fps} frames/s",
        "units": "px; score 0 marks droplets cut off by the picture's edge",
    }
    info = VideoInfo(width, height, fps, frames)
    with progress_bar("frames") as progress, VideoWriter(out / "video.avi", info, "MJPG") as video:
        for t in progress.track(range(frames), description="sine", total=frames):
            canvas = np.zeros((height, width), np.uint8)
            discs = np.column_stack([paths[:, t], radii, radii, np.zeros(len(radii))])
            draw_ellipses(canvas, discs[np.abs(discs[:, 0] - width / 2) < width / 2 + radii], WHITE)
            video.write(np.repeat(canvas[..., None], 3, axis=2))
    write_trajectories(out / "truth.csv", truth, about)
    typer.echo(f"{out / 'video.avi'}: {droplets} droplets, {frames} frames; truth in truth.csv")
