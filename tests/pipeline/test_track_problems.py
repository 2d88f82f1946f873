"""What a run that is ended, or asked for the impossible, says and leaves."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.frames import Frame
from droptrack.data.trajectories import read_trajectories
from droptrack.data.video import Video
from droptrack.detection.engines.opencv_dnn import has_cuda
from droptrack.errors import InterruptedRunError
from droptrack.measurement.droplets import Measured, measure_droplets
from droptrack.network.bundled import BUNDLED, BUNDLED_WEIGHTS
from droptrack.pipeline import loop as pipeline
from droptrack.pipeline.config import TrackingConfig
from droptrack.pipeline.run import run

runner = CliRunner()


from tests.pipeline.commands import fails, track


def test_what_the_user_can_mend_is_said_in_one_line(sine: Path, tmp_path: Path) -> None:
    video, out = str(sine / "video.avi"), str(tmp_path / "out")
    cut = tmp_path / "yolov3-tiny.weights"
    cut.write_bytes(BUNDLED_WEIGHTS.read_bytes()[:1000])
    assert "ends after 245 of" in fails("track", video, "--weights", str(cut), "--out", out)
    assert "no such file" in fails("track", video, "--weights", "yolov3.weights", "--out", out)
    full = str(BUNDLED / "yolov3.cfg")
    assert "does not fit" in fails("track", video, "--cfg", full, "--out", out)
    assert "no such video" in fails("track", str(tmp_path / "none.avi"), "--out", out)
    if not has_cuda():
        assert "CUDA" in fails("track", video, "--backend", "opencv-cuda", "--out", out)
    assert "nearest is 96" in fails("track", video, "--size", "100x64", "--out", out)
    assert "such as 960x480" in fails("track", video, "--size", "big", "--out", out)
    int8 = ("--backend", "opencv", "--precision", "int8")
    assert "opencv computes in fp32" in fails("track", video, *int8, "--out", out)
    (tmp_path / "file").touch()
    assert "file" in fails("track", video, "--out", str(tmp_path / "file" / "out"))
    assert "no such file" in fails("evaluate", str(tmp_path / "a.csv"), str(tmp_path / "b.csv"))
    assert not Path(out).exists()


def test_results_never_overwrite_the_video_they_come_from(sine: Path, tmp_path: Path) -> None:
    video = tmp_path / "tracked.mp4"
    shutil.copy(sine / "video.avi", video)
    before = video.read_bytes()
    assert "overwritten" in fails("track", str(video), "--out", str(tmp_path))
    assert video.read_bytes() == before


def test_what_was_tracked_before_a_problem_is_kept(sine: Path, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for t, frame in zip(range(6), Video(str(sine / "video.avi")), strict=False):
        cv2.imwrite(str(folder / f"{t}.png"), frame)
    cv2.imwrite(str(folder / "6.png"), np.zeros((50, 50), np.uint8))
    message = fails("track", str(folder), "--out", str(tmp_path / "out"))
    assert "frame 6 is 50 x 50 px" in message
    rows, _ = read_trajectories(tmp_path / "out" / "trajectories.csv")
    assert np.unique(rows.frame).tolist() == list(range(6))
    assert len(list(Video(str(tmp_path / "out" / "tracked.mp4")))) == 6


def test_ctrl_c_keeps_what_was_tracked(
    sine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def interrupted(frame: Frame, boxes: np.ndarray, **options: Any) -> Measured:
        calls.append(1)
        if len(calls) > 5:
            raise KeyboardInterrupt
        return measure_droplets(frame, boxes, **options)

    monkeypatch.setattr(pipeline, "measure_droplets", interrupted)
    message = fails("track", str(sine / "video.avi"), "--out", str(tmp_path))
    assert "interrupted after 5 frames" in message
    rows, _ = read_trajectories(tmp_path / "trajectories.csv")
    assert np.unique(rows.frame).tolist() == list(range(5))


def test_an_end_that_comes_while_progress_is_shown_keeps_what_was_tracked(
    sine: Path, tmp_path: Path
) -> None:
    """Then nothing of the loop is running; it still has frames of the video to write."""

    def interrupted(n: int, _: int) -> None:
        if n == 20:
            raise KeyboardInterrupt

    config = TrackingConfig(video=str(sine / "video.avi"), out=tmp_path / "out")
    done = run(config, progress=interrupted)
    n = int(read_trajectories(tmp_path / "out" / "trajectories.csv")[0].frame.max()) + 1
    assert n >= 20
    assert isinstance(done.problem, InterruptedRunError)
    assert f"interrupted after {n} frames" in str(done.problem)
    assert len(list(Video(str(tmp_path / "out" / "tracked.mp4")))) == n


def test_frames_that_cannot_be_decoded_are_counted_and_said(sine: Path, tmp_path: Path) -> None:
    data = (sine / "video.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
    out = tmp_path / "out"
    output = track(tmp_path / "cut.avi", out, "--backend", "opencv", "--size", "480x256")
    summary = json.loads((out / "report.json").read_text())["summary"]
    assert 10 < summary["n_frames"] < 30
    assert summary["n_frames_missing"] == 40 - summary["n_frames"]
    said = f"{summary['n_frames_missing']} of the 40 frames it claims could not be decoded"
    assert said in output


def test_frames_that_were_never_recorded_are_counted_and_said(tmp_path: Path) -> None:
    """Frames 4 to 6 of 12, as their times show: by `track` and by `detect`."""
    video = Path(__file__).parents[1] / "reference" / "videos" / "uneven.mkv"
    options = ("--backend", "opencv", "--size", "64x32")
    output = track(video, tmp_path / "tracks", *options)
    assert output.count("3 frames are missing, by the times of those around them") == 1
    assert "could not be decoded" not in output
    summary = json.loads((tmp_path / "tracks" / "report.json").read_text())["summary"]
    assert (summary["n_frames"], summary["n_frames_missing"]) == (9, 3)
    done = runner.invoke(
        app, ["detect", str(video), "--out", str(tmp_path / "detections"), *options]
    )
    assert done.exit_code == 0
    assert done.output.count("3 frames are missing, by the times of those around them") == 1


def test_a_full_disk_is_said_in_one_line(sine: Path, tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full, which only Linux has")
    (tmp_path / "trajectories.csv").symlink_to("/dev/full")
    message = fails("track", str(sine / "video.avi"), "--out", str(tmp_path), "--no-video")
    assert "No space left" in message


def test_results_of_another_video_are_never_overwritten(sine: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shutil.copy(sine / "video.avi", tmp_path / name / "video.avi")
    out, short = str(tmp_path / "out"), ("--max-frames", "3", "--no-video")
    track(tmp_path / "a" / "video.avi", tmp_path / "out", *short)
    before = (tmp_path / "out" / "trajectories.csv").read_bytes()
    other = ("track", str(tmp_path / "b" / "video.avi"), "--out", out, *short)
    for options in ((), ("--overwrite",)):
        assert f"it has results of {tmp_path / 'a' / 'video.avi'}, 1200 x 600 px" in fails(
            *other, *options
        )
    same = ("track", str(tmp_path / "a" / "video.avi"), "--out", out, *short)
    assert "--overwrite replaces them" in fails(*same)
    assert (tmp_path / "out" / "trajectories.csv").read_bytes() == before
    track(tmp_path / "a" / "video.avi", tmp_path / "out", *short, "--overwrite")


@pytest.mark.parametrize(
    ("video", "folder"),
    [
        ("exp_1.5mm.avi", "exp_1.5mm"),
        ("exp_1.5mm", "exp_1.5mm"),
        ("run.v2/stack.ome.tif", "stack"),
        ("rtsp://camera:554/live.sdp", "camera_554_live.sdp"),
        ("a_*.png", "a__"),
        ("0", "0"),
        ("..", "parent.dir"),
        (".", "this.one"),
    ],
)
def test_results_have_the_name_of_what_they_come_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, video: str, folder: str
) -> None:
    here = tmp_path / "parent.dir" / "this.one"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    assert TrackingConfig(video=video).folder == Path("tracks") / folder


def test_options_that_would_change_nothing_are_refused(sine: Path, tmp_path: Path) -> None:
    boxes = tmp_path / "det.txt"
    boxes.write_text("".join(f"{t},-1,{t},5,20,20,{s}\n" for t in range(1, 9) for s in (0.9, 0.2)))
    base = ("track", "--detections", str(boxes), "--out", str(tmp_path / "out"))
    for option in (
        *(("--weights", "a.weights"), ("--cfg", "a.cfg"), ("--max-iou", "0.3"), ("--dark",)),
        *(("--backend", "opencv"), ("--precision", "fp32"), ("--size", "64x64"), ("--scale", "1")),
        *(("--diameter", "9"), ("--live",), ("--batch", "2"), ("--no-video",), ("--renumber",)),
        *(("--levels", "0", "9"), ("--channel", "1"), ("--nn-budget", "9")),
    ):
        assert f"droptrack: {option[0]} is of" in fails(*base, *option)
    assert not (tmp_path / "out").exists()
    truth = ("evaluate", str(sine / "truth.csv"), str(sine / "truth.csv"))
    for option in (("--weights", "a"), ("--cfg", "a"), ("--images", "9"), ("--dark",)):
        assert f"droptrack: {option[0]} is of networks" in fails(*truth, *option)
    video = ("track", str(sine / "video.avi"), "--out", str(tmp_path / "out"))
    assert "--max-iou-distance is of" in fails(*video, "--max-iou-distance", "0.5")
    assert "--appearance-size is of" in fails(*video, "--appearance-size", "8", "8")
    deep = ("--tracker", "deepsort", "--expect-velocity", "1,1")
    assert "--expect-velocity is of" in fails(*video, *deep)
    assert not (tmp_path / "out").exists()


def test_score_and_number_of_frames_are_applied_to_detections(tmp_path: Path) -> None:
    boxes = tmp_path / "det.txt"
    boxes.write_text(
        "".join(
            f"{t},-1,{x},5,20,20,{s}\n" for t in range(1, 30) for x, s in ((9, 0.9), (300, 0.2))
        )
    )
    for out, options, expected in (
        ("all", (), (29, 2)),
        ("some", ("--score", "0.5", "--max-frames", "20"), (20, 1)),
    ):
        arguments = ["track", "--detections", str(boxes), "--out", str(tmp_path / out), *options]
        assert runner.invoke(app, arguments).exit_code == 0
        rows, _ = read_trajectories(tmp_path / out / "trajectories.csv")
        assert (rows.frame.max() + 1, len(np.unique(rows.track_id))) == expected
