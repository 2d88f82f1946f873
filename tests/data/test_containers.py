"""Videos as other programs write them; `reference/videos/make.sh` made these with ffmpeg."""

from pathlib import Path

import numpy as np
import pytest

from droptrack.data.sources.frame_times import FrameTimes
from droptrack.data.sources.mp4_tracks import Tracks, read_tracks
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
    assert read_tracks(VIDEOS / "cut.mp4").shown_share == pytest.approx(8 / 12)
    assert read_tracks(VIDEOS / "steady.mp4") == read_tracks(VIDEOS / "make.sh") == Tracks()


@pytest.mark.parametrize("matrix", [(-1, 0, 1), (1, 0, -1), (0, 1, 0), (0, -1, 0)])
def test_what_is_to_be_mirrored_is_refused_and_what_is_to_be_turned_is_not(
    tmp_path: Path, matrix: tuple[int, int, int]
) -> None:
    """The matrix a b u c d, of which c is b for a mirror along a diagonal, -b for a turn."""
    a, b, d = matrix
    data = (VIDEOS / "steady.mp4").read_bytes()
    place = data.index(b"tkhd") + 4 + 40
    for c in {b, -b}:
        path = tmp_path / f"{c}.mp4"
        entries = b"".join((one << 16).to_bytes(4, "big", signed=True) for one in (a, b, 0, c, d))
        path.write_bytes(data[:place] + entries + data[place + 20 :])
        if a == d == 0 and c == -b:
            assert len(list(Video(str(path)))) == 12
        else:
            with pytest.raises(DroptrackError, match="to be shown as in a mirror"):
                Video(str(path))


def with_another_track(data: bytes, n_samples: int | None = None) -> bytes:
    """The bytes of an .mp4 whose last box, moov, has its track twice, the second with so many."""
    moov, trak = (data.index(kind) - 4 for kind in (b"moov", b"trak"))
    size = int.from_bytes(data[trak : trak + 4], "big")
    track = data[trak : trak + size]
    if n_samples is not None:
        place = track.index(b"stsz") + 12
        track = track[:place] + n_samples.to_bytes(4, "big") + track[place + 4 :]
    whole = (len(data) - moov + size).to_bytes(4, "big")
    return data[:moov] + whole + data[moov + 4 : trak + size] + track + data[trak + size :]


def test_several_tracks_of_video_are_said_but_not_a_title_picture(tmp_path: Path) -> None:
    data = (VIDEOS / "steady.mp4").read_bytes()
    (tmp_path / "two.mp4").write_bytes(with_another_track(data))
    (tmp_path / "title.mp4").write_bytes(with_another_track(data, n_samples=1))
    assert [note for note in Video(str(tmp_path / "two.mp4")).notes if "2 tracks of video" in note]
    assert not Video(str(tmp_path / "title.mp4")).notes
    assert not Video(str(VIDEOS / "steady.mp4")).notes


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
    """The FFmpeg of OpenCV 4.14 gives black ones, or what was in the memory.

    Where that is black, too, as once in 150 times, it is a doubt.
    """
    try:
        video = Video(str(VIDEOS / name))
        found = levels_of(video)
        assert same(found, LEVELS) or (not any(found.values()) and "are black" in video.doubt)
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
    """Images that stay the same, though the file has much of each, or, read again, another one."""
    path = tmp_path / "v.mp4"
    noise = np.random.default_rng(0).integers(0, 255, (6, 120, 160, 3), np.uint8)
    with VideoWriter(path, VideoInfo(160, 120, 25, 6), "mp4v") as video:
        for t in range(6):
            video.write(noise[t if moving else 0])
    first = next(iter(Video(str(path))))
    assert _stays_though_it_changes(str(path), [first] * N_SAME) is moving
    assert _stays_though_it_changes(str(path), [noise[5]] * N_SAME)
    assert not _stays_though_it_changes(str(path), list(noise[:N_SAME]))
    assert len(list(Video(str(path)))) == 6


def test_a_video_that_is_black_is_read_and_doubted(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "v.mp4", VideoInfo(160, 120, 25, 6), "mp4v") as video:
        for _ in range(6):
            video.write(np.zeros((120, 160, 3), np.uint8))
    source = Video(str(tmp_path / "v.mp4"))
    assert [number for number, _ in source.numbered()] == list(range(6))
    assert "all its frames are black" in source.doubt
