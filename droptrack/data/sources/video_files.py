"""Video files, cameras and streams, through OpenCV and its FFmpeg."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count, islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.frames import Frame, as_frame, grey_frame, grey_plane
from droptrack.data.sources.avi_index import AviFrames, avi_frames, read_frames
from droptrack.data.sources.beginnings import (
    MATROSKA,
    MPEG_4,
    PROGRAM,
    RIFF,
    begins_with,
    doubt_of_beginning,
    is_packed,
)
from droptrack.data.sources.frame_times import ROUNDED_MS, FrameTimes
from droptrack.data.sources.jpeg_images import decode_jpeg
from droptrack.data.sources.mp4_tracks import Tracks, read_tracks
from droptrack.data.sources.opencv_names import opencv_name, without_log
from droptrack.data.sources.source import Image, ReadOptions, Source, refuse_channel
from droptrack.errors import DroptrackError

GREY = 4  # levels that the colours of a grey frame may differ by, from a codec's rounding
LOOK_FOR_COLOUR = 25  # frames from one look to the next, in Motion JPEG
# frames one after the other that cannot be decoded, before that is taken for the end
MAX_DAMAGED = 10_000
EXACT_MS = 0.05  # to which containers that COUNT give times
GREY_16 = int.from_bytes(b"Y1\x00\x10", "little")  # FFmpeg's code of grey with 16 bits
COUNTING = (*RIFF, *MPEG_4)  # containers that count their frames; others estimate them
# FFmpeg's codes of pixels of 8 bits whose luma lies alone; of 10, 12 and so on, the last byte
PLANAR = (b"I420", b"IYUV", b"YV12", b"422P", b"Y42B", b"444P")
MORE_BITS = b"Y3"
OUT_OF_STEP = (
    "what says where {n} of its frames begin is damaged: FFmpeg may have left them out, so that "
    "later ones have too small a number; is there another copy of the file?"
)
UNDECODED = (cv2.CAP_PROP_FORMAT, -1)
N_AHEAD, MIN_AHEAD = 300, 32  # frames whose times are looked at, to see whether they are steady
MAX_AHEAD = 2**26  # bytes of these
N_REORDERED = 16  # frames by which one may be stored before its turn, as H.264 has it at most
DEINTERLACE = "ffmpeg -i IN -vf bwdif -q:v 1 OUT.avi"
INTERLACED = (
    "{path}: its frames are interlaced, which OpenCV cannot convert, and each shows two times; "
    "make them whole: {cure}"
)
MIRRORED = (
    "{path}: is to be shown as in a mirror, which OpenCV does not; to mirror it: "
    "ffmpeg -i IN -q:v 1 OUT.avi"
)
SEVERAL = (
    "has {n} tracks of video, of which the first is read, or what FFmpeg takes for the main one; "
    "to read the second: ffmpeg -i IN -map 0:v:1 -c copy OUT.mp4"
)
N_LOOKED_AT = 20  # frames for one that is whole, before a codec is taken for another
MIN_ALIKE = 0.5  # correlation of a frame's luma with what the codec gave, if it was converted
# codecs, in lower case, that may be interlaced
INTERLACING = {
    *(b"h264", b"avc1", b"mpg1", b"mpg2", b"fmp4", b"mp4v", b"xvid", b"wvc1", b"hevc"),
    *(b"apch", b"apcn", b"apcs", b"apco", b"ap4h", b"ap4x", b"dvsd"),
}
MIN_OTHER_BYTES = 0.01  # of an image that is not the one before
N_SAME = 4  # frames that are looked at for whether they are one
MIN_CHANGE_BYTES, MIN_CHANGE = 100, 0.002  # of a frame that changes: bytes, and bytes a pixel
MIN_SPREAD = 3  # standard deviation of grey levels, to tell that
MAX_SPREAD = 6  # of a frame whose luma has less than MIN_SPREAD


def open_video(path: Path, options: ReadOptions) -> Source:
    """A video file. Raises DroptrackError for what OpenCV cannot read."""
    refuse_channel(str(path), options)
    if path.is_file() and not path.stat().st_size:
        raise DroptrackError(f"{path}: is empty: it has no bytes")
    tracks = read_tracks(path) if begins_with(path, MPEG_4) else Tracks()
    if tracks.is_mirrored:
        raise DroptrackError(MIRRORED.format(path=path))
    with opencv_name(path) as name:
        capture = open_capture(name, str(path))
        fps = float(capture.get(cv2.CAP_PROP_FPS))
        rate = fps if math.isfinite(fps) and fps > 0 else 0.0
        times = FrameTimes(
            rate,
            sparse=begins_with(path, PROGRAM),
            shown=not (begins_with(path, RIFF) or is_packed(path)),
            rounded_ms=EXACT_MS if begins_with(path, COUNTING) else ROUNDED_MS,
        )
        avi = avi_frames(path)
        n_frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        n_ahead = MAX_AHEAD * n_frames // path.stat().st_size if n_frames else N_AHEAD
        note = times.look_ahead(_times(name, min(N_AHEAD, max(MIN_AHEAD, n_ahead))))
        images = _read_jpegs(path, name, capture, times, avi)
        if images is None and int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) == GREY_16:
            capture.release()
            capture = open_capture(name, str(path), [cv2.CAP_PROP_CONVERT_RGB, 0])
    shape = _pixels_shape(capture)
    if begins_with(path, MATROSKA) and rate:
        times.length_ms = 1000 * n_frames / rate
    doubt = avi.doubt or OUT_OF_STEP.format(n=avi.n_odd) * bool(avi.n_odd) if avi else ""
    if images is not None:
        capture.release()
        if avi is not None:
            n_frames = len(avi.places) if avi.whole else max(n_frames, len(avi.places))
            doubt = avi.doubt
    several = SEVERAL.format(n=tracks.n) if tracks.n > 1 else ""
    share = tracks.shown_share
    cut = (1 - share) * n_frames > 0.5  # by an edit list; where, FFmpeg knows
    return Source(
        images=images or _converted(path, read_capture(capture, n_frames, times), times),
        n_frames=round(share * n_frames) if cut else n_frames,
        counted=begins_with(path, COUNTING) and not cut,
        fps=times.rate if note else fps,
        times=times,
        notes=tuple(f"{path}: {one}" for one in (note, shape, several) if one),
        doubt=doubt or doubt_of_beginning(path),
    )


def _pixels_shape(capture: cv2.VideoCapture) -> str:
    """What is to be said of a file whose pixels are not square."""
    width, height = (capture.get(one) for one in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
    if width <= 0 or height <= 0 or width == height:
        return ""
    return (
        f"says that a pixel is {width:g} wide and {height:g} high: lengths along x and y are not "
        "alike; to make pixels square: ffmpeg -i IN -vf scale=iw*sar:ih,setsar=1 -q:v 1 OUT.avi"
    )


def _times(name: str, n: int) -> list[float]:
    """The times of a file's first frames, ms, as they are in it; not decoded."""
    with without_log():
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, UNDECODED)
        found: list[float] = []
        while len(found) < n and capture.grab():
            found.append(float(capture.get(cv2.CAP_PROP_POS_MSEC)))
        capture.release()
    complete = len(found) < n
    return sorted(found)[: None if complete else -N_REORDERED]


