import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from droptrack.data.frames import as_frame, grey_plane
from droptrack.data.video import Video, VideoInfo, VideoWriter, mpeg4_info
from droptrack.errors import DroptrackError


def write_video(
    path: Path, n: int = 12, size: tuple[int, int] = (64, 48), fourcc: str = "MJPG"
) -> None:
    """Frame number t is grey level 10 t."""
    with VideoWriter(path, VideoInfo(*size, 12, n), fourcc) as video:
        for t in range(n):
            video.write(np.full((size[1], size[0], 3), 10 * t, np.uint8))


@pytest.mark.parametrize("size", [(64, 48), (65, 47)], ids=["even", "odd"])
def test_a_written_video_reads_back_in_order(tmp_path: Path, size: tuple[int, int]) -> None:
    write_video(tmp_path / "v.avi", size=size)
    video = Video(str(tmp_path / "v.avi"))
    assert video.info == VideoInfo(*size, 12, 12)
    levels = [int(frame[5, 5, 0]) for frame in video]
    assert np.abs(np.array(levels) - np.arange(12) * 10).max() <= 2


def test_a_folder_of_images_is_read_by_the_numbers_in_the_names(tmp_path: Path) -> None:
    for t in (1, 2, 10, 9):
        cv2.imwrite(str(tmp_path / f"frame_{t}.png"), np.full((20, 30), t, np.uint8))
    (tmp_path / "notes.txt").write_text("not an image")
    video = Video(str(tmp_path))
    assert video.info == VideoInfo(30, 20, 25.0, 10)
    found = [(number, int(frame[0, 0, 0])) for number, frame in video.numbered()]
    assert found == [(0, 1), (1, 2), (8, 9), (9, 10)]


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (np.full((4, 5), 100, np.uint8), 100),
        (np.full((4, 5, 1), 100, np.uint8), 100),
        (np.dstack([np.full((4, 5, 3), 200, np.uint8), np.full((4, 5), 127, np.uint8)]), 99),
        (np.full((4, 5), 100 * 256, np.uint16), 100),
        (np.full((4, 5), 0.5, np.float32), 127),
    ],
    ids=["grey", "grey with an axis", "half transparent", "16 bits", "fractions"],
)
def test_any_image_becomes_a_frame(image: np.ndarray, expected: int) -> None:
    frame = as_frame(image)
    assert frame.shape == (4, 5, 3)
    assert frame.dtype == np.uint8
    assert (frame == expected).all()


