"""Frames in and out: video files, folders of images, cameras; annotated videos.

A frame is a plain (H, W, 3) uint8 BGR array.
"""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.frames import Frame, as_frame, grey_frame, grey_plane
from droptrack.errors import DroptrackError

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm"}
DEFAULT_FPS = 25.0  # of sources that do not say
GREY = 4  # levels that the colours of a grey frame may differ by, from a codec's rounding
LOOK_FOR_COLOUR = 25  # frames from one look to the next, in Motion JPEG
# frames one after the other that cannot be decoded, before that is taken for the end
MAX_DAMAGED = 10_000
STREAMS = ("rtsp://", "rtmp://", "rtp://", "udp://", "srt://")


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
    names), or a camera by its index. Raises DroptrackError for what cannot be opened or read.

    The first frame is read at once, since only a decoded frame shows that a file is a video.
    """  # noqa: D205

    def __init__(self, source: str) -> None:
        self.source = source
        path = Path(source)
        if path.is_dir():
            self.live = False
            self._frames = _read_images(path)
            claimed, fps = len(image_files(path)), DEFAULT_FPS
        else:
            if not path.exists() and not source.isdigit() and "://" not in source:
                raise DroptrackError(f"{source}: no such video, image folder or camera")
            is_camera = source.isdigit() and not path.exists()
            self.live = is_camera or source.startswith(STREAMS)
            capture = _open_capture(source, is_camera=is_camera)
            claimed = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
            fps = float(capture.get(cv2.CAP_PROP_FPS))
            self._frames = _read_jpegs(path, capture) or _read_capture(capture, claimed)
        self._first = next(self._frames, None)
        if self._first is None:
            raise DroptrackError(f"{source}: has no frame that can be decoded; is it cut off?")
        height, width = self._first[1].shape[:2]
        sane = math.isfinite(fps) and 0 < fps <= 1e5
        self.info = VideoInfo(width, height, fps if sane else DEFAULT_FPS, claimed)

    @property
    def first_frame(self) -> Frame:
        """The first frame, until `numbered` has begun."""
        if self._first is None:
            raise ValueError("frames are being read")
        return self._first[1]

    def __iter__(self) -> Iterator[Frame]:
        """Every frame, once."""
        for _, frame in self.numbered():
            yield frame

    def numbered(self) -> Iterator[tuple[int, Frame]]:
        """Every frame that can be decoded, once, with its number.

        Frames are of one size: raises DroptrackError where that changes.
        """
        if self._first is None:
            raise ValueError("frames can be read once")
        first, self._first = self._first, None
        yield first
        for index, frame in self._frames:
            if frame.shape != first[1].shape:
                raise DroptrackError(
                    f"{self.source}: frame {index} is {frame.shape[1]} x {frame.shape[0]} px, "
                    f"those before it {first[1].shape[1]} x {first[1].shape[0]}; split the video "
                    "there"
                )
            yield index, frame


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
        self._size = (info.width, info.height)
        code = cv2.VideoWriter.fourcc(*fourcc)
        self._writer = cv2.VideoWriter(str(path), backend, code, info.fps, self._size, parameters)
        self._n_written = 0
        if not self._writer.isOpened():
            raise DroptrackError(
                f"{path}: cannot be written; is the folder writable, or the disk full?"
            )

    def write(self, frame: Frame) -> None:
        """Append a frame of the size given at the start."""
        if (frame.shape[1], frame.shape[0]) != self._size:
            raise ValueError(f"a frame of {frame.shape} in a video of {self._size}")
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


def _open_capture(source: str, *, is_camera: bool) -> cv2.VideoCapture:
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the error below says more
    capture = cv2.VideoCapture(int(source)) if is_camera else cv2.VideoCapture(source)
    cv2.utils.logging.setLogLevel(level)
    if not capture.isOpened():
        if is_camera:
            raise DroptrackError(f"camera {source}: cannot be opened; is it plugged in and free?")
        raise DroptrackError(f"{source}: is no video that OpenCV or FFmpeg can read")
    return capture


def _count_frames(path: Path) -> int:
    """The number of frames that a video file claims, 0 if it is none."""
    capture = cv2.VideoCapture(str(path))
    n_frames = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() else 0
    capture.release()
    return n_frames


def _read_capture(capture: cv2.VideoCapture, claimed: int) -> Iterator[tuple[int, Frame]]:
    """Frames of a camera, or of a video that claims to have so many.

    FFmpeg leaves some out that it cannot decode, and fails at others. That is not yet the end.
    """
    maybe_grey = True  # until the first frame with colour
    n_failed = 0
    try:
        for index in count():
            ok, image = capture.read()
            if ok:
                n_failed = 0
                frame = as_frame(image)
                grey = without_colour(frame) if maybe_grey else None
                maybe_grey = grey is not None
                yield index, frame if grey is None else grey
            else:
                n_failed += 1
                if index >= claimed or n_failed > MAX_DAMAGED:
                    return
    finally:
        capture.release()


def _read_jpegs(path: Path, capture: cv2.VideoCapture) -> Iterator[tuple[int, Frame]] | None:
    """Frames of a Motion JPEG file; None for other sources, and for other forms of it.

    OpenCV decodes a JPEG image in less time than FFmpeg, a grey one in half of it, and tells when
    one is damaged.
    """
    code = (int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF).to_bytes(4, "little")
    if code.upper() not in {b"MJPG", b"JPEG"} or not path.is_file():
        return None
    packets = _packets(path)
    first = next(packets, None)
    image = None if first is None else cv2.imdecode(first, cv2.IMREAD_COLOR)
    size = [capture.get(side) for side in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)]
    if first is None or image is None or list(image.shape[:2]) != size:  # half a frame, maybe
        return None
    capture.release()
    return _decoded(chain([first], packets))


def _packets(path: Path) -> Iterator[NDArray[np.uint8]]:
    """The frames of a video file as they are in it."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    try:
        while True:
            ok, packet = capture.read()
            if not ok:
                return
            yield np.asarray(packet, np.uint8)
    finally:
        capture.release()


