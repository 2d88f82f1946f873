"""Images of a Darknet data set -> augmented batches for training."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from droptrack.data.arrays import Bools, Float32s, Floats, Pixels, Rows
from droptrack.data.darknet_dataset import DataSet, read_frame, read_labels
from droptrack.data.frames import Frame, grey_plane
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg
from droptrack.training.config import DrawImage
from droptrack.training.pytorch.devices import (
    leave_open_files_to_no_other,
    leave_signals_to_the_first_process,
)

# image (3, H, W) uint8 RGB; ground truths (N, 5) class, relative box
Sample = tuple[Tensor, Tensor]

DARKNET_RANDOM = 1.4  # maximum factor on the size with Darknet's random=1; minimum: one over it
SHARE_WITH_DROPLET = 0.9  # of the windows, which are laid around a random droplet
MIN_VISIBLE = 0.1  # share of a droplet's area in the window, for it to be ground truth
MIN_VISIBLE_PX = 2  # and of its width and height
MIN_SHARE_OF_SIDE = 0.75


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """How images are changed, with Darknet's names; `window` is ours.

    The image is stretched to the network's size (times a random factor a batch when `random`),
    then moved and zoomed by up to `jitter`. Of the result only a `window` (width, height) px at a
    random place is used: the network is convolutional, so small windows teach it the same in less
    time, if nothing but the window's content decides what is a droplet. `droplets`: the smallest
    and the largest diameter, sqrt(w h) px of the input, that have a label, so that the network
    learns a scale; their sides are at least MIN_SHARE_OF_SIDE of the smallest. `negatives`: the
    share of images whose dark and bright are exchanged.
    """

    size: tuple[int, int]  # width, height of the network's input, px
    window: tuple[int, int]
    jitter: float
    random: tuple[float, float]  # range of the factor on `size`
    saturation: float
    exposure: float
    hue: float
    flip: bool
    droplets: tuple[float, float] | None = None
    negatives: float = 0.0

    @staticmethod
    def of(
        cfg: Cfg, window: tuple[int, int] | None, random: tuple[float, float] | None
    ) -> "Augmentation":
        """What a ``.cfg`` asks for, with a window and a range of sizes of our own if given."""
        net, head = cfg.net, next(layer for layer in cfg.layers if layer.kind == "yolo")
        size = (cfg.width, cfg.height)
        by_cfg = (1 / DARKNET_RANDOM, DARKNET_RANDOM) if head.integer("random", 0) else (1.0, 1.0)
        return Augmentation(
            size=size,
            window=window or size,
            jitter=head.number("jitter", 0.2),
            random=random or by_cfg,
            saturation=net.number("saturation", 1.0),
            exposure=net.number("exposure", 1.0),
            hue=net.number("hue", 0.0),
            flip=bool(net.integer("flip", 1)),
        )


class TrainingImages(Dataset[Sample]):
    """Augmented training images. An item is asked for by (index, seed, factor on the size).

    With `draw`, an image is drawn anew from the seed each time, whatever the index.
    """

    def __init__(self, data: DataSet, augmentation: Augmentation, draw: DrawImage | None) -> None:
        self.paths, self.n_classes, self.source = (
            SharedPaths(data.train),
            len(data.names),
            data.path,
        )
        self.augmentation, self.draw = augmentation, draw

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, wanted: tuple[int, int, float]) -> Sample:
        index, seed, factor = wanted
        rng = np.random.default_rng(seed)
        if self.draw is None:
            image, class_ids, boxes = self._read(self.paths[index])
        else:
            image, boxes_px = self.draw(rng)
            class_ids = np.zeros(len(boxes_px), np.int64)
            boxes = boxes_px / np.tile(image.shape[1::-1], 2)
        augmented, truths = augment(rng, image, class_ids, boxes, self.augmentation, factor)
        return torch.from_numpy(augmented).permute(2, 0, 1), torch.from_numpy(truths)

    def _read(self, path: Path) -> tuple[Frame, Rows, Floats]:
        class_ids, boxes = read_labels(path)
        if (class_ids >= self.n_classes).any():
            raise DroptrackError(
                f"{path.with_suffix('.txt')}: has class {class_ids.max()}, but the data set "
                f"{self.n_classes} classes, counted from 0"
            )
        return read_frame(path), class_ids, boxes


class SharedPaths(Sequence[Path]):
    """Paths in memory that processes share: sent to one, they are a few bytes.

    A process that is spawned reads what it is sent once it has imported all it needs; until then
    the one that sends more than fits into a pipe waits, and starts no other.

    >>> list(SharedPaths([Path("a.png"), Path("b/c.png")]))
    [PosixPath('a.png'), PosixPath('b/c.png')]
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        names = [os.fsencode(path) for path in paths]
        self._ends = torch.tensor(np.cumsum([0, *map(len, names)]))
        self._names = torch.from_numpy(np.frombuffer(b"".join(names), np.uint8).copy())

    def __len__(self) -> int:
        return len(self._ends) - 1

    @overload
    def __getitem__(self, index: int) -> Path: ...

    @overload
    def __getitem__(self, index: slice) -> list[Path]: ...

    def __getitem__(self, index: int | slice) -> Path | list[Path]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        begin, end = self._ends[range(len(self))[index] :][:2].tolist()
        return Path(os.fsdecode(self._names[begin:end].numpy().tobytes()))


