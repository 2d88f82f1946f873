"""Video files, cameras and streams, through OpenCV and its FFmpeg."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.frames import Frame, as_frame, grey_frame, grey_plane
from droptrack.data.sources.avi_index import avi_frames, read_frames
from droptrack.data.sources.opencv_names import opencv_name
from droptrack.data.sources.source import Image, ReadOptions, Source, refuse_channel
from droptrack.errors import DroptrackError

GREY = 4  # levels that the colours of a grey frame may differ by, from a codec's rounding
LOOK_FOR_COLOUR = 25  # frames from one look to the next, in Motion JPEG
# frames one after the other that cannot be decoded, before that is taken for the end
MAX_DAMAGED = 10_000
GREY_16 = int.from_bytes(b"Y1\x00\x10", "little")  # FFmpeg's code of grey with 16 bits
# what the first bytes of files are whose containers count their frames; others estimate them
COUNTING = ((0, b"RIFF"), (4, b"ftyp"), (4, b"moov"), (4, b"mdat"), (4, b"wide"), (4, b"free"))


def open_video(path: Path, options: ReadOptions) -> Source:
    """A video file. Raises DroptrackError for what OpenCV cannot read."""
    refuse_channel(str(path), options)
    with opencv_name(path) as name:
        capture = open_capture(name, str(path))
        images = _read_jpegs(path, name, capture)
        if images is None and int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) == GREY_16:
            capture.release()
            capture = open_capture(name, str(path), [cv2.CAP_PROP_CONVERT_RGB, 0])
    n_frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    fps = float(capture.get(cv2.CAP_PROP_FPS))
    if images is not None:
        capture.release()
    return Source(
        images=images or read_capture(capture, n_frames),
        n_frames=n_frames,
        counted=_counts_frames(path),
        fps=fps,
    )


def open_capture(
    source: int | str, name: str, parameters: Sequence[int] | None = None
) -> cv2.VideoCapture:
    """OpenCV's reader of a camera, file or stream; raises DroptrackError with its `name`."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the error below says more
    if isinstance(source, int):
        capture = cv2.VideoCapture(source)
    elif parameters:
        capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, parameters)
    else:
        capture = cv2.VideoCapture(source)
    cv2.utils.logging.setLogLevel(level)
    if not capture.isOpened():
        if isinstance(source, int):
            raise DroptrackError(f"camera {source}: cannot be opened; is it plugged in and free?")
        raise DroptrackError(f"{name}: is no video that OpenCV or FFmpeg can read")
    return capture


def read_capture(capture: cv2.VideoCapture, claimed: int) -> Iterator[tuple[int, Image]]:
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
                if image.dtype != np.uint8:
                    yield index, image
                    continue
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


def _counts_frames(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(12)
    return any(head[place:].startswith(mark) for place, mark in COUNTING)


def _read_jpegs(
    path: Path, name: str, capture: cv2.VideoCapture
) -> Iterator[tuple[int, Image]] | None:
    """Frames of a Motion JPEG file; None for other files, and for other forms of it.

    OpenCV decodes a JPEG image in less time than FFmpeg, a grey one in half of it, and tells when
    one is damaged. What is to be turned is left to FFmpeg.
    """
    code = (int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF).to_bytes(4, "little")
    turned = capture.get(cv2.CAP_PROP_ORIENTATION_META) % 360
    if code.upper() not in {b"MJPG", b"JPEG"} or turned:
        return None
    packets = _packets(name)
    first = next(packets, None)
    image = None if first is None else cv2.imdecode(first, cv2.IMREAD_COLOR)
    size = [capture.get(side) for side in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)]
    if first is None or image is None or list(image.shape[:2]) != size:  # half a frame, maybe
        return None
    frames = avi_frames(path, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    return _decoded(chain([first], packets) if frames is None else read_frames(path, frames))


def _packets(name: str) -> Iterator[NDArray[np.uint8]]:
    """The frames of a video file as they are in it."""
    capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
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
    as_it_is = cv2.IMREAD_IGNORE_ORIENTATION  # the container says how a video is turned
    maybe_grey = True
    for index, packet in enumerate(packets):
        if maybe_grey and index % LOOK_FOR_COLOUR == 0:
            reduced = cv2.IMREAD_REDUCED_COLOR_8 | as_it_is
            small = cv2.imdecode(packet, reduced) if len(packet) else None
            maybe_grey = small is None or without_colour(as_frame(small)) is not None
        colours = cv2.IMREAD_GRAYSCALE if maybe_grey else cv2.IMREAD_COLOR
        image = cv2.imdecode(packet, colours | as_it_is) if len(packet) else None
        if image is not None:
            yield index, as_frame(image)


def without_colour(frame: Frame) -> Frame | None:
    """The same as a grey frame; None where it has a colour."""
    if grey_plane(frame) is not None:
        return frame
    green = np.asarray(cv2.extractChannel(frame, 1), np.uint8)
    colour = cv2.norm(frame, cv2.cvtColor(green, cv2.COLOR_GRAY2BGR), cv2.NORM_INF)
    return grey_frame(green) if colour <= GREY else None
