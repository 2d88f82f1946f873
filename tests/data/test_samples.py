"""Frames spread over a video: the right ones, whatever the source is."""

from pathlib import Path

import cv2
import numpy as np

from droptrack.data.samples import sample_frames, spread
from droptrack.data.video import Video, VideoInfo, VideoWriter


def numbered(number: int) -> np.ndarray:
    """A grey frame that says its number by its level."""
    return np.full((64, 80, 3), 20 + number, np.uint8)


def test_frames_of_a_file_are_the_first_the_last_and_those_between(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    with VideoWriter(path, VideoInfo(80, 64, 25, 0), "MJPG", quality=100) as writer:
        for number in range(91):
            writer.write(numbered(number))
    video = Video(str(path))
    levels = [float(frame.mean()) - 20 for frame in sample_frames(video, 4)]
    np.testing.assert_allclose(levels, [0, 30, 60, 90], atol=0.6)
    assert len(list(video)) == 91  # and the video can still be read from its beginning


def test_images_of_a_folder_of_another_size_are_left_out(tmp_path: Path) -> None:
    for number in range(7):
        cv2.imwrite(str(tmp_path / f"frame_{number}.png"), numbered(number))
    cv2.imwrite(str(tmp_path / "frame_3.png"), np.zeros((10, 10), np.uint8))
    frames = sample_frames(Video(str(tmp_path)), 3)
    assert [round(float(frame.mean())) for frame in frames] == [20, 26]


def test_as_many_as_there_are() -> None:
    assert spread(0, 4) == []
    assert spread(1, 4) == [0]
    assert spread(3, 4) == [0, 1, 2]
