"""Frames keep their numbers where others are missing in .mkv, .mp4, .mov, .ts, .mpg and .webm.

Each frame shows its number, as it was drawn: nothing of the reader is asked.
"""

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from bench.soak_videos import SIZE, numbered_image, shown_number
from droptrack.data.sources.beginnings import doubt_of_beginning
from droptrack.data.sources.frame_times import FrameTimes
from droptrack.data.video import Video
from droptrack.errors import DroptrackError

N = 60
KINDS = [
    ("v.mkv", "MJPG"),
    ("v.mkv", "mp4v"),
    ("v.mkv", "FFV1"),
    ("v.webm", "VP80"),
    ("v.mp4", "mp4v"),
    ("v.mov", "MJPG"),
    ("v.ts", "MPG2"),
    ("v.mpg", "MPG2"),
]
TAIL = 16  # bytes, by which a frame is found in its file
BLOCK_HEAD = 4  # bytes of a Matroska block before its frame: track, time, flags


def film(path: Path, fourcc: str, n: int = N) -> bytearray:
    code = cv2.VideoWriter.fourcc(*fourcc)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 25, SIZE[::-1])
    for number in range(n):
        writer.write(numbered_image(number))
    writer.release()
    return bytearray(path.read_bytes())


def packets(path: Path) -> list[tuple[int, int]]:
    """Where each frame lies in a file, by its last bytes; of a transport stream nearly."""
    data, at, found = path.read_bytes(), 0, list[tuple[int, int]]()
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    while True:
        ok, packet = capture.read()
        if not ok:
            return found
        content = packet.tobytes()
        tail = content[-TAIL:]
        end = data.find(tail, at) + len(tail)
        assert end >= len(tail)
        found.append((max(at, end - len(content)), end))
        at = end


def shown(video: Video) -> dict[int, int | None]:
    """The number that each frame shows, by the one it got."""
    return {number: shown_number(frame) for number, frame in video.numbered()}


def numbers_and_doubt(path: Path) -> tuple[list[int], str]:
    video = Video(str(path))
    return [number for number, _ in video.numbered()], video.doubt


def ahead(video: Video) -> set[int]:
    """By how much the frames show a later number than theirs; an earlier one stays in view."""
    return {seen - number for number, seen in shown(video).items() if seen and seen > number}


@pytest.mark.parametrize(("name", "fourcc"), KINDS)
def test_whole_videos_have_all_their_frames_and_no_doubt(
    tmp_path: Path, name: str, fourcc: str
) -> None:
    film(tmp_path / name, fourcc)
    video = Video(str(tmp_path / name))
    assert shown(video) == {number: number for number in range(N)}
    assert (video.doubt, video.notes, video.n_left_out) == ("", (), 0)


@pytest.mark.parametrize("damaged", [[0], [0, 1, 2], [7], [30, 31, 32]])
@pytest.mark.parametrize("more", [0, 30])
@pytest.mark.parametrize(("name", "fourcc"), KINDS)
def test_frames_after_damaged_ones_keep_their_numbers_or_that_is_said(
    tmp_path: Path, name: str, fourcc: str, more: int, damaged: list[int]
) -> None:
    """Whole frames, or with what stands before them in the file: the container's own words."""
    path = tmp_path / name
    data, places = film(path, fourcc), packets(path)
    for number in damaged:
        start = max(0, places[number][0] - more)
        data[start : places[number][1]] = bytes(places[number][1] - start)
    path.write_bytes(data)
    try:
        video = Video(str(path))
        assert ahead(video) == set() or video.doubt
    except DroptrackError as error:
        assert "is no video" in str(error)  # noqa: PT017


def test_first_frames_that_cannot_be_decoded_are_missing(tmp_path: Path) -> None:
    path = tmp_path / "v.mkv"
    data, places = film(path, "MJPG"), packets(path)
    for start, end in (*places[:3], places[20]):
        data[start:end] = bytes(end - start)
    path.write_bytes(data)
    assert shown(Video(str(path))) == {t: t for t in range(N) if t not in (0, 1, 2, 20)}


@pytest.mark.parametrize("fourcc", ["MJPG", "mp4v"])
def test_a_cluster_that_is_lost_leaves_a_gap(tmp_path: Path, fourcc: str) -> None:
    """Matroska's clusters, of which FFmpeg looks for the next one; the first one is said."""
    path = tmp_path / "v.mkv"
    data = film(path, fourcc, 400)
    clusters = [place for place in range(len(data)) if data[place : place + 4] == b"\x1fC\xb6u"]
    assert len(clusters) >= 3
    whole = bytes(data)
    data[clusters[1] : clusters[1] + 40] = bytes(40)
    path.write_bytes(data)
    numbers, doubt = numbers_and_doubt(path)
    assert numbers == sorted(numbers)
    assert numbers[-1] == 399
    assert 400 - len(numbers) > 10
    assert doubt == ""

    data = bytearray(whole)
    data[clusters[0] : clusters[0] + 40] = bytes(40)
    path.write_bytes(data)
    assert "frames may be missing" in Video(str(path)).doubt