def augment(
    rng: np.random.Generator,
    image: Frame,
    class_ids: Rows,
    boxes_relative: Floats,
    how: Augmentation,
    factor: float,
) -> tuple[Pixels, Float32s]:
    """One image (H, W, 3) BGR, changed at random, and its ground truths; a grey one sooner.

    Returns (window h, window w, 3) RGB and (N, 5): class, box relative to the window. Boxes are cut
    at the window's edges; those of which less than MIN_VISIBLE is left are dropped.
    """
    plane = grey_plane(image)
    if plane is not None:
        image = np.asarray(plane)
    height, width = image.shape[:2]
    target = np.array(how.size) * factor
    if how.droplets is not None:
        sides = boxes_relative[:, 2:] * target
        known = _known(sides, *how.droplets)
        class_ids, boxes_relative = class_ids[known], boxes_relative[known]
    if how.negatives and rng.random() < how.negatives:
        image = 255 - image
    window = np.array(how.window, float)
    zoom = target / [width, height] * rng.uniform(1 - how.jitter, 1 + how.jitter, 2)
    centres = boxes_relative[:, :2] * zoom * [width, height]
    offset = _random_offset(rng, zoom * [width, height], centres, how)
    flip = how.flip and rng.random() < 0.5
    scale = zoom * np.array([-1 if flip else 1, 1])
    shift = -offset
    if flip:
        shift[0] = window[0] - shift[0]
    # a pixel's centre is at c + 0.5, OpenCV's warp counts centres from 0
    matrix = np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]]])
    matrix[:, 2] += 0.5 * scale - 0.5
    warped = cv2.warpAffine(image, matrix, how.window, borderMode=cv2.BORDER_REPLICATE)
    boxes = boxes_relative * [width, height, width, height]
    truths = _visible(class_ids, boxes[:, :2] * scale + shift, boxes[:, 2:] * zoom, window)
    return _recolour(rng, np.asarray(warped, np.uint8), how), truths


def _known(sides: Floats, smallest: float, largest: float) -> Bools:
    """Which boxes (N, 2) w, h px are of the sizes that have a label."""
    diameters = np.sqrt(sides.prod(axis=1))
    large_enough = (diameters > smallest) & (sides.min(axis=1) > MIN_SHARE_OF_SIDE * smallest)
    return np.asarray(large_enough & (diameters < largest), bool)


def _random_offset(
    rng: np.random.Generator, size: Floats, centres: Floats, how: Augmentation
) -> Floats:
    """Where the window begins in an image of `size` (2,) px; mostly so that a droplet is in it.

    `centres` (N, 2) px of the droplets.
    """
    window = np.array(how.window, float)
    slack = size - window
    margin = how.jitter * window * (slack <= 0)  # an image that fits is moved by up to that
    low, high = np.minimum(0, slack) - margin / 2, np.maximum(0, slack) + margin / 2
    if len(centres) and rng.random() < SHARE_WITH_DROPLET:
        wanted = centres[rng.integers(len(centres))]
        low = np.clip(wanted - window, low, high)
        high = np.clip(wanted, low, high)
    return np.asarray(rng.uniform(low, high))


