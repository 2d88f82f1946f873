"""What people bring that is no video of grey levels: said in one line, with the cure."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from droptrack.data.video import Video
from droptrack.errors import DroptrackError


def stack() -> NDArray[np.float32]:
    return np.random.default_rng(0).random((6, 20, 30)).astype(np.float32)


def said(path: Path) -> str:
    with pytest.raises(DroptrackError) as caught:
        Video(str(path))
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "wanted"),
    [
        ("v.h5", b"\x89HDF\r\n\x1a\n" + bytes(100), ".h5 is not read here"),
        ("v.zip", b"PK\3\4" + bytes(100), "unpack it first"),
        ("v.m4a", bytes(100), "it holds sound"),
        ("v.ser", b"LUCAM-RECORDER" + bytes(164), "save it as AVI"),
        ("v.dv", bytes(100), "bfconvert"),
        (
            "v.mp4",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
            "git lfs pull",
        ),
        ("v.avi", b"\n<!DOCTYPE html><html><body>404</body></html>", "is a web page"),
        ("v.mkv", b"frame,x,y\n" * 50, "is no video that OpenCV or FFmpeg can read"),
    ],
)
def test_what_is_no_video_is_named(tmp_path: Path, name: str, content: bytes, wanted: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert wanted in said(tmp_path / name)


def test_ffmpegs_own_words_are_not_printed(tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    path.write_text("<html><body>404</body></html>")
    command = [sys.executable, "-m", "droptrack", "track", str(path), "--out", str(tmp_path / "o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1


def test_a_folder_of_videos_says_which_command_takes_them(tmp_path: Path) -> None:
    (tmp_path / "a.MP4").write_bytes(b"x")
    assert "droptrack batch" in said(tmp_path)


def test_complex_numbers_are_no_grey_levels(tmp_path: Path) -> None:
    path = tmp_path / "v.tif"
    tifffile.imwrite(path, stack().astype(np.complex64), photometric="minisblack")
    assert "complex64, not grey levels" in said(path)


def test_a_frame_without_a_value_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "v.tif"
    values = stack()
    values[2] = np.nan
    tifffile.imwrite(path, values, photometric="minisblack")
    assert [number for number, _ in Video(str(path)).numbered()] == [0, 1, 3, 4, 5]
    tifffile.imwrite(path, np.full_like(values, np.nan), photometric="minisblack")
    assert "has no finite value" in said(path)