def open_capture(
    source: int | str, name: str, parameters: Sequence[int] | None = None
) -> cv2.VideoCapture:
    """OpenCV's reader of a camera, file or stream; raises DroptrackError with its `name`."""
    with without_log():  # the error below says more
        if isinstance(source, int):
            capture = cv2.VideoCapture(source)
        elif parameters:
            capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, parameters)
        else:
            capture = cv2.VideoCapture(source)
    if not capture.isOpened():
        if isinstance(source, int):
            raise DroptrackError(f"camera {source}: cannot be opened; is it plugged in and free?")
        if "://" in name and not name.startswith("file:"):
            raise DroptrackError(
                f"{name}: cannot be opened; is the address right, is it there, and is it a video?"
            )
        raise DroptrackError(f"{name}: is no video that OpenCV or FFmpeg can read")
    return capture


def read_capture(
    capture: cv2.VideoCapture, claimed: int, times: FrameTimes | None = None
) -> Iterator[tuple[int, Image]]:
    """Frames of a camera, or of a video that claims to have so many; `times` are told theirs.

    FFmpeg leaves some out that it cannot decode, and fails at others. That is not yet the end.
    """
    maybe_grey = True  # until the first frame with colour
    times = times or FrameTimes(0)
    n_failed = 0
    try:
        for n_tried in count():
            ok, image = capture.read()
            if ok:
                index = times.add(capture.get(cv2.CAP_PROP_POS_MSEC), n_failed)
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
                if n_tried >= claimed or n_failed > MAX_DAMAGED:
                    return
    finally:
        capture.release()