def at_times(path: Path, time_of: Callable[[int], int], *, longer: bool = True) -> Path:
    """A Matroska film whose frames are shown at these times, ms; its blocks have them.

    `longer`: let it claim to be as long.
    """
    data = film(path, "MJPG")
    for number, (start, _) in enumerate(packets(path)):
        place = start - BLOCK_HEAD
        assert data[place] == 0x81, "track 1"
        (in_cluster,) = struct.unpack_from(">h", data, place + 1)
        struct.pack_into(">h", data, place + 1, in_cluster + time_of(number) - 40 * number)
    if longer:
        place = data.find(b"\x44\x89\x88") + 3
        assert struct.unpack_from(">d", data, place) == (40 * N,)
        struct.pack_into(">d", data, place, time_of(N - 1) + 40)
    path.write_bytes(data)
    return path


def test_frames_that_were_never_recorded_are_missing(tmp_path: Path) -> None:
    """As by a camera that dropped frames 20 to 22, and 50."""
    path = at_times(tmp_path / "v.mkv", lambda t: 40 * (t + 3 * (t >= 20) + (t >= 47)))
    video = Video(str(path))
    expected = {t + 3 * (t >= 20) + (t >= 47): t for t in range(N)}
    assert shown(video) == expected
    assert (video.n_left_out, video.doubt, video.info.fps) == (4, "", 25)


def test_times_beyond_the_length_that_a_file_claims_are_said(tmp_path: Path) -> None:
    """One flipped bit in the time of a cluster."""
    path = at_times(tmp_path / "v.mkv", lambda t: 40 * t + 8192 * (t > 50), longer=False)
    assert "claims to be 2.4 s long" in numbers_and_doubt(path)[1]


@pytest.mark.parametrize(
    "time_of",
    [
        lambda t: 33 * t if t < 30 else 990 + 42 * (t - 30),  # another rate from there on
        lambda t: 40 * t + (0, 25, -12, 18, 30, -8, 5)[t % 7],  # at no rate
        lambda t: int(7 * t**1.5),  # slower and slower
    ],
)
def test_a_variable_rate_is_said_and_is_no_gap(
    tmp_path: Path, time_of: Callable[[int], int]
) -> None:
    video = Video(str(at_times(tmp_path / "v.mkv", time_of)))
    assert shown(video) == {t: t for t in range(N)}
    assert "no steady rate" in video.doubt


def test_frames_that_come_now_early_now_late_are_not_missing() -> None:
    """20 ms early and then 20 ms late again: 60 ms between two frames, but none is missing."""
    times = FrameTimes(25)
    assert times.look_ahead([40.0 * t for t in range(100)]) == ""
    early = [40 * t - 20 * (t % 10 == 9) for t in range(1, 200)]
    assert [times.add(t) for t in early] == list(range(1, 200))


def test_the_rate_of_most_frames_is_believed_where_a_file_claims_its_average() -> None:
    """60 frames at 25 frames/s, and a pause of 10 s: 4.84 on average; a clock of 1000 ticks."""
    pause = [40.0 * (t + 250 * (t > 30)) for t in range(60)]
    for claimed in (60 / 12.4, 1000):
        times = FrameTimes(claimed)
        assert "ms: 25 frames/s are believed" in times.look_ahead(pause)
        assert [times.add(t) for t in pause][-1] == 309
        assert times.doubt() == ""


def test_times_that_go_back_are_said_and_frames_counted_on() -> None:
    """As where two recordings were joined."""
    times = FrameTimes(25)
    times.look_ahead([40.0 * t for t in range(60)])
    assert [times.add(40.0 * (t % 50)) for t in range(100)] == list(range(100))
    assert "no steady rate" in times.doubt()


def test_a_day_from_one_frame_to_the_next_is_not_believed() -> None:
    times = FrameTimes(25)
    times.look_ahead([40.0 * t for t in range(60)])
    assert [times.add(t) for t in (0, 40, 1e9, 1e9 + 40)] == [0, 1, 2, 3]
    assert times.doubt()


@pytest.mark.parametrize("rate", [30_000 / 1001, 300.0, 1000.0, 2000.0, 20_000 / 3])
@pytest.mark.parametrize("rounded_ms", [1.0, 0.001])
def test_rounded_times_are_no_gaps(rate: float, rounded_ms: float) -> None:
    times = FrameTimes(rate, rounded_ms=rounded_ms)
    shown_at = [rounded_ms * round(1000 * t / rate / rounded_ms) for t in range(5000)]
    times.look_ahead(shown_at[:300])
    assert [times.add(t) for t in shown_at] == list(range(5000))
    assert times.doubt() == ""


@pytest.mark.parametrize(("name", "fourcc"), [("v.mkv", "mp4v"), ("v.webm", "VP80")])
def test_a_file_that_is_cut_off_is_said_where_it_claims_its_size(
    tmp_path: Path, name: str, fourcc: str
) -> None:
    path = tmp_path / name
    data = film(path, fourcc)
    path.write_bytes(data[: len(data) * 2 // 3])
    assert "it is cut off" in Video(str(path)).doubt


@pytest.mark.parametrize(("name", "fourcc"), [("v.ts", "MPG2"), ("v.mpg", "MPG2")])
def test_a_stream_that_begins_within_a_packet_is_said(
    tmp_path: Path, name: str, fourcc: str
) -> None:
    path = tmp_path / name
    data = film(path, fourcc)
    assert doubt_of_beginning(path) == ""
    path.write_bytes(data[1000:])
    assert "is damaged where it begins" in doubt_of_beginning(path)
