"""What every command does alike: how it ends, and what it prints where."""

import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer

from droptrack.__main__ import COMMANDS
from droptrack.data.trajectories import read_trajectories
from droptrack.data.video import Video

ROOT = Path(__file__).parents[1]


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "droptrack", *arguments],
        capture_output=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, **environment},
    )


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs a system with signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_what_a_cluster_or_a_closing_terminal_sends_loses_nothing(
    sine: Path, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "out"
    many = tmp_path / "frames"
    many.mkdir()
    first = next(iter(Video(str(sine / "video.avi"))))
    cv2.imwrite(str(many / "0.png"), first[..., 0])
    for t in range(1, 3000):
        (many / f"{t}.png").symlink_to(many / "0.png")
    command = [sys.executable, "-m", "droptrack", "track", str(many), "--out", str(out)]
    size = ("--size", "480x256", "--backend", "opencv")
    process = subprocess.Popen([*command, *size], cwd=ROOT, stderr=subprocess.PIPE)
    table = out / "trajectories.csv"
    for _ in range(1200):
        if table.exists() and table.stat().st_size > 20_000:
            break
        time.sleep(0.1)
    process.send_signal(getattr(signal, name))
    process.send_signal(getattr(signal, name))
    said = process.communicate(timeout=120)[1].decode()
    assert process.returncode == 1
    rows, _ = read_trajectories(table)
    n = int(rows.frame.max()) + 1
    assert 10 < n < 3000
    assert len(list(Video(str(out / "tracked.mp4")))) == n
    assert (out / "report.json").stat().st_size > 100
    assert cv2.imread(str(out / "paths.png")) is not None
    if name == "SIGTERM":  # after the other there is nobody who reads it
        assert f"interrupted after {n} frames" in said


@pytest.mark.parametrize("backend", ["inline", "module://no_such_package.backend"])
def test_a_notebooks_way_to_draw_is_no_problem(tmp_path: Path, backend: str) -> None:
    det = tmp_path / "det.txt"
    det.write_text("".join(f"{t},-1,{t},9,8,8,1\n" for t in range(1, 20)))
    done = run(
        "track", "--detections", str(det), "--out", str(tmp_path / "out"), MPLBACKEND=backend
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "paths.png").exists()


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_output_that_lacks_characters_is_no_problem(tmp_path: Path, encoding: str) -> None:
    det = tmp_path / "tröpfchen_µ_液滴.txt"
    det.write_text("".join(f"{t},-1,{t},9,8,8,1\n" for t in range(1, 20)))
    done = run(
        *("track", "--detections", str(det), "--out", str(tmp_path / "液滴")),
        PYTHONIOENCODING=encoding,
    )
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr


def test_names_that_are_no_numbers_of_cameras_are_refused() -> None:
    for name in ("²", "٣"):
        done = run("track", name)
        assert done.returncode == 1
        assert b"no such video, image folder or camera" in done.stderr


def latin_1(folder: Path, name: str) -> Path:
    """A name as older systems wrote it, which is no UTF-8."""
    path = Path(os.fsdecode(bytes(folder) + b"/" + name.encode("latin-1")))
    try:
        path.touch()
    except OSError:
        pytest.skip("this file system has names in UTF-8 only")
    path.unlink()
    return path


def test_names_that_are_no_utf8_are_read_and_written(sine: Path, tmp_path: Path) -> None:
    """OpenCV crashes at such a name."""
    folder = latin_1(tmp_path, "tröpfchen")
    folder.mkdir()
    video = latin_1(folder, "übung:1.avi")
    video.write_bytes((sine / "video.avi").read_bytes())
    options = ("--max-frames", "3", "--size", "480x256", "--backend", "opencv")
    done = run("track", str(video), "--out", str(folder / "a:b"), *options)
    assert done.returncode == 0, done.stderr
    assert len(list(Video(str(folder / "a:b" / "tracked.mp4")))) == 3
    rows, about = read_trajectories(folder / "a:b" / "trajectories.csv")
    assert len(np.unique(rows.frame)) == 3
    assert "bung:1.avi, 1200 x 600 px" in about["video"]
    again = run("track", str(video), "--out", str(folder / "a:b"), *options)
    assert b"--overwrite replaces them" in again.stderr


def test_the_help_says_of_each_command_what_its_own_help_says() -> None:
    for name, line in COMMANDS.items():
        command = typer.main.get_command(import_module(f"droptrack.{name}").app)
        assert " ".join((command.help or "").split("\n\n")[0].split()) == line


def imported_by(*words: str) -> set[str]:
    """The packages that a command imports."""
    script = (
        "import atexit, runpy, sys\n"
        f"sys.argv = ['droptrack', *{list(words)!r}]\n"
        "atexit.register(lambda: print('\\nimported', *sys.modules))\n"
        "runpy.run_module('droptrack', run_name='__main__')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, check=False, cwd=ROOT, text=True
    )
    last = done.stdout.splitlines()[-1].split()
    assert last[0] == "imported", done.stderr
    return {name.partition(".")[0] for name in last[1:]}


def test_nothing_is_imported_before_it_is_needed() -> None:
    assert not imported_by("--help") & {"numpy", "cv2", "scipy", "matplotlib"}
    heavy = {"scipy", "numba", "openvino", "onnx", "torch", "matplotlib", "pandas", "dask"}
    for words in (("track", "--help"), ("track", "no-such-video.avi"), ("batch", "--help")):
        assert not imported_by(*words) & heavy, words