def _visible(class_ids: Rows, centres: Floats, sizes: Floats, window: Floats) -> Float32s:
    """Ground truths (N, 5) relative to the window, of boxes of which enough is in it."""
    corners = np.stack([centres - sizes / 2, centres + sizes / 2])
    clipped = np.clip(corners, 0, window)
    visible = clipped[1] - clipped[0]
    enough = visible.prod(axis=1) > MIN_VISIBLE * sizes.prod(axis=1)
    keep = (visible.min(axis=1) > MIN_VISIBLE_PX) & enough
    relative = np.column_stack([clipped.mean(axis=0) / window, visible / window])
    return np.asarray(np.column_stack([class_ids, relative])[keep], np.float32)


def _recolour(rng: np.random.Generator, image: Pixels, how: Augmentation) -> Pixels:
    """Change exposure, saturation and hue as Darknet does; grey (H, W) or BGR -> RGB."""
    exposure, saturation = (
        float(limit ** rng.uniform(-1, 1)) for limit in (how.exposure, how.saturation)
    )
    hue = rng.uniform(-how.hue, how.hue)
    if image.ndim == 3 and (image == image[..., :1]).all():
        image = image[..., 0]
    if image.ndim == 2:  # grey: nothing else can change
        grey = cv2.convertScaleAbs(image, alpha=exposure)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV).astype(np.float32)
    hsv[..., 0] = (hsv[..., 0] + 180 * hue) % 180
    hsv[..., 1:] *= [saturation, exposure]
    bytes_ = np.clip(hsv, 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(bytes_, cv2.COLOR_HSV2RGB), np.uint8)


class Batches(Sampler[list[tuple[int, int, float]]]):
    """What each batch from iteration `start` to `stop` consists of; depends on `seed` only.

    Every image is used once before any is used again. With `share` (rank, count), every count-th
    image of each batch from the rank-th on.
    """

    def __init__(
        self,
        n: int,
        batch: int,
        start: int,
        stop: int,
        seed: int,
        random: tuple[float, float],
        share: tuple[int, int] = (0, 1),
    ) -> None:
        self.n, self.batch, self.start, self.stop = n, batch, start, stop
        self.seed, self.random, self.share = seed, random, share

    def __len__(self) -> int:
        return self.stop - self.start

    def __iter__(self) -> Iterator[list[tuple[int, int, float]]]:
        rank, count = self.share
        for iteration in range(self.start, self.stop):
            rng = np.random.default_rng([self.seed, iteration])
            low, high = self.random
            factor = float(np.exp(rng.uniform(np.log(low), np.log(high))))
            places = np.arange(iteration * self.batch, (iteration + 1) * self.batch)
            seeds = rng.integers(0, 2**62, self.batch)
            yield [
                (self._index(int(place)), int(seed), factor)
                for place, seed in zip(places[rank::count], seeds[rank::count], strict=True)
            ]

    def _index(self, place: int) -> int:
        epoch, within = divmod(place, self.n)
        if getattr(self, "_epoch", None) != epoch:
            self._epoch = epoch
            self._order = np.random.default_rng([self.seed, epoch, 1]).permutation(self.n)
        return int(self._order[within])


def collate(samples: Sequence[Sample]) -> tuple[Tensor, Tensor]:
    """Samples -> images (B, 3, H, W) uint8, truths (T, 6): image in the batch, class, box."""
    images = torch.stack([image for image, _ in samples])
    truths = [
        torch.cat([torch.full((len(boxes), 1), float(number)), boxes], dim=1)
        for number, (_, boxes) in enumerate(samples)
    ]
    return images, torch.cat(truths)


def quiet_worker(_: int) -> None:
    """Have one of the processes that prepare images compute in one thread."""
    leave_signals_to_the_first_process()
    leave_open_files_to_no_other()
    share_by_files()
    cv2.setNumThreads(1)


def share_by_files() -> None:
    """Have images go from process to process by files in memory: open files are few."""
    torch.multiprocessing.set_sharing_strategy("file_system")  # type: ignore[no-untyped-call]
