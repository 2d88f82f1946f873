"""The frames that an adaptation learns from, and those that it keeps back to judge the result."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import PIL.Image

from droptrack.data.darknet_dataset import read_ground_truth, read_image
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame, grey_frame, grey_plane
from droptrack.data.samples import spread
from droptrack.data.video import ReadOptions, Video, image_files
from droptrack.errors import DroptrackError

MIN_FRAMES = 8
MAX_FRAMES = 3000  # of a video that are looked at
STRETCHES = 4  # of frames one after the other, spread over what is learned from
STRETCH = 40  # frames
KEPT = 60  # frames kept back, at most: the last of a video
KEPT_SHARE = 5  # one in so many
MAX_BYTES = 6e8  # of frames that are held
# what a smooth image has none of, and noise 6 times (Immerkaer 1996)
NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
MIN_CHANGE = 4.0  # grey levels, of a pixel and its neighbours, that something moved
MIN_MOVED_PX = 12  # pixels
MIN_KEPT_LABELS = 8  # labelled images of which some are kept back


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One image: its number, its size (width, height) px, and its pixels (H, W, 3).

    Images of a footage are extended to one size, right and below; `size` is what counts.
    """

    number: int
    size: tuple[int, int]
    frame: Frame


@dataclass(frozen=True, kw_only=True)
class LabelledShot:
    """An image and the labels that a user gave it."""

    shot: Shot
    truth: Detections


