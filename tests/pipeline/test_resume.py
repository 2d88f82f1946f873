"""Runs that are killed at any moment end as if nothing had happened, once they are resumed."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.detections import Detections
from droptrack.data.video import Video
from droptrack.errors import DroptrackError
from droptrack.pipeline.detection_log import NAME, DetectionLog

ROOT = Path(__file__).parents[2]
OPTIONS = ("--size", "480x256", "--backend", "opencv")


def track(video: Path, out: Path, *options: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["track", str(video), "--out", str(out), *OPTIONS, *options])
    assert "Traceback" not in done.output
    return done.exit_code, done.stderr


def rows(folder: Path) -> str:
    return (folder / "trajectories.csv").read_text()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs a system with signals")
def test_a_run_killed_at_any_moment_is_resumed_to_the_same_rows(sine: Path, tmp_path: Path) -> None:
    video, killed = sine / "video.avi", tmp_path / "killed"
    assert track(video, tmp_path / "whole")[0] == 0
    command = [sys.executable, "-m", "droptrack", "track", str(video), "--out", str(killed)]
    for n_bytes in (1, 9_000):
        process = subprocess.Popen(
            [*command, *OPTIONS, "--resume"], cwd=ROOT, stderr=subprocess.DEVNULL
        )
        log = killed / NAME
        for _ in range(6000):
            if process.poll() is not None or (log.exists() and log.stat().st_size > n_bytes):
                break
            time.sleep(0.01)
        process.kill()
        process.wait()
    assert log.exists()
    code, said = track(video, killed, "--resume")
    assert code == 0, said
    assert rows(killed) == rows(tmp_path / "whole")
    assert len(list(Video(str(killed / "tracked.mp4")))) == 40
    assert not log.exists()
    code, said = track(video, killed, "--resume")
    assert code == 1
    assert "its results are complete" in said


def test_an_interrupted_run_is_resumed_by_the_same_command_only(
    sine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from droptrack.pipeline import loop

    add, calls = loop.FrameTracker.add, []

    def interrupted(*arguments: object) -> None:
        calls.append(1)
        if len(calls) == 9:
            raise KeyboardInterrupt
        add(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(loop.FrameTracker, "add", interrupted)
    video, out = sine / "video.avi", tmp_path / "out"
    assert track(video, out, "--no-video")[0] == 1
    code, said = track(video, out, "--no-video", "--resume", "--score", "0.5")
    assert code == 1
    assert "cannot be resumed: score was 0.4, and is 0.5 now" in said
    code, said = track(video, out, "--no-video", "--resume")
    assert code == 0, said
    assert re.search(r"resumed after (9|1\d) frames", said)
    assert track(video, tmp_path / "whole", "--no-video")[0] == 0
    assert rows(out) == rows(tmp_path / "whole")


def found(n: int) -> Detections:
    rng = np.random.default_rng(n)
    return Detections(rng.random((n, 4)) * 1000 + 1e-3, rng.random(n), np.arange(n))


@pytest.mark.parametrize("cut", range(1, 300, 23))
def test_a_log_cut_anywhere_keeps_its_whole_lines_exactly(tmp_path: Path, cut: int) -> None:
    made = {"score": 0.4}
    with DetectionLog(tmp_path, made, resume=False) as log:
        for number in range(5):
            log.add(number, found(number % 3))
    path = tmp_path / NAME
    os.truncate(path, path.stat().st_size - min(cut, path.stat().st_size))
    with DetectionLog(tmp_path, made, resume=True) as log:
        n = log.n_frames
        for number in range(5):
            known = log.find([number])
            assert (known is not None) == (number < n)
            log.add(number, found(number % 3))
    with DetectionLog(tmp_path, made, resume=True) as log:
        again = log.find(range(5))
    assert again is not None
    for number, one in enumerate(again):
        expected = found(number % 3)
        np.testing.assert_array_equal(one.boxes, expected.boxes)
        np.testing.assert_array_equal(one.scores, expected.scores)
        np.testing.assert_array_equal(one.class_ids, expected.class_ids)


def test_a_log_of_other_settings_is_refused(tmp_path: Path) -> None:
    with DetectionLog(tmp_path, {"score": 0.4}, resume=False) as log:
        log.add(0, found(2))
    with pytest.raises(DroptrackError, match=r"score was 0\.4, and is 0\.5 now"):
        DetectionLog(tmp_path, {"score": 0.5}, resume=True)
