"""Some frames spread over a video, to choose settings by that then hold for all of it."""

import time
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.frames import Frame, as_frame
from droptrack.data.video import Video, image_files, without_colour

N_SAMPLES = 4
MAX_SECONDS = 1.0  # after which no further frame is sought


def sample_frames(video: Video, n: int) -> list[Frame]:
    """Up to `n` frames (H, W, 3) from the first to the last, all of the first one's size.

    Those of a camera, a stream, or a file whose length nobody knows are its first frame only.
    """
    first = video.first_frame
    path = Path(video.source)
    if path.is_dir():
        files = image_files(path)
        frames = [_from_image(files[number]) for number in spread(len(files), n)[1:]]
    elif path.is_file() and video.info.n_frames > 1 and not video.live:
        frames = _from_file(path, spread(video.info.n_frames, n)[1:])
    else:
        frames = []
    return [first, *(frame for frame in frames if frame is not None and frame.shape == first.shape)]


def spread(total: int, n: int) -> list[int]:
    """The numbers of `n` of so many frames, evenly from the first to the last, each once.

    >>> spread(100, 3), spread(2, 5)
    ([0, 50, 99], [0, 1])
    """
    places = np.linspace(0, total - 1, n if total else 0)
    return sorted(set(np.round(places).astype(int).tolist()))


def _from_image(path: Path) -> Frame | None:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return None if image is None else as_frame(image)


def _from_file(path: Path, numbers: list[int]) -> list[Frame | None]:
    """Frames of a video file; fewer where they take long to find, None where one is damaged."""
    capture = cv2.VideoCapture(str(path))
    frames: list[Frame | None] = []
    began = time.perf_counter()
    for number in numbers:
        capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        ok, image = capture.read()
        frame = as_frame(image) if ok else None
        grey = None if frame is None else without_colour(frame)
        frames.append(frame if grey is None else grey)
        if time.perf_counter() - began > MAX_SECONDS:
            break
    capture.release()
    return frames
