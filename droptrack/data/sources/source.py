"""What a reader of a video gives: images as they are stored, and what the file says of them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.sources.frame_times import FrameTimes
from droptrack.errors import DroptrackError

Image = NDArray[Any]  # (H, W) or (H, W, C) of any type; colours are BGR
N_SAMPLES = 10  # images that are looked at for the grey levels in use


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """How to read what can be read in several ways.

    `levels`: the grey levels of black and white, instead of those in use. `channel`: the one of a
    stack with several, from 0. `renumber`: count the images of a numbered sequence with holes one
    by one. `reconnect_s`: for how long to wait for a stream that is away.
    """

    levels: tuple[float, float] | None = None
    channel: int | None = None
    renumber: bool = False
    reconnect_s: float = 0


@dataclass(frozen=True, kw_only=True)
class Source:
    """A video, opened.

    `images`: each image that can be decoded, once, with its number from 0; numbers that are left
    out are of missing ones. `n_frames`: how many there should be with those, 0 where nobody knows;
    an estimate of the container's where they are not `counted`. `n_absent`: those known to be
    missing, as in a numbered sequence with holes. `samples`: reads images from all over it, where
    they can be had at once; else None. `bits`: of the grey levels, 0 where the file does not say.
    `fps` and `pixel_size_um`: 0 where it does not say. `notes`: what a user might not expect.
    `times`: those of the frames so far, where the file has them. `doubt`: why the numbers of frames
    may be wrong; empty where they are not in doubt.
    """

    n_frames: int
    images: Iterator[tuple[int, Image]] = field(default_factory=lambda: iter(()))
    counted: bool = True
    n_absent: int = 0
    samples: Callable[[], list[Image]] | None = None
    bits: int = 0
    fps: float = 0.0
    pixel_size_um: float = 0.0
    notes: tuple[str, ...] = ()
    times: FrameTimes | None = None
    doubt: str = ""


def spread(n: int) -> list[int]:
    """Up to N_SAMPLES of n numbers from 0, spread evenly.

    >>> spread(3), spread(101)
    ([0, 1, 2], [0, 11, 22, 33, 44, 56, 67, 78, 89, 100])
    """
    return np.unique(np.linspace(0, n - 1, N_SAMPLES).round().astype(int)).tolist() if n else []


def random_access(read: Callable[[int], Image | None], source: Source) -> Source:
    """A source whose images can be had by their number; None are those that cannot be decoded."""
    n = source.n_frames
    found = ((number, read(number)) for number in range(n))
    images = ((number, image) for number, image in found if image is not None)

    def samples() -> list[Image]:
        return [image for number in spread(n) if (image := read(number)) is not None]

    return replace(source, images=images, samples=samples)


def refuse_channel(name: str, options: ReadOptions) -> None:
    """Raise DroptrackError where a channel is asked of what has none."""
    if options.channel is not None:
        raise DroptrackError(f"{name}: has no channels; leave out --channel")
