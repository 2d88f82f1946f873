"""Damaged videos of `bench.soak`: frames that show their number, so that a wrong one is seen."""

from pathlib import Path

import cv2
import numpy as np

from droptrack.data.frames import Frame
from droptrack.data.video import Video
from droptrack.errors import DroptrackError

N_FRAMES = 60
N_BITS = 6  # of a frame's number
BLOCK = 8  # px, as JPEG's: what is damaged in one does not blur into the next
SIZE = (8 * BLOCK, 2 * N_BITS * BLOCK)  # rows and columns
DARK, BRIGHT = 60, 190
MIN_CONTRAST = 40  # grey levels between the halves of a bit
MIN_ROWS = 4  # of blocks that say the same number, to believe it
N_ALIKE = {True: 2, False: 5}  # frames that are wrong by the same number, to tell it from damage
# container, codec, whether each frame stands by itself
KINDS = (
    ("v.avi", "MJPG", True),
    ("v.avi", "mp4v", False),
    ("v.mp4", "mp4v", False),
    ("v.mkv", "MJPG", True),
    ("v.mov", "MJPG", True),
    ("v.avi", "HFYU", True),
    ("v.mkv", "mp4v", False),
    ("v.webm", "VP80", False),
    ("v.ts", "MPG2", False),
    ("v.mpg", "MPG2", False),
)


def write_numbers(path: Path, fourcc: str, n_frames: int = N_FRAMES) -> None:
    """A video whose frames show their numbers."""
    backend = cv2.CAP_OPENCV_MJPEG if (path.suffix, fourcc) == (".avi", "MJPG") else cv2.CAP_FFMPEG
    code = cv2.VideoWriter.fourcc(*fourcc)
    writer = cv2.VideoWriter(str(path), backend, code, 25, SIZE[::-1])
    for number in range(n_frames):
        writer.write(numbered_image(number))
    writer.release()


def numbered_image(number: int) -> Frame:
    """Rows of blocks, of which every other one is inverted; a bit is two blocks, dark and bright.

    >>> shown_number(numbered_image(37))
    37
    """
    bits = np.array([number >> bit & 1 for bit in range(N_BITS)])
    halves = np.column_stack([bits, 1 - bits]).ravel()
    rows = np.array([halves, 1 - halves] * (SIZE[0] // BLOCK // 2))
    grey = np.kron(np.where(rows, BRIGHT, DARK), np.ones((BLOCK, BLOCK))).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def shown_number(frame: Frame) -> int | None:
    """The number that a frame shows; None where it is too damaged to tell."""
    if frame.shape[:2] != SIZE:
        return None
    blocks = frame[:, :, 0].reshape(SIZE[0] // BLOCK, BLOCK, 2 * N_BITS, BLOCK)
    halves = np.median(blocks, axis=(1, 3))
    contrast = (halves[:, ::2] - halves[:, 1::2]) * np.array([1, -1] * (len(halves) // 2))[:, None]
    whole = (np.abs(contrast) > MIN_CONTRAST).all(axis=1)
    numbers = (contrast[whole] > 0) @ (1 << np.arange(N_BITS))
    values, n_rows = np.unique(numbers, return_counts=True)
    if not len(values) or n_rows.max() < MIN_ROWS:
        return None
    return int(values[n_rows.argmax()])


def damage(path: Path, rng: np.random.Generator) -> None:
    """Cut a file off, overwrite a part of it, or flip some of its bytes."""
    data = bytearray(path.read_bytes())
    place = int(rng.integers(len(data)))
    kind = rng.integers(4)
    if kind == 0:
        del data[place:]
    elif kind == 1:
        length = min(len(data) - place, int(rng.integers(1, 4000)))
        data[place : place + length] = bytes(length)
    elif kind == 2:
        for one in rng.integers(0, len(data), int(rng.integers(1, 30))).tolist():
            data[one] ^= 1 << int(rng.integers(8))
    else:  # counts and sizes
        head = min(len(data), 400)
        place = int(rng.integers(head))
        data[place : place + 4] = rng.bytes(4)
    path.write_bytes(data)


def wrong_frame(path: Path, *, alone: bool) -> str | None:
    """What is wrong with a damaged video's frames, and not said; None where nothing is.

    A wrong count is wrong for all frames that follow. `alone`: a frame needs no other one; else
    damage stays in view for long, and may show an earlier one's number, but not a later one's.
    """
    numbers, ahead = [], []
    try:
        video = Video(str(path))
        for number, frame in video.numbered():
            numbers.append(number)
            shown = shown_number(frame)
            if shown is not None:
                ahead.append((number, shown - number))
    except DroptrackError:
        return None
    except Exception as error:  # noqa: BLE001  that is what is looked for
        return f"{type(error).__name__}: {error}"
    if numbers != sorted(set(numbers)):
        return "frames out of order"
    n_alike = N_ALIKE[alone]
    for i in range(len(ahead) - n_alike + 1):
        by = {n for _, n in ahead[i : i + n_alike]}
        if len(by) == 1 and by != {0} and (alone or min(by) > 0) and not video.doubt:
            number, n = ahead[i]
            return f"frame {number} shows that of {number + n}"
    return None