def test_a_cut_off_video_gives_the_frames_it_has(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    rng = np.random.default_rng(0)
    with VideoWriter(path, VideoInfo(160, 120, 25, 20), "MJPG") as video:
        for _ in range(20):
            video.write(rng.integers(0, 255, (120, 160, 3)).astype(np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert 5 < len(list(Video(str(path)))) < 20


@pytest.mark.parametrize("content", [b"", b"RIFF", b"this is no video" * 99])
def test_what_is_no_video_is_refused_in_one_line(
    tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "v.avi"
    path.write_bytes(content)
    with pytest.raises(DroptrackError, match=r"v\.avi"):
        Video(str(path))
    assert capfd.readouterr().err == ""


def test_what_cannot_be_a_file_with_a_video_is_said_at_once(tmp_path: Path) -> None:
    """A pipe kept it waiting for ever; an empty name was the current folder."""
    os.mkfifo(tmp_path / "pipe.avi")
    (tmp_path / "empty.avi").touch()
    (tmp_path / "itself.avi").symlink_to("itself.avi")
    for name, problem in (
        ("pipe.avi", "is a pipe"),
        ("empty.avi", "is empty"),
        ("itself.avi", "no such video"),
    ):
        with pytest.raises(DroptrackError, match=rf"{name}: {problem}"):
            Video(str(tmp_path / name))
    for name, problem in (
        ("", "the name of the video is empty"),
        ("~/v.avi", "write out what ~ stands for"),
        ("http://127.0.0.1:1/v.mp4?key=1", "cannot be opened; is the address right"),
        (str(tmp_path / "*.avi"), "no image whose name is .*; of several videos: droptrack batch"),
    ):
        with pytest.raises(DroptrackError, match=problem):
            Video(name)


@pytest.mark.parametrize(
    "name",
    [
        *("two\nlines.avi", "a b.avi", "it's.avi", 'a"b.avi', "100%.avi", "%03d.avi", "-x.avi"),
        *("--help.avi", "a;b.avi", "a&b|c.avi", "#1.avi", "drop💧.avi", "u\u0308.avi", "[a].avi"),
        *("a*b?.avi", "~a.avi", "$HOME.avi", "a\\b.avi", "file:x.avi", "concat:a.avi", "X.AVI"),
    ],
)
def test_a_file_may_have_any_name(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with VideoWriter(Path(name), VideoInfo(32, 16, 25, 2), "MJPG") as video:
        video.write(np.zeros((16, 32, 3), np.uint8))
        video.write(np.full((16, 32, 3), 200, np.uint8))
    for source in (name, str(tmp_path / name)):
        assert [int(frame[0, 0, 0]) for frame in Video(source)] == [0, 200]


def test_missing_sources_are_named(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match="no such video"):
        Video(str(tmp_path / "none.avi"))
    with pytest.raises(DroptrackError, match="no frame"):
        Video(str(tmp_path))  # an empty folder
    with pytest.raises(DroptrackError, match="camera 99"):
        Video("99")


def test_images_of_another_size_end_the_video_with_their_number(tmp_path: Path) -> None:
    for t, size in enumerate([(20, 30), (20, 30), (20, 31)]):
        cv2.imwrite(str(tmp_path / f"{t}.png"), np.zeros(size, np.uint8))
    frames = iter(Video(str(tmp_path)))
    next(frames), next(frames)
    with pytest.raises(DroptrackError, match="frame 2 is 31 x 20 px, those before it 30 x 20"):
        next(frames)


def test_a_damaged_image_in_a_folder_is_skipped_but_numbered(tmp_path: Path) -> None:
    for t in (0, 2):
        cv2.imwrite(str(tmp_path / f"{t}.png"), np.full((20, 30), t, np.uint8))
    (tmp_path / "1.png").write_bytes(b"not a png")
    video = Video(str(tmp_path))
    assert [(number, int(frame[0, 0, 0])) for number, frame in video.numbered()] == [(0, 0), (2, 2)]
    assert video.info.n_frames == 3


def test_what_is_damaged_in_the_middle_of_a_video_is_skipped(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    write_video(path, n=20, size=(320, 240))
    data = bytearray(path.read_bytes())
    middle, tenth = len(data) // 2, len(data) // 10
    data[middle : middle + tenth] = bytes(tenth)
    path.write_bytes(data)
    video = Video(str(path))
    levels = [round(int(frame[5, 5, 0]) / 10) for frame in video]
    assert 15 <= len(levels) < video.info.n_frames == 20
    assert levels == sorted(set(levels))
    assert levels[-1] == 19


def break_frames(path: Path, frames: set[int]) -> None:
    """Overwrite frames of an AVI file with zeros."""
    data = bytearray(path.read_bytes())
    start = data.index(b"movi") + 4
    index = 0
    while data[start : start + 4] == b"00dc":
        length = int.from_bytes(data[start + 4 : start + 8], "little")
        if index in frames:
            data[start + 8 : start + 8 + length] = bytes(length)
        start += 8 + length + length % 2
        index += 1
    path.write_bytes(data)


@pytest.mark.parametrize("fourcc", ["MJPG", "mp4v"])
def test_frames_keep_their_numbers_beside_damaged_ones(tmp_path: Path, fourcc: str) -> None:
    path = tmp_path / "v.avi"
    write_video(path, n=20, fourcc=fourcc)
    break_frames(path, {5, 6, 12, 19})
    video = Video(str(path))
    assert video.info.n_frames == 20
    found = {number: round(int(frame[5, 5, 0]) / 10) for number, frame in video.numbered()}
    assert found == {t: t for t in range(19) if t not in {5, 6, 12}}


def test_a_file_whose_first_frame_is_damaged_is_read_from_the_next(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    write_video(path)
    break_frames(path, {0, 1, 7})
    levels = [round(int(frame[5, 5, 0]) / 10) for frame in Video(str(path))]
    assert levels == [2, 3, 4, 5, 6, 8, 9, 10, 11]


def test_motion_jpeg_is_decoded_as_ffmpeg_does(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    rng = np.random.default_rng(3)
    with VideoWriter(path, VideoInfo(65, 47, 25, 6), "MJPG", quality=80) as writer:
        for t in range(6):
            coarse = rng.integers(0, 255, (6, 8, 3 if t > 2 else 1)).astype(np.uint8)
            writer.write(as_frame(cv2.resize(coarse, (65, 47), interpolation=cv2.INTER_CUBIC)))
    capture = cv2.VideoCapture(str(path))
    for frame in Video(str(path)):
        ok, expected = capture.read()
        assert ok
        luma, expected_luma = (cv2.cvtColor(x, cv2.COLOR_BGR2GRAY) for x in (frame, expected))
        assert cv2.absdiff(luma, expected_luma).mean() < 1


@pytest.mark.parametrize(("fourcc", "seen"), [("MJPG", 25), ("mp4v", 4)])
def test_grey_videos_stay_grey_until_a_colour_comes(tmp_path: Path, fourcc: str, seen: int) -> None:
    """In the fourth frame; every 25th of Motion JPEG is looked at."""
    with VideoWriter(tmp_path / "v.avi", VideoInfo(64, 48, 12, 30), fourcc) as video:
        for t in range(30):
            colour = (20, 90, 200) if t >= 4 else (90, 90, 90)
            video.write(np.full((48, 64, 3), colour, np.uint8))
    frames = list(Video(str(tmp_path / "v.avi")))
    assert [grey_plane(frame) is not None for frame in frames] == [t < seen for t in range(30)]
    assert np.abs(frames[0].astype(int) - 90).max() <= 2
    assert np.abs(frames[-1][5, 5].astype(int) - (20, 90, 200)).max() <= 4


@pytest.mark.parametrize(("difference", "grey"), [(4, True), (5, False)])
def test_colours_that_hardly_differ_are_grey(tmp_path: Path, difference: int, grey: bool) -> None:
    """One pixel of a lossless video is redder than the others."""
    image = np.full((48, 64, 3), 100, np.uint8)
    image[10, 20, 2] += difference
    with VideoWriter(tmp_path / "v.avi", VideoInfo(64, 48, 25, 1), "FFV1") as video:
        video.write(image)
    (frame,) = Video(str(tmp_path / "v.avi"))
    assert (grey_plane(frame) is not None) == grey
    assert frame[10, 20].tolist() == ([100, 100, 100] if grey else [100, 100, 105])


def test_an_unwritable_video_is_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match="cannot be written"):
        VideoWriter(tmp_path / "no" / "folder" / "v.avi", VideoInfo(64, 48, 25, 0), "MJPG")


WRITE_TO_A_FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from droptrack import DroptrackError
from droptrack.data.video import VideoInfo, VideoWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))  # as a full disk does, writes fail
try:
    with VideoWriter(Path(sys.argv[1]), VideoInfo(160, 120, 25, 0), sys.argv[2]) as video:
        for _ in range(40):
            video.write(np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8))
except DroptrackError as error:
    print(error)
"""


@pytest.mark.parametrize(("name", "fourcc"), [("v.mp4", "mp4v"), ("v.avi", "MJPG")])
def test_a_video_that_the_disk_has_no_room_for_is_said_to_be_cut(
    tmp_path: Path, name: str, fourcc: str
) -> None:
    pytest.importorskip("resource", reason="needs a system with limits on file sizes")
    arguments = [sys.executable, "-c", WRITE_TO_A_FULL_DISK, str(tmp_path / name), fourcc]
    printed = subprocess.run(arguments, capture_output=True, text=True, check=False).stdout
    assert name in printed
    assert "of 40 frames; is the disk full?" in printed


@pytest.mark.parametrize(
    ("fps", "held"),
    [
        *(
            (1000 / 3, 333.33),
            (211.222, 211.22),
            (666.67, 666.7),
            (20_000 / 3, 6667),
            (29.97, 29.97),
        ),
        *((30_000 / 1001, 29.97), (1e5, 65_535), (1e6, 65_535), (0.5, 0.5), (1 / 60, 0.017)),
        *((1e-5, 0.01), (65.536, 65.54)),
    ],
)
def test_any_rate_gives_a_video_with_the_nearest_one(
    tmp_path: Path, fps: float, held: float
) -> None:
    info, smaller = mpeg4_info(VideoInfo(64, 48, fps, 0))
    assert info.fps == pytest.approx(held)
    assert smaller == 1
    with VideoWriter(tmp_path / "v.mp4", info, "mp4v") as video:
        for _ in range(3):
            video.write(np.zeros((48, 64, 3), np.uint8))
    read = Video(str(tmp_path / "v.mp4"))
    assert read.info.n_frames == 3
    assert read.info.fps == pytest.approx(held, rel=1e-4)


@pytest.mark.parametrize("size", [(8192, 40), (40, 20_000), (8191, 30)])
def test_images_too_large_for_mpeg4_are_shrunk(tmp_path: Path, size: tuple[int, int]) -> None:
    info, smaller = mpeg4_info(VideoInfo(*size, 25, 0))
    assert max(info.width, info.height) <= 8190
    assert info.width == max(2, size[0] // smaller // 2 * 2)
    with VideoWriter(tmp_path / "v.mp4", info, "mp4v") as video:
        video.write(np.zeros((info.height, info.width, 3), np.uint8))
    assert Video(str(tmp_path / "v.mp4")).info.width == info.width


def quarter_turned(path: Path, to: Path) -> None:
    """A copy of a .mov whose track header says that it is to be turned by 90 degrees.

    QuickTime File Format, "Track Header Atoms": the matrix a b u c d v x y w, in 16.16 and 2.30.
    """
    data = bytearray(path.read_bytes())
    place = data.index(b"tkhd") + 4 + 40
    one = (1 << 16).to_bytes(4, "big")
    zero, minus = bytes(4), (-(1 << 16)).to_bytes(4, "big", signed=True)
    assert data[place : place + 4] == one
    data[place : place + 20] = zero + one + zero + minus + zero
    to.write_bytes(data)


@pytest.mark.parametrize("fourcc", ["mjpg", "mp4v"])
@pytest.mark.parametrize("size", [(64, 48), (64, 64)])
def test_a_turned_video_is_turned_upright(
    tmp_path: Path, fourcc: str, size: tuple[int, int]
) -> None:
    """A bright top left corner comes to the top right one."""
    image = np.zeros((size[1], size[0], 3), np.uint8)
    image[:16, :16] = 250
    code = cv2.VideoWriter.fourcc(*fourcc)
    writer = cv2.VideoWriter(str(tmp_path / "v.mov"), cv2.CAP_FFMPEG, code, 25.0, size)
    for _ in range(3):
        writer.write(image)
    writer.release()
    quarter_turned(tmp_path / "v.mov", tmp_path / "turned.mov")
    video = Video(str(tmp_path / "turned.mov"))
    assert (video.info.width, video.info.height) == size[::-1]
    frames = list(video)
    assert len(frames) == 3
    for frame in frames:
        assert frame[8, -8, 0] > 200
        assert frame[8, 8, 0] < 50


def test_frames_of_a_container_that_estimates_them_are_not_missed(tmp_path: Path) -> None:
    write_video(tmp_path / "v.avi")
    write_video(tmp_path / "v.mkv", fourcc="mp4v")
    assert Video(str(tmp_path / "v.avi")).counted
    assert not Video(str(tmp_path / "v.mkv")).counted


def test_frames_a_second_are_not_truncated(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"not 29\.97"):
        VideoWriter(tmp_path / "v.avi", VideoInfo(64, 48, 29.97, 0), "MJPG")
    with VideoWriter(tmp_path / "v.mp4", VideoInfo(64, 48, 29.97, 0), "mp4v") as video:
        for _ in range(5):
            video.write(np.zeros((48, 64, 3), np.uint8))
    assert Video(str(tmp_path / "v.mp4")).info.fps == pytest.approx(29.97, abs=1e-3)
