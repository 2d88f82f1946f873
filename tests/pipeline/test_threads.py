"""Stages that overlap: order, bounds, dropped frames, and problems that surface."""

import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from droptrack.data.arrays import Float32s
from droptrack.data.frames import Frame
from droptrack.data.stage_times import StageTimes
from droptrack.data.trajectories import Trajectories, TrajectoryWriter, read_trajectories
from droptrack.data.video import Video, VideoInfo, VideoWriter
from droptrack.detection.detector import Detector
from droptrack.detection.engines.in_thread import InThread
from droptrack.errors import DroptrackError
from droptrack.pipeline.loop import track_frames
from droptrack.pipeline.results import FURTHER_COLUMNS, Results
from droptrack.pipeline.threads import READ_AHEAD, AnnotatedVideo, FrameReader, side_by_side
from droptrack.tracking.appearance import describe
from droptrack.tracking.deepsort.tracker import DeepSortParameters, DeepSortTracker


def frames(n: int, made: list[int], pause: float = 0.0) -> Iterator[tuple[int, Frame]]:
    """Grey level t is frame t; `made` counts."""
    for t in range(n):
        time.sleep(pause)
        made.append(t)
        yield t, np.full((64, 96, 3), t, np.uint8)


class GreyLevelEngine(InThread):
    """Sees one droplet, at as many tenths of a pixel from the middle as the frame is bright.

    Frames take times at random, or as long as `seconds` says.
    """

    name = "test"
    opencv_threads = 1

    def __init__(self, parallel: int, seconds: float | None = None) -> None:
        self.parallel, self._seconds = parallel, seconds
        self._rng = np.random.default_rng(0)

    def prepare(self, frames: Sequence[Frame]) -> list[int]:
        return [int(frame[0, 0, 0]) for frame in frames]

    def run(self, prepared: list[int]) -> list[int]:
        time.sleep(self._rng.uniform(0, 0.01) if self._seconds is None else self._seconds)
        return prepared

    def rows(self, outputs: list[int]) -> list[Float32s]:
        x = [0.3 + 0.1 * level / 96 for level in outputs]
        return [np.array([[at, 0.5, 0.2, 0.3, 1, 0.9]], np.float32) for at in x]


def track(
    engine: GreyLevelEngine, source: Iterator[tuple[int, Frame]], path: Path, **options: bool | int
) -> tuple[Trajectories, Results]:
    detector = Detector(engine, 0.5, 0.5)
    tracker = DeepSortTracker(DeepSortParameters())
    with TrajectoryWriter(path, {}, FURTHER_COLUMNS) as rows:
        results = Results(rows)
        for _ in track_frames(source, detector, tracker, describe, results, **options):  # type: ignore[arg-type]
            pass
    return read_trajectories(path)[0], results


@pytest.mark.parametrize(("parallel", "batch"), [(1, 1), (3, 1), (2, 4)])
def test_frames_keep_their_order_however_long_their_networks_take(
    parallel: int, batch: int, tmp_path: Path
) -> None:
    rows, results = track(
        GreyLevelEngine(parallel), frames(50, []), tmp_path / "t.csv", batch=batch
    )
    assert rows.frame.tolist() == list(range(50))
    np.testing.assert_allclose(rows.boxes[:, 0], 28.8 + 0.1 * np.arange(50), atol=1e-3)
    assert results.n_frames == 50
    assert results.times.seconds["network"] > 0


def test_droplets_move_on_in_frames_that_could_not_be_decoded(tmp_path: Path) -> None:
    class FastEngine(GreyLevelEngine):
        def rows(self, outputs: list[int]) -> list[Float32s]:
            """A droplet of 0.1 of the width that moves by half of that in a frame."""
            return [np.array([[0.05 * t, 0.5, 0.1, 0.2, 1, 0.9]], np.float32) for t in outputs]

    damaged = {10, 14, 15}
    source = ((t, frame) for t, frame in frames(20, []) if t not in damaged)
    rows, results = track(FastEngine(1), source, tmp_path / "t.csv")
    assert results.n_frames == 17
    assert np.unique(rows.track_id).tolist() == [1]
    assert rows.frame.tolist() == list(range(20))
    assert set(rows.frame[~rows.observed].tolist()) == damaged
    np.testing.assert_allclose(rows.boxes[:, 0], 0.05 * 96 * np.arange(20), atol=1e-3)