def _converted(
    path: Path, images: Iterator[tuple[int, Image]], times: FrameTimes
) -> Iterator[tuple[int, Image]]:
    """The same images; raises DroptrackError where OpenCV could not convert the first of them.

    Where all are black, that is a doubt, which `times` keep.

    The FFmpeg of OpenCV 4.14 does not convert interlaced frames, and OpenCV gives what was in the
    memory instead, without a word. The luma of such a frame can be had from some files.
    """
    with opencv_name(path) as name, without_log():
        capture = cv2.VideoCapture(
            name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_CONVERT_RGB, 0, cv2.CAP_PROP_N_THREADS, 1]
        )
        ahead = list(islice(images, N_SAME))
        doubtful = _code_of(capture) in INTERLACING
        if doubtful and _stays_though_it_changes(name, [image for _, image in ahead]):
            raise DroptrackError(INTERLACED.format(path=path, cure=DEINTERLACE))
    known = bool(capture.get(cv2.CAP_PROP_ORIENTATION_META) % 360)
    n_black = n_seen = 0
    for index, image in chain(ahead, images):
        if not known and image.dtype == np.uint8:
            alike = _alike(capture, image)
            known = alike is not None
            if alike is False:
                raise DroptrackError(INTERLACED.format(path=path, cure=DEINTERLACE))
        if known:
            capture.release()
        n_seen += 1
        n_black += not known and not image.any()
        yield index, image
    if n_black == n_seen > 1:
        times.all_black = (
            "all its frames are black, as OpenCV makes interlaced ones; if it is interlaced, make "
            f"them whole: {DEINTERLACE}"
        )


def _stays_though_it_changes(name: str, images: Sequence[Image]) -> bool:
    """Whether the first images are the same to the last bit, though the file has much of each.

    So is memory that nothing was written to; images of what stands still take few bytes, and are
    the same when the file is read again, into other memory.
    """
    first = images[0] if images else None
    if first is None or len(images) < N_SAME:
        return False
    if not all(np.array_equal(first, image) for image in images):
        return False
    again = next(read_capture(cv2.VideoCapture(name, cv2.CAP_FFMPEG), 1), None)
    if again is not None and not np.array_equal(first, again[1]):
        return True
    enough = max(MIN_CHANGE_BYTES, first.shape[0] * first.shape[1] * MIN_CHANGE)
    packets = [packet.ravel() for _, packet in islice(_packets(name, FrameTimes(0)), N_SAME)]
    if len(packets) < N_SAME or min(len(packet) for packet in packets) <= enough:
        return False
    return any(
        len(packet) != len(packets[0]) or (packet != packets[0]).mean() > MIN_OTHER_BYTES
        for packet in packets
    )


def _alike(capture: cv2.VideoCapture, image: Image) -> bool | None:
    """Whether a frame has the luma that comes next, unconverted; None if that cannot be told."""
    code = (int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xFFFFFFFF).to_bytes(4, "little")
    two_bytes = code.startswith(MORE_BITS)
    if not (code in PLANAR or two_bytes):
        return True
    with without_log():
        ok, luma = capture.read()
    grey = image if image.ndim == 2 else image.mean(axis=2)
    if not ok or luma.shape != grey.shape:
        return True
    if two_bytes:  # of which OpenCV gives as many as there are pixels
        half = luma.shape[1] // 2
        luma = np.ascontiguousarray(luma[:, : 2 * half]).view("<u2") * (255 / 2 ** code[3])
        grey = grey[:, :half]
    if luma.size == 0 or luma.std() < MIN_SPREAD:
        return False if luma.size and grey.std() > MAX_SPREAD else None
    return bool(grey.std() and np.corrcoef(grey.ravel(), luma.ravel())[0, 1] > MIN_ALIKE)


