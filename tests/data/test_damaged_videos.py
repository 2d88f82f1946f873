"""Frames of damaged videos keep their numbers, or that they may not is said.

A frame's grey level is its number: nothing of the reader is asked.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from droptrack.data.sources.image_files import write_image_file
from droptrack.data.sources.jpeg_images import decode_jpeg
from droptrack.data.video import Video, VideoInfo, VideoWriter

N = 30
LEVEL = 8  # grey levels from frame to frame
HEADER = 8


def film(path: Path, fourcc: str = "MJPG") -> bytearray:
    """Frames of grey levels, with a ramp below."""
    with VideoWriter(path, VideoInfo(96, 64, 25, N), fourcc) as video:
        for t in range(N):
            image = np.full((64, 96, 3), LEVEL * t, np.uint8)
            image[40:] = np.arange(96, dtype=np.uint8)[None, :, None]
            video.write(image)
    return bytearray(path.read_bytes())


def chunks_of(data: bytearray) -> list[int]:
    """Where the chunks of frames begin."""
    places: list[int] = []
    place = data.find(b"00dc", data.find(b"movi"))
    while len(places) < N:
        places.append(place)
        size = int.from_bytes(data[place + 4 : place + 8], "little")
        place += HEADER + size + size % 2
    return places


def numbers_shown(video: Video) -> dict[int, int]:
    """The number that each frame shows, by the one it got."""
    return {
        number: round(float(np.median(frame[:32, :, 0])) / LEVEL)
        for number, frame in video.numbered()
    }


@pytest.mark.parametrize(
    "what", ["list", "sizes", "chunk", "entry", "both", "index", "index kinds", "two index kinds"]
)
def test_frames_of_an_avi_keep_their_numbers_whatever_of_it_is_damaged(
    tmp_path: Path, what: str
) -> None:
    path = tmp_path / "v.avi"
    data = film(path)
    chunks, index = chunks_of(data), data.rfind(b"idx1") + HEADER
    lost: set[int] = set()
    if what == "list":  # the list's head, and the frames that follow
        data[data.find(b"movi") - 8 : chunks[4] + 20] = bytes(chunks[4] + 28 - data.find(b"movi"))
        lost = {0, 1, 2, 3, 4}
    elif what == "sizes":
        data[4:8] = data[chunks[3] + 4 : chunks[3] + 8] = b"\x12\xff\xff\x01"
    elif what == "chunk":
        data[chunks[7] : chunks[7] + HEADER] = bytes(HEADER)
    elif what == "entry":
        data[index + 16 * 7 : index + 16 * 8] = bytes(16)
    elif what == "both":  # of the same frame
        data[index + 16 * 7 : index + 16 * 8] = bytes(16)
        data[chunks[7] : chunks[7] + HEADER] = bytes(HEADER)
        lost = {7}
    elif what == "index":  # and some frames
        data[index - HEADER :] = bytes(len(data) - index + HEADER)
        data[chunks[7] - 1 : chunks[10] + 5] = bytes(chunks[10] + 6 - chunks[7])
        lost = {6, 7, 8, 9, 10}
    elif what == "index kinds":
        data[index + 16 * 3] ^= 1  # 10dc, of which there is no other
    else:
        for number in (3, 9):
            data[index + 16 * number] ^= 1
    path.write_bytes(data)
    shown = numbers_shown(Video(str(path)))
    assert all(number == seen for number, seen in shown.items())
    assert set(range(N)) - lost <= set(shown)


def test_lost_frames_that_nothing_tells_the_number_of_are_said(tmp_path: Path) -> None:
    """Two gaps, and no index: nobody knows how many frames were in each."""
    path = tmp_path / "v.avi"
    data = film(path)
    chunks = chunks_of(data)
    data[data.rfind(b"idx1") :] = b""
    for first, last in ((4, 6), (12, 17)):
        data[chunks[first] : chunks[last]] = bytes(chunks[last] - chunks[first])
    path.write_bytes(data)
    video = Video(str(path))
    assert list(numbers_shown(video).values()) == [*range(4), *range(6, 12), *range(17, N)]
    assert "frames may be missing" in video.doubt


def test_frames_that_were_cut_off_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    data = film(path)
    path.write_bytes(data[: chunks_of(data)[20]])
    video = Video(str(path))
    assert (video.info.n_frames, video.counted, video.doubt) == (N, True, "")
    assert list(numbers_shown(video)) == list(range(20))


def test_what_ffmpeg_may_leave_out_of_an_avi_is_said(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    data = film(path, "mp4v")
    assert Video(str(path)).doubt == ""
    data[chunks_of(data)[7] + 2] ^= 1
    path.write_bytes(data)
    assert "where 1 of its frames begin is damaged" in Video(str(path)).doubt


def test_an_image_of_which_a_part_is_damaged_is_no_frame(tmp_path: Path) -> None:
    """OpenCV fills the rest with grey; so a droplet would be where none is."""
    path = tmp_path / "v.avi"
    data = film(path)
    scan = data.find(b"\xff\xda", chunks_of(data)[7])
    data[scan + 30 : scan + 34] = b"\xff\xd9\xff\xd9"  # its end comes too soon
    path.write_bytes(data)
    assert set(range(N)) - set(numbers_shown(Video(str(path)))) == {7}

    (tmp_path / "images").mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (64, 96), np.uint8)
    for number in range(3):
        write_image_file(tmp_path / "images" / f"{number}.jpg", noise)
    whole = (tmp_path / "images" / "1.jpg").read_bytes()
    (tmp_path / "images" / "1.jpg").write_bytes(whole[: len(whole) // 2])
    assert [number for number, _ in Video(str(tmp_path / "images")).numbered()] == [0, 2]


@pytest.mark.parametrize("grey", [True, False])
def test_what_cameras_write_wrongly_of_whole_images_is_no_damage(grey: bool) -> None:
    """No end, or some bytes before it; the pixels are those that OpenCV decodes."""
    image = np.random.default_rng(0).integers(0, 255, (64, 96, 3), np.uint8)
    data = cv2.imencode(".jpg", image)[1].tobytes()
    flags = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    for content in (data, data[:-2], data[:-2] + b"\0\0\0" + data[-2:], data + bytes(7)):
        found = decode_jpeg(np.frombuffer(content, np.uint8), grey=grey)
        assert found is not None
        assert (found == cv2.imdecode(np.frombuffer(data, np.uint8), flags)).all()


def test_an_image_whose_last_part_claims_more_than_there_is_is_damaged() -> None:
    """Random bytes found it: an end that is added is no end then."""
    data = bytearray(cv2.imencode(".jpg", np.zeros((64, 96), np.uint8))[1].tobytes())
    place = data.find(b"\xff\xdb") + 2
    data[place : place + 2] = b"\xff\xff"
    for content in (data, data[: place + 40]):
        array = np.frombuffer(bytes(content), np.uint8)
        try:
            assert decode_jpeg(array, grey=True) is None
        except ValueError as error:
            assert "JPEG" in str(error)  # noqa: PT017