def test_decoding_waits_for_those_that_use_the_frames() -> None:
    made: list[int] = []
    with FrameReader(frames(50, made), StageTimes()) as reader:
        for taken, item in enumerate(reader, start=1):
            time.sleep(0.002)
            assert item.number == taken - 1
            assert len(made) <= taken + READ_AHEAD + 1  # one more waits for room
    assert len(made) == 50


def test_a_live_source_gives_its_newest_frame_and_counts_the_others(tmp_path: Path) -> None:
    made: list[int] = []
    source = frames(60, made, pause=0.004)
    rows, results = track(GreyLevelEngine(1, 0.02), source, tmp_path / "t.csv", live=True)
    assert len(made) == 60
    assert results.n_frames + results.n_dropped == 60
    assert 5 < results.n_frames < 30
    seen = rows.frame[rows.observed]
    np.testing.assert_allclose(rows.boxes[rows.observed, 0], 28.8 + 0.1 * seen, atol=1e-3)
    assert results.slowest < 1.0


def test_a_problem_while_decoding_comes_after_the_frames_before_it(tmp_path: Path) -> None:
    def broken() -> Iterator[tuple[int, Frame]]:
        yield from frames(7, [])
        raise DroptrackError("the cable is out")

    path = tmp_path / "t.csv"
    with pytest.raises(DroptrackError, match="cable"):
        track(GreyLevelEngine(2), broken(), path)
    assert read_trajectories(path)[0].frame.tolist() == list(range(7))


def test_a_problem_in_the_network_is_raised_and_what_was_found_before_is_kept(
    tmp_path: Path,
) -> None:
    class Breaking(GreyLevelEngine):
        def run(self, prepared: list[int]) -> list[int]:
            if prepared[0] == 5:
                raise RuntimeError("out of memory")
            return super().run(prepared)

    path = tmp_path / "t.csv"
    with pytest.raises(DroptrackError, match="test: the network failed: out of memory"):
        track(Breaking(2), frames(20, []), path)
    assert read_trajectories(path)[0].frame.tolist() == list(range(5))


def test_a_reader_that_is_left_early_stops_decoding() -> None:
    made: list[int] = []
    with FrameReader(frames(10_000, made), StageTimes()) as reader:
        next(iter(reader))
    assert len(made) < 10
    assert "decode" not in {thread.name for thread in threading.enumerate()}


def test_an_annotated_video_has_every_frame_in_order(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    video = AnnotatedVideo(VideoWriter(path, VideoInfo(96, 64, 25, 0), "MJPG"), StageTimes())
    for number, frame in frames(20, []):
        video.write(number, frame * 10, [])
    video.close()
    levels = [round(int(frame[5, 5, 0]) / 10) for frame in Video(str(path))]
    assert levels == list(range(20))


def test_a_problem_while_writing_a_video_surfaces(tmp_path: Path) -> None:
    writer = VideoWriter(tmp_path / "v.avi", VideoInfo(10, 10, 25, 0), "MJPG")
    video = AnnotatedVideo(writer, StageTimes())

    for number, frame in frames(3 * READ_AHEAD, []):
        video.write(number, frame, [])
    with pytest.raises(ValueError, match="in a video of"):
        video.close()


def test_settings_of_the_process_are_put_back() -> None:
    before = sys.getswitchinterval(), cv2.getNumThreads()
    with side_by_side(1):
        assert cv2.getNumThreads() == 1
        assert sys.getswitchinterval() < before[0]
    assert (sys.getswitchinterval(), cv2.getNumThreads()) == before
    with side_by_side(sys.maxsize):
        assert cv2.getNumThreads() == before[1]
