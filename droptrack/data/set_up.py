"""How the droplets of one set-up look: what is measured on a video, and drawn from.

`droptrack.adaptation` measures it; what draws images reads its file.
"""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from droptrack.data.arrays import Float32s, Floats, Pixels
from droptrack.data.files import reading, replacing
from droptrack.errors import DroptrackError

SUFFIX = ".npz"  # of its file
ELLIPSE = 0.0  # the `Profile.corners` of droplets that are ellipses


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Grey levels of a droplet, relative to what is behind it.

    `distances` (K,) px, equally far apart, from the outline, negative inside, and `levels` (K, C)
    there. `corners`: the radius of the outline's corners, of half the droplet's smaller side: 1 for
    round ends, 0 (ELLIPSE) for an ellipse.
    """

    distances: Floats
    levels: Floats
    corners: float


@dataclass(frozen=True, kw_only=True)
class View:
    """One view of the camera: its image without droplets, and what droplets were seen in it.

    `background` (H, W, C) grey levels, C is 1 or 3; `frames`: the boxes (N, 4) px of each frame;
    `profile`: what they look like.
    """

    background: Pixels
    frames: tuple[Floats, ...]
    profile: Profile


@dataclass(frozen=True, kw_only=True)
class SetUp:
    """What droplets look like in a video.

    `views`: all of one size. `noise`: standard deviation, grey levels. `dense`: droplets press on
    one another.
    """

    views: tuple[View, ...]
    noise: float
    dense: bool


def part_of(
    box: Floats, size: tuple[int, int], margin: float = 0.0
) -> tuple[slice, slice, Float32s, Float32s]:
    """The pixels of an image of a size (width, height) within a box (4,), and a margin around it.

    Rows and columns, which may be empty, and their centres' x (W,) and y (H,).
    """
    low = np.clip(np.floor(box[:2] - box[2:] / 2 - margin), 0, size).astype(int)
    high = np.clip(np.ceil(box[:2] + box[2:] / 2 + margin), low, size).astype(int)
    x = np.arange(low[0], high[0], dtype=np.float32) + np.float32(0.5)
    y = np.arange(low[1], high[1], dtype=np.float32) + np.float32(0.5)
    return slice(low[1], high[1]), slice(low[0], high[0]), x, y


def outline_distance(box: Floats, corners: float, x: Float32s, y: Float32s) -> Float32s:
    """Signed distance (H, W) px of pixels at x (W,), y (H,) from the outline that fills a box (4,).

    Negative inside. Of an ellipse it is exact at the outline only.

    >>> x = y = np.arange(0.5, 100, dtype=np.float32)
    >>> round(float(outline_distance(np.array([50.5, 50.5, 40, 40]), ELLIPSE, x, y)[50, 80]), 3)
    10.0
    """
    half = np.maximum(box[2:] / 2, 0.5).astype(np.float32)
    u, v = np.abs(x - np.float32(box[0])), np.abs(y - np.float32(box[1]))
    if corners == ELLIPSE:
        a, b = u / half[0], v / half[1]
        scaled = np.sqrt(np.add.outer(b * b, a * a))
        slope = np.sqrt(np.add.outer((b / half[1]) ** 2, (a / half[0]) ** 2))
        near = (scaled - 1) * scaled / np.maximum(slope, np.float32(1e-6))
        return np.asarray(np.maximum(near, -half.min()), np.float32)
    radius = np.float32(corners * half.min())
    along, across = u - (half[0] - radius), v - (half[1] - radius)
    outside = np.hypot(np.maximum(across, 0)[:, None], np.maximum(along, 0)[None])
    inside = np.minimum(np.maximum(across[:, None], along[None]), 0)
    return np.asarray(outside + inside - radius, np.float32)


def write_set_up(path: Path, set_up: SetUp) -> None:
    """Write the file that `read_set_up` reads, whole or not at all."""
    arrays: dict[str, Floats | Pixels] = {"numbers": np.array([set_up.noise, set_up.dense])}
    for v, view in enumerate(set_up.views):
        arrays[f"background_{v}"] = view.background
        arrays[f"counts_{v}"] = np.array([len(boxes) for boxes in view.frames], float)
        arrays[f"boxes_{v}"] = np.concatenate([np.zeros((0, 4)), *view.frames])
        arrays[f"distances_{v}"] = view.profile.distances
        arrays[f"levels_{v}"] = view.profile.levels
        arrays[f"corners_{v}"] = np.array([view.profile.corners])
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read_set_up(path: Path) -> SetUp:
    """Read a set-up's file; raises DroptrackError naming it where that is not possible."""
    try:
        with reading(path, "a set-up"), np.load(path, allow_pickle=False) as held:
            views: list[View] = []
            while f"background_{len(views)}" in held:
                v = len(views)
                ends = np.cumsum(held[f"counts_{v}"].astype(int))[:-1]
                profile = Profile(
                    distances=held[f"distances_{v}"],
                    levels=held[f"levels_{v}"],
                    corners=float(held[f"corners_{v}"][0]),
                )
                views.append(
                    View(
                        background=held[f"background_{v}"],
                        frames=tuple(np.split(held[f"boxes_{v}"], ends)),
                        profile=profile,
                    )
                )
            noise, dense = held["numbers"].tolist()
            return SetUp(views=tuple(views), noise=noise, dense=bool(dense))
    except (KeyError, zipfile.BadZipFile):
        raise DroptrackError(f"{path}: is no file of droptrack adapt, or a damaged one") from None
