"""Some frames spread over a video, to choose settings by that then hold for all of it."""

import time
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.frames import Frame, as_frame
from droptrack.data.sources.opencv_names import opencv_name
from droptrack.data.sources.video_files import without_colour
from droptrack.data.video import Video

N_SAMPLES = 8
MAX_SECONDS = 1.0  # of processors, after which no further frame is sought


def sample_frames(video: Video, n: int) -> list[Frame]:
    """Up to `n` frames (H, W, 3) from the first to the last, all of the first one's size.

    Those of a camera, a stream, or a file whose length nobody knows are its first frame only.
    """
    frames = video.samples()
    if len(frames) > 1:
        frames = [frames[place] for place in spread(len(frames), n)]
    elif not video.live and video.info.n_frames > 1 and Path(video.source).is_file():
        frames += _from_file(Path(video.source), spread(video.info.n_frames, n)[1:])
    return [frame for frame in frames if frame.shape == frames[0].shape]


def spread(total: int, n: int) -> list[int]:
    """The numbers of `n` of so many frames, evenly from the first to the last, each once.

    >>> spread(100, 3), spread(2, 5)
    ([0, 50, 99], [0, 1])
    """
    places = np.linspace(0, total - 1, n if total else 0)
    return sorted(set(np.round(places).astype(int).tolist()))


def _from_file(path: Path, numbers: list[int]) -> list[Frame]:
    """Frames of a video file; fewer where they take long to find, or cannot be decoded."""
    with opencv_name(path) as name:
        capture = cv2.VideoCapture(name)
    frames = []
    began = time.process_time()  # so that the choice does not depend on what else runs
    for number in numbers:
        capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        ok, image = capture.read()
        if ok:
            frame = as_frame(image)
            grey = without_colour(frame)
            frames.append(frame if grey is None else grey)
        if time.process_time() - began > MAX_SECONDS:
            break
    capture.release()
    return frames