@dataclass(frozen=True, kw_only=True)
class Footage:
    """Images to learn from, in stretches whose numbers follow on one another, and those kept back.

    `moving`: they may be frames of one video, so that droplets can be tracked.
    """

    stretches: tuple[tuple[Shot, ...], ...]
    kept: tuple[Shot, ...]
    moving: bool

    @property
    def used(self) -> list[Shot]:
        """All images to learn from."""
        return [shot for stretch in self.stretches for shot in stretch]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of all images as they are held, px."""
        height, width = self.kept[0].frame.shape[:2]
        return width, height


def read_footage(source: str, reading: ReadOptions, at_least: tuple[int, int]) -> Footage:
    """The images of a video, or of a folder; `at_least`: width and height to extend them to.

    Raises DroptrackError for what is too short, live, or cannot be read.
    """
    path = Path(source)
    sizes = {_size(file) for file in image_files(path)} if path.is_dir() else set()
    if len(sizes) > 1:
        return _of_images(source, reading, at_least)
    video = Video(source, reading)
    if video.live:
        raise DroptrackError(f"{source}: is live; adapt learns from a recorded video")
    n = sum(1 for _, _ in zip(range(MAX_FRAMES), video.numbered(), strict=False))
    if n < MIN_FRAMES:
        raise DroptrackError(f"{source}: has {n} frames; adapt needs {MIN_FRAMES} or more")
    n_bytes = video.info.width * video.info.height * 3
    most = max(MIN_FRAMES, int(MAX_BYTES / n_bytes))
    used, kept = _choose(n, most)
    wanted = {place for stretch in used for place in stretch} | set(kept)
    shots = {
        place: _shot(number, frame, at_least)
        for place, (number, frame) in zip(
            range(max(wanted) + 1), Video(source, reading).numbered(), strict=False
        )
        if place in wanted
    }
    return Footage(
        stretches=tuple(tuple(shots[place] for place in stretch) for stretch in used),
        kept=tuple(shots[place] for place in kept),
        moving=True,
    )


def read_labelled(folder: Path) -> tuple[list[tuple[Path, Frame]], list[Detections]]:
    """The labelled images of a folder, and their labels. Raises DroptrackError."""
    if not folder.is_dir():
        raise DroptrackError(f"--labels {folder}: should be a folder of images and label files")
    images, truths = [], []
    for path in image_files(folder):
        if not path.with_suffix(".txt").exists():
            continue
        frame = read_image(path)
        images.append((path, frame))
        truths.append(read_ground_truth(path, frame.shape[1], frame.shape[0]))
    if not images:
        raise DroptrackError(f"--labels {folder}: has no image with a label file (.txt) beside it")
    if not any(len(truth) for truth in truths):
        raise DroptrackError(f"--labels {folder}: none of its label files has a droplet")
    return images, truths


def labelled_shots(
    images: Sequence[tuple[Path, Frame]], truths: Sequence[Detections], size: tuple[int, int]
) -> tuple[list[LabelledShot], list[LabelledShot]]:
    """Labelled images to learn from and, of MIN_KEPT_LABELS or more, every fourth to judge by."""
    shots = [
        LabelledShot(shot=_shot(number, frame, size), truth=truth)
        for number, ((_, frame), truth) in enumerate(zip(images, truths, strict=True))
    ]
    if len(shots) < MIN_KEPT_LABELS:
        return shots, []
    return [one for i, one in enumerate(shots) if i % 4], shots[::4]


def _choose(n: int, most: int) -> tuple[list[range], range]:
    """Which of n frames to learn from, in stretches, and which to keep back; `most` in all."""
    n_kept = max(2, min(KEPT, n // KEPT_SHARE, most // 4))
    kept = range(n - n_kept, n)
    n_used = min(n - n_kept, STRETCHES * STRETCH, most - n_kept)
    if n_used == n - n_kept:
        return [range(n_used)], kept
    length = max(1, n_used // STRETCHES)
    starts = spread(n - n_kept - length + 1, STRETCHES)
    return [range(start, start + length) for start in starts], kept


def _of_images(source: str, reading: ReadOptions, at_least: tuple[int, int]) -> Footage:
    """Images of several sizes, which are no video."""
    files = image_files(Path(source))
    if len(files) < MIN_FRAMES:
        raise DroptrackError(f"{source}: has {len(files)} images; adapt needs {MIN_FRAMES} or more")
    files = [files[place] for place in spread(len(files), STRETCHES * STRETCH)]
    frames = [Video(str(file), reading).samples()[0] for file in files]
    size = tuple(max([frame.shape[1 - k] for frame in frames] + [at_least[k]]) for k in (0, 1))
    shots = [_shot(number, frame, (size[0], size[1])) for number, frame in enumerate(frames)]
    return Footage(
        stretches=(tuple(shot for i, shot in enumerate(shots) if i % KEPT_SHARE != 1),),
        kept=tuple(shot for i, shot in enumerate(shots) if i % KEPT_SHARE == 1),
        moving=False,
    )


def _size(file: Path) -> tuple[int, int]:
    """Width and height of an image file, from its first bytes where these say."""
    try:
        with PIL.Image.open(file) as image:
            return image.size
    except OSError:
        info = Video(str(file)).info
        return info.width, info.height


def _shot(number: int, frame: Frame, at_least: tuple[int, int]) -> Shot:
    """An image, extended by its edge to a size at least; grey where it has no colour."""
    height, width = frame.shape[:2]
    right, below = max(0, at_least[0] - width), max(0, at_least[1] - height)
    plane = grey_plane(frame)
    if plane is None and all((frame[..., 0] == frame[..., k]).all() for k in (1, 2)):
        plane = np.ascontiguousarray(frame[..., 0])
    image = frame if plane is None else plane
    if right or below:
        extended = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
        image = np.asarray(extended, np.uint8)
    shown = image if plane is None else grey_frame(image)
    return Shot(number=number, size=(width, height), frame=shown)


def is_still(shots: Iterable[Shot]) -> bool:
    """Whether nothing moves: images of one size that differ by no more than noise.

    Images are compared with the first one, less how the light changed; single pixels do not count.
    Noise is what neighbouring pixels do not share, since in a foam everything may move.
    """
    first: np.ndarray | None = None
    for shot in shots:
        grey = shot.frame.mean(axis=2, dtype=np.float32)
        if first is None:
            first = grey
            continue
        change = grey - first
        sigma = 1.4826 / 6 * float(np.median(np.abs(cv2.filter2D(change, -1, NOISE))))
        change = cv2.blur(change - np.median(change), (3, 3))
        moved = (np.abs(change) > max(MIN_CHANGE, 6 * sigma)).astype(np.uint8)
        moved = cv2.morphologyEx(moved, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        if int(moved.sum()) > MIN_MOVED_PX:
            return False
    return True
