"""Frames in and out: video files, image folders, stacks, cameras; annotated videos.

A frame is a plain (H, W, 3) uint8 BGR array.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.frames import Frame, as_frame
from droptrack.data.levels import EIGHT_BITS, Levels, given_levels, levels_in, levels_of_bits
from droptrack.data.sources.image_files import IMAGE_SUFFIXES, TIFF_SUFFIXES, image_files
from droptrack.data.sources.image_sequences import open_image, open_sequence
from droptrack.data.sources.microscopy import MICROSCOPY_SUFFIXES, open_microscopy
from droptrack.data.sources.opencv_names import opencv_name
from droptrack.data.sources.other_formats import explain_unread, refuse_known
from droptrack.data.sources.phantom import open_cine
from droptrack.data.sources.photron import open_mraw
from droptrack.data.sources.source import N_SAMPLES, Image, ReadOptions, Source
from droptrack.data.sources.streams import Outages, open_stream
from droptrack.data.sources.tiff_stacks import open_stacks
from droptrack.data.sources.video_files import open_video
from droptrack.errors import DroptrackError

__all__ = ["IMAGE_SUFFIXES", "ReadOptions", "Video", "VideoInfo", "VideoWriter", "image_files"]

DEFAULT_FPS = 25.0  # of sources that do not say
MAX_FPS = 1e8
MIN_MPEG4_PX, MAX_MPEG4_PX = 2, 8190
MIN_MPEG4_RATE, MAX_MPEG4_RATE = 0.01, 65535


@dataclass(frozen=True)
class VideoInfo:
    """Width and height in px, frames a second, and the number of frames the container claims.

    `n_frames` is 0 where nothing is known, as for a camera.
    """

    width: int
    height: int
    fps: float
    n_frames: int


class Video:
    """A source of frames: a video file, a folder of images (in the order of the numbers in their
    names) or those of its images that fit a pattern (``folder/a_*.png``), an image, a TIFF stack, a
    camera by its index, or a stream. Raises DroptrackError for what cannot be opened or read.

    `levels`: which grey levels are black and white; `counted`: whether `info.n_frames` is no mere
    estimate; `n_absent`: how many of these are missing in a numbered sequence; `says_fps`: whether
    the file says its rate; `pixel_size_um`: 0 where it does not say; `notes`: what a user might not
    expect. The first frame is read at once, since only a decoded frame shows that a file is a
    video.
    """  # noqa: D205

    def __init__(self, source: str, options: ReadOptions | None = None) -> None:
        self.source = source
        options = options or ReadOptions()
        self._outages = Outages()
        opened, self.live = _open(source, options, self._outages)
        self._images = opened.images
        self._first = next(self._images, None)
        if self._first is None:
            raise DroptrackError(f"{source}: has no frame that can be decoded; is it cut off?")
        if self._first[1].dtype.kind not in "buif":
            raise DroptrackError(
                f"{source}: its values are of type {self._first[1].dtype}, not grey levels; save "
                "what is to be seen, as tifffile.imwrite('OUT.tif', abs(array))"
            )
        self.levels = self._choose_levels(opened, options)
        height, width = self._first[1].shape[:2]
        self.says_fps = math.isfinite(opened.fps) and 0 < opened.fps <= MAX_FPS
        fps = opened.fps if self.says_fps else DEFAULT_FPS
        self.info = VideoInfo(width, height, fps, opened.n_frames)
        self.counted = opened.counted
        self.n_absent = opened.n_absent
        self.pixel_size_um = opened.pixel_size_um
        self.notes = opened.notes
        self._times = opened.times
        self._doubt = opened.doubt
        self._samples = opened.samples

    def samples(self) -> list[Frame]:
        """Frames that can be had before `numbered` begins: from all over, else only the first."""
        if self._first is None:
            raise ValueError("frames are being read")
        images = [self._first[1], *(self._samples() if self._samples else [])[1:]]
        return [as_frame(image, self.levels) for image in images]

    def __iter__(self) -> Iterator[Frame]:
        """Every frame, once."""
        for _, frame in self.numbered():
            yield frame

    @property
    def doubt(self) -> str:
        """What makes one doubt the numbers of frames, or that they come at a steady rate."""
        return self._doubt or (self._times.doubt() if self._times is not None else "")

    @property
    def n_left_out(self) -> int:
        """Frames so far that are missing, by the times of those around them."""
        return self._times.n_left_out if self._times is not None else 0

    @property
    def n_lost(self) -> int:
        """Frames so far that came while a stream was away, by its rate."""
        return self._outages.n_frames

    def numbered(self) -> Iterator[tuple[int, Frame]]:
        """Every frame that can be decoded, once, with its number.

        Frames are of one size: raises DroptrackError where that changes.
        """
        if self._first is None:
            raise ValueError("frames can be read once")
        first, self._first = self._first, None
        for index, image in chain([first], self._images):
            self._refuse_another_kind(index, image, first[1])
            if _shows_something(image):
                yield index, as_frame(image, self.levels)

    def _choose_levels(self, opened: Source, options: ReadOptions) -> Levels:
        assert self._first is not None
        if options.levels is not None:
            return given_levels(*options.levels)
        if self._first[1].dtype in (np.uint8, np.bool_):
            return EIGHT_BITS
        if opened.bits:
            return levels_of_bits(opened.bits)
        samples = opened.samples() if opened.samples else None
        if not samples:
            ahead = list(islice(self._images, N_SAMPLES - 1))
            self._images = chain(ahead, self._images)
            samples = [image for _, image in [self._first, *ahead]]
        if not any(map(_shows_something, samples)):
            raise DroptrackError(f"{self.source}: has no finite value in its frames")
        return levels_in([_without_alpha(image) for image in samples])

    def _refuse_another_kind(self, index: int, image: Image, first: Image) -> None:
        if image.shape[:2] != first.shape[:2]:
            raise DroptrackError(
                f"{self.source}: frame {index} is {image.shape[1]} x {image.shape[0]} px, "
                f"those before it {first.shape[1]} x {first.shape[0]}; split the video there"
            )
        if image.dtype != first.dtype:
            raise DroptrackError(
                f"{self.source}: frame {index} is of type {image.dtype}, those before it of "
                f"{first.dtype}: their grey levels cannot be compared; split the video there"
            )


def _open(source: str, options: ReadOptions, outages: Outages) -> tuple[Source, bool]:
    """What a name stands for, and whether it is live."""
    if not source:
        raise DroptrackError("the name of the video is empty")
    path = Path(source)
    if options.reconnect_s and path.exists():
        raise DroptrackError(f"{source}: is no live stream; leave out --reconnect")
    if path.is_dir():
        return open_sequence(path, "*", options), False
    if path.is_fifo() or path.is_socket():
        raise DroptrackError(f"{source}: is a pipe, which cannot be read twice; save it first")
    if path.exists():
        suffix = path.suffix.lower()
        if suffix in TIFF_SUFFIXES:
            return open_stacks([path], options), False
        if suffix in IMAGE_SUFFIXES:
            return open_image(path, options), False
        if suffix == ".cine":
            return open_cine(path, options), False
        if suffix in (".mraw", ".cih", ".cihx"):
            return open_mraw(path, options), False
        if suffix in MICROSCOPY_SUFFIXES:
            return open_microscopy(path, options), False
        refuse_known(path)
        try:
            return open_video(path, options), False
        except DroptrackError:
            explain_unread(path)
            raise
    is_camera = source.isascii() and source.isdecimal()
    if not is_camera and "://" not in source:
        if any(sign in path.name for sign in "*?[") and path.parent.is_dir():
            return open_sequence(path.parent, path.name, options), False
        hint = "; write out what ~ stands for" if source.startswith("~") else ""
        raise DroptrackError(f"{source}: no such video, image folder or camera{hint}")
    return open_stream(source, options, outages)


def _shows_something(image: Image) -> bool:
    """Whether an image has a value; programs write frames that they lack as NaN."""
    return image.dtype.kind != "f" or bool(np.isfinite(image).any())


def _without_alpha(image: Image) -> Image:
    return image[..., :-1] if image.ndim == 3 and image.shape[2] in (2, 4) else image


def mpeg4_info(info: VideoInfo) -> tuple[VideoInfo, int]:
    """The nearest video that MPEG-4 (part 2) can hold, and by how much it is smaller.

    Rates are whole numbers of 16 bits over a power of ten, as OpenCV writes them; sides have up to
    MAX_MPEG4_PX.

    >>> mpeg4_info(VideoInfo(10_000, 500, 20_000 / 3, 0))
    (VideoInfo(width=5000, height=250, fps=6667.0, n_frames=0), 2)
    """
    smaller = -(-max(info.width, info.height) // MAX_MPEG4_PX)
    rates = (round(info.fps * scale) / scale for scale in (1000, 100, 10, 1))
    held = (rate for rate in rates if rate <= MAX_MPEG4_RATE / _scale_of(rate))
    fps = max(next(held, float(MAX_MPEG4_RATE)), MIN_MPEG4_RATE)
    size = (info.width, info.height)
    if smaller > 1 or min(size) < MIN_MPEG4_PX:
        size = (_even(info.width // smaller), _even(info.height // smaller))
    return VideoInfo(*size, fps, info.n_frames), smaller


def _even(side: int) -> int:
    return max(MIN_MPEG4_PX, side // 2 * 2)


def _scale_of(rate: float) -> int:
    """The power of ten that makes a rate with up to three decimals a whole number."""
    return next(scale for scale in (1, 10, 100, 1000) if abs(rate * scale % 1 - 0.5) > 0.4999)


class VideoWriter:
    """Writes frames to a video file; raises DroptrackError when that is not possible.

    `fourcc`: the codec; MJPG has nearly lossless frames (JPEG of a `quality` in %), but whole
    frames a second only (else ValueError).
    """

    def __init__(self, path: Path, info: VideoInfo, fourcc: str, quality: int = 95) -> None:
        self.path = path
        if fourcc == "MJPG" and info.fps != round(info.fps):
            raise ValueError(f"MJPG videos have whole frames a second, not {info.fps}")
        parameters = [cv2.VIDEOWRITER_PROP_QUALITY, quality] if fourcc == "MJPG" else []
        backend = cv2.CAP_OPENCV_MJPEG if fourcc == "MJPG" else cv2.CAP_FFMPEG
        self.size = (info.width, info.height)
        code = cv2.VideoWriter.fourcc(*fourcc)
        with opencv_name(path) as name:
            self._writer = cv2.VideoWriter(name, backend, code, info.fps, self.size, parameters)
        self._n_written = 0
        if not self._writer.isOpened():
            raise DroptrackError(
                f"{path}: cannot be written; is the folder writable, or the disk full?"
            )

    def write(self, frame: Frame) -> None:
        """Append a frame of the size given at the start."""
        if (frame.shape[1], frame.shape[0]) != self.size:
            raise ValueError(f"a frame of {frame.shape} in a video of {self.size}")
        self._writer.write(frame)
        self._n_written += 1

    def close(self) -> None:
        """Finish the file; raises DroptrackError if it does not hold every frame written.

        OpenCV does not say when a frame could not be written.
        """
        self._writer.release()
        n_held = _count_frames(self.path) if self._n_written else 0
        if n_held < self._n_written:
            raise DroptrackError(
                f"{self.path}: holds {n_held} of {self._n_written} frames; is the disk full?"
            )

    def __enter__(self) -> "VideoWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _count_frames(path: Path) -> int:
    """The number of frames that a video file claims, 0 if it is none."""
    with opencv_name(path) as name:
        capture = cv2.VideoCapture(name)
    n_frames = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() else 0
    capture.release()
    return n_frames
