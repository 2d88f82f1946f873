"""Videos as other programs write them; `reference/videos/make.sh` made these with ffmpeg."""

from pathlib import Path

import numpy as np
import pytest

from droptrack.data.sources.frame_times import FrameTimes
from droptrack.data.sources.mp4_edits import shown_share
from droptrack.data.sources.video_files import N_SAME, _stays_though_it_changes
from droptrack.data.video import Video, VideoInfo, VideoWriter
from droptrack.errors import DroptrackError

VIDEOS = Path(__file__).parents[1] / "reference" / "videos"
CODEC = 2  # grey levels by which a codec may be wrong
LEVELS = [20 + 15 * t for t in range(12)]


def levels_of(video: Video) -> dict[int, int]:
    """The grey level at the lower right of each frame, by its number."""
    return {number: int(np.median(frame[24:, 16:, 1])) for number, frame in video.numbered()}


def same(found: dict[int, int], expected: list[int]) -> bool:
    return list(found) == list(range(len(expected))) and bool(
        np.abs(np.array(list(found.values())) - expected).max() <= CODEC
    )


def test_frames_that_were_stored_in_another_order_come_in_theirs() -> None:
    video = Video(str(VIDEOS / "steady.mp4"))
    assert same(levels_of(video), LEVELS)
    assert (video.info.n_frames, video.counted, video.doubt) == (12, True, "")


def test_what_an_edit_list_leaves_out_is_not_missed() -> None:
    video = Video(str(VIDEOS / "cut.mp4"))
    assert (video.info.n_frames, video.counted) == (8, False)
    assert same(levels_of(video), LEVELS[4:])
    assert shown_share(VIDEOS / "steady.mp4") == 1
    assert shown_share(VIDEOS / "make.sh") == 1


@pytest.mark.parametrize("name", ["uneven.mp4", "uneven.mkv"])
def test_frames_that_were_left_out_are_missing(name: str) -> None:
    """Frames 4 to 6 were; the others have the times, and so the numbers, that they had."""
    video = Video(str(VIDEOS / name))
    found = levels_of(video)
    assert list(found) == [0, 1, 2, 3, 7, 8, 9, 10, 11]
    assert max(abs(level - LEVELS[number]) for number, level in found.items()) <= CODEC
    assert (video.n_left_out, video.doubt, video.info.fps) == (3, "", 25)


def test_times_that_a_container_rounds_are_steady() -> None:
    """Milliseconds, as in Matroska: 33, 67, 100 and so on; 0.5 becomes 0 or 1."""
    for rate in (30_000 / 1001, 2000.0):
        times = FrameTimes(rate)
        for t in range(1000):
            times.add(round(1000 * t / rate))
        assert times.doubt() == ""


def test_a_rate_that_is_wrong_for_all_frames_is_said() -> None:
    times = FrameTimes(30)
    for t in range(100):
        times.add(t * 1000 / 25)
    assert "are 0.04 s on average, not 1/30 s" in times.doubt()


@pytest.mark.parametrize("name", ["interlaced.mpg", "interlaced.mov", "interlaced.mp4"])
def test_interlaced_frames_are_read_rightly_or_refused(name: str) -> None:
    """The FFmpeg of OpenCV 4.14 gives black ones, or what was in the memory."""
    try:
        assert same(levels_of(Video(str(VIDEOS / name))), LEVELS)
    except DroptrackError as error:
        assert "its frames are interlaced" in str(error)  # noqa: PT017


def test_grey_of_12_bits_in_a_film_of_png_keeps_its_levels() -> None:
    video = Video(str(VIDEOS / "grey12.mov"))
    assert str(video.levels) == "0 to 4095, 12 bits, as its values show"
    assert list(levels_of(video).values()) == LEVELS


def test_pixels_that_are_not_square_are_said() -> None:
    video = Video(str(VIDEOS / "wide.mp4"))
    assert "a pixel is 2 wide and 1 high" in " ".join(video.notes)
    assert same(levels_of(video), LEVELS)
    assert Video(str(VIDEOS / "steady.mp4")).notes == ()


@pytest.mark.parametrize("moving", [True, False])
def test_what_was_in_the_memory_is_known_by_what_the_file_has(tmp_path: Path, moving: bool) -> None:
    """Images that stay the same, while the file has many bytes of each that changes."""
    path = tmp_path / "v.mp4"
    noise = np.random.default_rng(0).integers(0, 255, (6, 120, 160, 3), np.uint8)
    with VideoWriter(path, VideoInfo(160, 120, 25, 6), "mp4v") as video:
        for t in range(6):
            video.write(noise[t if moving else 0])
    stale = [noise[0]] * N_SAME
    assert _stays_though_it_changes(str(path), stale) is moving
    assert not _stays_though_it_changes(str(path), list(noise[:N_SAME]))
    assert len(list(Video(str(path)))) == 6


def test_a_video_that_is_black_is_read_and_doubted(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "v.mp4", VideoInfo(160, 120, 25, 6), "mp4v") as video:
        for _ in range(6):
            video.write(np.zeros((120, 160, 3), np.uint8))
    source = Video(str(tmp_path / "v.mp4"))
    assert [number for number, _ in source.numbered()] == list(range(6))
    assert "all its frames are black" in source.doubt
