"""Short videos for studies."""

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest

from droptrack.data.video import Video, VideoInfo, VideoWriter


@pytest.fixture(scope="session")
def clips(sine: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, int, int], Path]:
    """Writes some frames of the paper's test video, from the first on, as a video of their own."""
    frames = list(islice(Video(str(sine / "video.avi")), 40))

    def write(path: Path, first: int, n: int) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        height, width = frames[0].shape[:2]
        with VideoWriter(path, VideoInfo(width, height, 25, n), "MJPG") as video:
            for frame in frames[first : first + n]:
                video.write(frame)
        return path

    return write
