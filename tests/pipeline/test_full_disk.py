"""A disk without room: one line says it, and what was written before stays whole."""

import errno
import json
import os
from dataclasses import replace
from io import FileIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.files import write_text
from droptrack.data.trajectories import Trajectories, TrajectoryWriter, read_trajectories
from droptrack.data.video import Video, VideoInfo, VideoWriter
from droptrack.errors import DroptrackError

pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has /dev/full")
N_FRAMES = 5
QUICK = ("--size", "96x64", "--backend", "opencv")


@pytest.fixture
def disc(tmp_path: Path) -> Path:
    """A video of one disc."""
    path = tmp_path / "v.avi"
    with VideoWriter(path, VideoInfo(96, 64, 25, N_FRAMES), "MJPG") as video:
        for t in range(N_FRAMES):
            image = np.zeros((64, 96, 3), np.uint8)
            cv2.circle(image, (30 + 2 * t, 32), 12, (255, 255, 255), -1, cv2.LINE_AA)
            video.write(image)
    return path


def said(*arguments: str) -> str:
    """What a command that ends with 1 says of it, in one line."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1, result.output
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("droptrack: ")]
    assert result.stderr.rstrip().endswith(line)
    return line


@pytest.mark.parametrize(
    ("file", "kept"),
    [
        ("trajectories.csv", ()),
        ("detections.part", ()),
        ("tracked.mp4", ("trajectories.csv", "report.json", "paths.png")),
        ("report.partial.json", ("trajectories.csv", "tracked.mp4")),
        ("paths.partial.png", ("trajectories.csv", "tracked.mp4", "report.json")),
    ],
)
def test_each_file_of_a_run_may_have_no_room(
    disc: Path, tmp_path: Path, file: str, kept: tuple[str, ...]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / file).symlink_to("/dev/full")
    line = said("track", str(disc), "--out", str(out), *QUICK)
    assert file.replace(".partial", "") in line
    assert "No space left" in line or "disk full?" in line
    for name in kept:
        assert is_whole(out / name), name


def is_whole(path: Path) -> bool:
    """Whether a file of a run can be read."""
    if path.suffix == ".json":
        return "summary" in json.loads(path.read_text())
    if path.suffix == ".csv":
        return read_trajectories(path)[1]["made by"].startswith("droptrack")
    if path.suffix == ".png":
        return cv2.imread(str(path)) is not None
    return len(list(Video(str(path)))) == N_FRAMES


class Full(FileIO):
    """A file on a disk that has room for so many bytes."""

    room = 0

    def write(self, data: Any) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        some = memoryview(data)[: self.room]
        self.room -= len(some)
        return super().write(some)


@pytest.mark.parametrize("room", [0, 1, 100])
def test_a_table_ends_with_a_whole_row(tmp_path: Path, room: int) -> None:
    ones = np.ones(1)
    rows = Trajectories(
        frame=np.array([0]), track_id=np.array([1]), x=ones, y=ones, boxes=np.ones((1, 4)),
        scores=ones, observed=np.ones(1, bool),
    )  # fmt: skip
    path = tmp_path / "t.csv"
    writer = TrajectoryWriter(path, {"made by": "droptrack"})
    writer.write(rows)
    whole = path.read_bytes()
    full = Full(path, "r+b")
    full.seek(0, os.SEEK_END)
    full.room = room
    writer._file.close()
    writer._file = full
    n_fit = room // len(whole.splitlines()[-1] + b"\n")
    for frame in range(1, n_fit + 1):
        writer.write(replace(rows, frame=np.array([frame])))
    with pytest.raises(DroptrackError, match=r"t\.csv: cannot be written: No space left"):
        writer.write(replace(rows, frame=np.array([9])))
    writer.close()
    n_rows = len(read_trajectories(path)[0])
    assert n_rows == 1 + n_fit
    assert path.read_bytes().startswith(whole)


def test_a_file_that_is_replaced_stays_what_it_was(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text("{}")
    (tmp_path / "report.partial.json").symlink_to("/dev/full")
    with pytest.raises(DroptrackError, match=r"report\.json: cannot be written: No space left"):
        write_text(path, "[]")
    assert path.read_text() == "{}"
    assert os.listdir(tmp_path) == ["report.json"]


def test_images_that_are_detected_may_have_no_room(disc: Path, tmp_path: Path) -> None:
    for name in ("detections.partial.csv", "report.partial.json", "annotated/v_000000.partial.jpg"):
        out = tmp_path / name.replace("/", "-")
        (out / name).parent.mkdir(parents=True)
        (out / name).symlink_to("/dev/full")
        line = said("detect", str(disc), "--out", str(out), *QUICK)
        assert name.replace(".partial", "") in line
        assert not (out / "detections.csv").exists() or "report" in name


def test_a_pipe_that_nobody_reads_is_said(disc: Path, tmp_path: Path) -> None:
    """``droptrack track ... | head``: what is left is the run's files."""
    reading, writing = os.pipe()
    os.close(reading)
    out = tmp_path / "out"
    out.mkdir()
    (out / "trajectories.csv").symlink_to(f"/dev/fd/{writing}")
    line = said("track", str(disc), "--out", str(out), "--no-video", *QUICK)
    os.close(writing)
    assert "trajectories.csv: cannot be written: Broken pipe" in line