def _decoded(packets: Iterable[NDArray[np.uint8]]) -> Iterator[tuple[int, Frame]]:
    """The frames of JPEG images, grey until one has a colour that an eighth of its size shows.

    Only some are looked at for that, since it takes as long as decoding them.
    """
    maybe_grey = True
    for index, packet in enumerate(packets):
        if maybe_grey and index % LOOK_FOR_COLOUR == 0:
            small = cv2.imdecode(packet, cv2.IMREAD_REDUCED_COLOR_8)
            maybe_grey = small is None or without_colour(as_frame(small)) is not None
        image = cv2.imdecode(packet, cv2.IMREAD_GRAYSCALE if maybe_grey else cv2.IMREAD_COLOR)
        if image is not None:
            yield index, as_frame(image)


def without_colour(frame: Frame) -> Frame | None:
    """The same as a grey frame; None where it has a colour."""
    if grey_plane(frame) is not None:
        return frame
    green = np.asarray(cv2.extractChannel(frame, 1), np.uint8)
    colour = cv2.norm(frame, cv2.cvtColor(green, cv2.COLOR_GRAY2BGR), cv2.NORM_INF)
    return grey_frame(green) if colour <= GREY else None


def image_files(folder: Path) -> list[Path]:
    """The images of a folder, in the order of the numbers in their names."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    numbers = re.compile(r"(\d+)")

    def order(path: Path) -> list[tuple[int, int, str]]:
        """Numbers in a name count as numbers: frame_2 comes before frame_10."""
        parts = numbers.split(path.name)
        return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]

    return sorted(files, key=order)


def _read_images(folder: Path) -> Iterator[tuple[int, Frame]]:
    for index, path in enumerate(image_files(folder)):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is not None:
            yield index, as_frame(image)