def _read_jpegs(
    path: Path, name: str, capture: cv2.VideoCapture, times: FrameTimes, avi: AviFrames | None
) -> Iterator[tuple[int, Image]] | None:
    """Frames of a Motion JPEG or PNG file; None for other files, and for other forms of it.

    A JPEG image is decoded in less time than by FFmpeg, a grey one in half of it, and one that is
    damaged is known; of PNG all 16 bits are kept. What is to be turned is left to FFmpeg.
    """
    code = _code_of(capture)
    turned = capture.get(cv2.CAP_PROP_ORIENTATION_META) % 360
    is_png = code in {b"mpng", b"png "}
    if not (is_png or code in {b"mjpg", b"jpeg"}) or turned:
        return None
    packets = _packets(name, times) if avi is None else enumerate(read_frames(path, avi))
    decode = _decode_png if is_png else _decode_bgr
    height, width = (
        int(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)
    )
    ahead = []
    for number, packet in islice(packets, N_LOOKED_AT):
        ahead.append((number, packet))
        image = decode(packet)
        if image is not None:
            if image.shape[:2] != (height, width):  # half a frame, maybe
                return None
            every = chain(ahead, packets)
            return _decoded_png(every) if is_png else _decoded(every, (height, width))
    return None


def _code_of(capture: cv2.VideoCapture) -> bytes:
    """The codec of a file, four letters in lower case."""
    code = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    return code.to_bytes(4, "little").lower()


def _packets(name: str, times: FrameTimes) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The frames of a video file as they are in it, numbered; `times` are told theirs."""
    capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, UNDECODED)
    try:
        while True:
            ok, packet = capture.read()
            if not ok:
                return
            number = times.add(capture.get(cv2.CAP_PROP_POS_MSEC))
            yield number, np.asarray(packet, np.uint8)
    finally:
        capture.release()


def _decode_png(packet: NDArray[np.uint8]) -> Image | None:
    """A PNG image with all its bits; None of one that is damaged."""
    with without_log():
        image = cv2.imdecode(packet, cv2.IMREAD_UNCHANGED) if len(packet) else None
    return None if image is None else np.asarray(image)


def _decode_bgr(packet: NDArray[np.uint8], *, grey: bool = False) -> Image | None:
    """A JPEG image; None of one that is damaged."""
    try:
        return decode_jpeg(packet, grey=grey)
    except ValueError:
        return None


def _decoded_png(packets: Iterable[tuple[int, NDArray[np.uint8]]]) -> Iterator[tuple[int, Image]]:
    """The frames of PNG images."""
    for index, packet in packets:
        image = _decode_png(packet)
        if image is not None:
            yield index, image


def _decoded(
    packets: Iterable[tuple[int, NDArray[np.uint8]]], size: tuple[int, int]
) -> Iterator[tuple[int, Frame]]:
    """The frames of JPEG images, grey until one has a colour that an eighth of its size shows.

    Only some are looked at for that, since it takes as long as decoding them. One of another size
    than the file's is damaged.
    """
    maybe_grey = True
    for n_seen, (index, packet) in enumerate(packets):
        if maybe_grey and n_seen % LOOK_FOR_COLOUR == 0 and len(packet):
            with without_log():
                small = cv2.imdecode(packet, cv2.IMREAD_REDUCED_COLOR_8)
            maybe_grey = small is None or without_colour(as_frame(small)) is not None
        image = _decode_bgr(packet, grey=maybe_grey)
        if image is not None and image.shape[:2] == size:
            yield index, as_frame(image)


def without_colour(frame: Frame) -> Frame | None:
    """The same as a grey frame; None where it has a colour."""
    if grey_plane(frame) is not None:
        return frame
    green = np.asarray(cv2.extractChannel(frame, 1), np.uint8)
    colour = cv2.norm(frame, cv2.cvtColor(green, cv2.COLOR_GRAY2BGR), cv2.NORM_INF)
    return grey_frame(green) if colour <= GREY else None
