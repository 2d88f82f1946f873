"""Tracking a file of detections: no video, no network."""

import json
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.videos.motion_kinds import train
from data_gen.videos.motions import make
from droptrack.__main__ import app
from droptrack.data.detections import labels
from droptrack.data.mot_files import (
    BLOCK,
    MERGE_BLOCK,
    open_detections,
    read_frame_list,
    write_detections,
)
from droptrack.data.trajectories import TrajectoryWriter, read_trajectories
from droptrack.errors import DroptrackError
from droptrack.pipeline.config import DetectionsConfig
from droptrack.pipeline.from_detections import open_descriptors, run_detections
from droptrack.pipeline.notes import say_what_is_unsure
from droptrack.pipeline.results import FURTHER_COLUMNS, Results
from droptrack.tracking.recorder import Gap

TWO = [[20.0, 30, 10, 12], [60.0, 30, 14, 10]]


def file_of(folder: Path, text: str) -> Path:
    path = folder / "detections.txt"
    path.write_text(text)
    return path


def track(*options: str) -> str:
    result = CliRunner().invoke(app, ["track", *options])
    assert result.exit_code == 0, result.output
    return result.output


def fails(*options: str) -> str:
    result = CliRunner().invoke(app, ["track", *options])
    assert result.exit_code == 1, result.output
    return result.stderr.strip()


def test_a_file_reads_back_to_the_same_detections(tmp_path: Path) -> None:
    path = tmp_path / "d.txt"
    write_detections(path, [labels(TWO), labels([]), labels(TWO[:1])])
    file = open_detections(path)
    assert [found.boxes.tolist() for found, _ in file] == [TWO, [], TWO[:1]]
    assert [rows.tolist() for _, rows in file] == [[0, 1], [], [2]]
    assert (file.n_frames, file.n_rows, file.out_of_order) == (3, 3, 0)
    assert (file.right, file.bottom) == (67, 36)
    assert path.read_text().splitlines()[0] == (
        "1,-1,15.000000,24.000000,10.000000,12.000000,1.000000"
    )


def test_rows_in_any_order_more_columns_and_frames_that_skip(tmp_path: Path) -> None:
    path = file_of(tmp_path, "4 -1 0 0 8 8 0.5 -1 -1 -1\n\n1 -1 2 0 8 8 0.9 -1 -1 -1\n")
    file = open_detections(path)
    assert (file.n_frames, file.out_of_order) == (4, 2)
    frames, rows = zip(*file, strict=True)
    assert [len(found) for found in frames] == [1, 0, 0, 1]
    assert (frames[0].scores.tolist(), frames[0].boxes[0].tolist()) == ([0.9], [6, 4, 8, 8])
    assert [r.tolist() for r in rows] == [[1], [], [], [0]]


@pytest.mark.parametrize("shuffled", [False, True])
def test_blocks_leave_no_seams(tmp_path: Path, shuffled: bool) -> None:
    """Frames of 0 to 3,000 boxes that go on from block to block: the same as sorted by NumPy."""
    rng = np.random.default_rng(0)
    number = np.sort(rng.integers(1, 60, 2 * BLOCK + 10))
    number = np.concatenate([number, np.full(3000, 61)])
    if shuffled:
        number = rng.permutation(number)
    left = np.arange(len(number))
    path = file_of(
        tmp_path, "".join(f"{t},-1,{x},0,8,8,1\n" for t, x in zip(number, left, strict=True))
    )
    file = open_detections(path)
    assert bool(file.out_of_order) == shuffled
    assert (file.n_frames, file.n_rows, file.right) == (61, len(number), len(number) + 7)
    frames = list(file)
    assert len(frames) == 61
    assert max(len(found) for found, _ in frames) > MERGE_BLOCK
    for t, (found, rows) in enumerate(frames, 1):
        np.testing.assert_array_equal(rows, np.flatnonzero(number == t))
        np.testing.assert_array_equal(found.boxes[:, 0], rows + 4)


def test_rows_of_later_blocks_are_counted_from_the_start(tmp_path: Path) -> None:
    good = "1,-1,0,0,8,8,1\n" * (BLOCK + 4)
    for row, problem in (
        ("1,-1,0,0,8,nan,1", f"frame 1, row {BLOCK + 5}: boxes and scores should be finite"),
        ("1,-1,0,0,8", f"row {BLOCK + 5} should be the numbers frame,-1,left"),
    ):
        with pytest.raises(DroptrackError, match=problem):
            open_detections(file_of(tmp_path, f"{good}{row}\n"))


def test_memory_does_not_grow_with_the_number_of_frames(tmp_path: Path) -> None:
    """Five times the frames, in order and not: all rows of the longer file would be 11 MB."""
    peaks = []
    for n_frames, step in ((4_000, 1), (20_000, 1), (20_000, -1)):
        frames = range(1, n_frames + 1)[::step]
        text = "".join(f"{t},-1,{x},0,8,8,1\n" for t in frames for x in range(0, 100, 10))
        path = file_of(tmp_path, text)
        del text
        tracemalloc.start()
        n = sum(len(found) for found, _ in open_detections(path))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert n == 10 * n_frames
    assert max(peaks) < 1.4 * min(peaks)


def test_an_empty_file_has_no_frames(tmp_path: Path) -> None:
    assert list(open_detections(file_of(tmp_path, "\n"))) == []


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("2,-1,0,0,8,nan,1", "frame 2, row 2: boxes and scores should be finite"),
        ("2,-1,0,0,inf,8,1", "frame 2, row 2: boxes and scores should be finite"),
        ("3,-1,0,0,-8,8,1", "frame 3, row 2: boxes need a width and height above 0"),
        ("0,-1,0,0,8,8,1", "frame 0, row 2: a frame should be a whole number from 1"),
        ("1.5,-1,0,0,8,8,1", "frame 1.5, row 2: a frame should be a whole number"),
        ("99999999,-1,0,0,8,8,1", "row 2: a frame should be 10000000 or less"),
        ("1,-1,0,0,8,eight,1", "row 2 should be the numbers frame,-1,.*, not 1,-1,0,0,8,eight,1"),
        ("1,-1,0,0,8,8", "row 2 should be the numbers frame,-1,.*, not 1,-1,0,0,8,8"),
    ],
)
def test_what_cannot_be_a_box_is_refused_with_its_place(
    tmp_path: Path, row: str, problem: str
) -> None:
    path = file_of(tmp_path, f"1,-1,0,0,8,8,1\n{row}\n")
    with pytest.raises(DroptrackError, match=r"detections\.txt: .*" + problem):
        open_detections(path)


def test_too_few_columns_and_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match="row 1 should be the numbers frame,-1,left"):
        open_detections(file_of(tmp_path, "1,-1,0,0,8\n"))
    with pytest.raises(DroptrackError, match="no such file"):
        open_detections(tmp_path / "none.txt")
    with pytest.raises(DroptrackError, match="can be read twice"):
        open_detections(tmp_path)
    path = tmp_path / "latin.txt"
    path.write_bytes(b"1,-1,0,0,8,8,1\n\xe9\n")
    with pytest.raises(DroptrackError, match="cannot be read as text"):
        open_detections(path)


def moving(n_frames: int) -> list[list[list[float]]]:
    """Two droplets, one partly and at last wholly beyond the image's left edge."""
    return [
        [[30.0 + 2 * t, 40, 20, 20], [20.0 - 3 * t, 80 + 0.5 * t, 18, 22]] for t in range(n_frames)
    ]


def test_a_file_is_tracked_into_a_folder(tmp_path: Path) -> None:
    path, out = tmp_path / "d.txt", tmp_path / "out"
    write_detections(path, [labels(boxes) for boxes in moving(20)])
    output = track("--detections", str(path), "--out", str(out))
    assert "results in" in output
    rows, about = read_trajectories(out / "trajectories.csv")
    assert about["detections"].endswith("d.txt, 20 frames")
    for droplet in (1, 2):
        mine = rows[rows.track_id == droplet]
        expected = [boxes[droplet - 1][:2] for boxes in moving(20)]
        np.testing.assert_allclose(np.column_stack([mine.x, mine.y]), expected)
    table = np.loadtxt(out / "trajectories.csv", delimiter=",", skiprows=4)
    header = (out / "trajectories.csv").read_text().splitlines()[3].split(",")
    velocity = table[:, header.index("velocity_x")].reshape(20, 2)
    np.testing.assert_allclose(velocity, np.tile([2.0, -3.0], (20, 1)), atol=0.01)
    assert not table[:, header.index("centre_of_mass")].any()
    report = json.loads((out / "report.json").read_text())
    assert report["summary"]["n_droplets"] == 2
    assert (out / "paths.png").exists()


def test_deepsort_looks_at_the_descriptors(tmp_path: Path) -> None:
    """Two droplets within one gate, listed in another order each frame: their looks tell."""
    places = [[100.0, 50, 40, 40], [104.0, 50, 40, 40]]
    order = [-1 if t >= 5 and t % 2 else 1 for t in range(12)]
    boxes = [places[::way] for way in order]
    path, looks = tmp_path / "d.txt", tmp_path / "d.npy"
    write_detections(path, [labels(b) for b in boxes])
    np.save(looks, np.concatenate([3 * np.eye(2)[::way] for way in order]))
    options = ["--detections", str(path), "--tracker", "deepsort"]
    steps = {}
    for name, more in (("with", ["--descriptors", str(looks)]), ("without", [])):
        out = tmp_path / name
        track(*options, *more, "--out", str(out))
        rows, _ = read_trajectories(out / "trajectories.csv")
        first = rows.x[rows.track_id == 1]
        steps[name] = np.abs(np.diff(first[4:]))
    assert steps["with"].tolist() == [0] * 7
    assert steps["without"].tolist() == [4] * 7


def test_a_file_without_detections_gives_an_empty_table(tmp_path: Path) -> None:
    path, out = file_of(tmp_path, ""), tmp_path / "out"
    track("--detections", str(path), "--out", str(out))
    assert len(read_trajectories(out / "trajectories.csv")[0]) == 0


def test_an_unsorted_file_is_tracked_like_the_sorted_one_and_says_so(tmp_path: Path) -> None:
    path, looks = tmp_path / "d.txt", tmp_path / "d.npy"
    write_detections(path, [labels(boxes) for boxes in moving(20)])
    lines = path.read_text().splitlines(keepends=True)
    order = np.random.default_rng(0).permutation(len(lines))
    early = 2 + int(np.flatnonzero(np.diff(order // 2) < 0)[0])  # row, from 1; two rows a frame
    shuffled = file_of(tmp_path, "".join(lines[i] for i in order))
    descriptors = np.tile(np.eye(2), (20, 1))
    rows = {}
    for file in (path, shuffled):
        np.save(looks, descriptors if file is path else descriptors[order])
        options = ["--detections", str(file), "--descriptors", str(looks)]
        output = track(*options, "--out", str(tmp_path / file.stem))
        assert (f"row {early} belongs before the one above it" in output) == (file is shuffled)
        rows[file] = read_trajectories(tmp_path / file.stem / "trajectories.csv")[0]
    # who is 1 and who is 2 is a matter of the rows' order
    for name in ("frame", "x", "y", "scores"):
        ours, theirs = (
            np.column_stack([t.frame, getattr(t, name)])[np.lexsort((t.y, t.frame))]
            for t in rows.values()
        )
        np.testing.assert_array_equal(ours, theirs)


def test_descriptors_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.npy"
    for table, problem in (
        (np.ones((2, 4)), r"should be 3 rows of numbers, not \(2, 4\)"),
        (np.ones(3), "should be 3 rows"),
        (np.array([[1.0, 0], [0, 0], [0, 1]]), "row 2 has no direction"),
        (np.array([[1.0, 0], [0, 1], [np.nan, 1]]), "row 3 has no direction"),
    ):
        np.save(path, table)
        with pytest.raises(DroptrackError, match=problem):
            open_descriptors(path, 3)
    path.write_text("no array")
    with pytest.raises(DroptrackError, match=r"cannot be read as \.npy"):
        open_descriptors(path, 3)
    np.save(path, np.array([[3.0, 4], [0, 2], [1, 0]]))
    looks = open_descriptors(path, 3)
    assert looks(np.array([0, 1])).tolist() == [[0.6, 0.8], [0, 1]]
    assert looks(np.array([2])).tolist() == [[1, 0]]


def test_options_that_exclude_each_other_are_refused(tmp_path: Path) -> None:
    path = str(file_of(tmp_path, ""))
    assert "takes the place of a video" in fails("video.avi", "--detections", path)
    assert "name a video" in fails()
    assert "name a video" in fails("video.avi", "--descriptors", path)


def test_an_expected_velocity_tells_which_way_a_train_goes(tmp_path: Path) -> None:
    """Discs 40 px apart that go 26 px a frame to the right, or 14 to the left: both explain it."""
    starts = [[x for x in np.arange((26 * t) % 40, 390, 40.0) if x > 10] for t in range(12)]
    frames = [labels([[x, 50.0, 20, 20] for x in one]) for one in starts]
    path = tmp_path / "d.txt"
    write_detections(path, frames)
    for velocity, step in (("26,0", 26.0), ("-14,0", -14.0)):
        out = tmp_path / velocity
        track("--detections", str(path), "--out", str(out), "--expect-velocity", velocity)
        rows, _ = read_trajectories(out / "trajectories.csv")
        steps = [np.diff(rows.x[rows.track_id == one]) for one in np.unique(rows.track_id).tolist()]
        assert np.median(np.concatenate(steps)) == pytest.approx(step, abs=0.5)
    options = ("--detections", str(path), "--out", str(tmp_path / "x"), "--expect-velocity")
    assert "such as 24,-1.5" in fails(*options, "fast")


def test_frames_before_the_first_detection_take_no_time(tmp_path: Path) -> None:
    path = file_of(tmp_path, "".join(f"{5_000_000 + t},-1,9,9,8,8,1\n" for t in range(1, 30)))
    began = time.perf_counter()
    run = run_detections(DetectionsConfig(detections=path, out=tmp_path / "out"))
    assert time.perf_counter() - began < 20  # a minute and more, one by one
    assert run.trajectories.frame.tolist() == list(range(5_000_000, 5_000_029))
    assert run.report.summary["n_frames"] == 29


def test_a_mark_before_the_text_is_no_part_of_it(tmp_path: Path) -> None:
    """Notepad's, before UTF-8."""
    path = tmp_path / "det.txt"
    path.write_bytes(b"\xef\xbb\xbf1,-1,9,9,8,8,1\n")
    assert open_detections(path).n_rows == 1


def test_a_list_of_frames_says_which_exist(tmp_path: Path) -> None:
    path = file_of(tmp_path, "\ufeff1-3 7\n5\n")  # with a mark before UTF-8
    listed = read_frame_list(path)
    assert [n for n in range(10) if n in listed] == [1, 2, 3, 5, 7]
    assert listed.last == 7


@pytest.mark.parametrize("text", ["0", "3-2", "1,2", "-4", "x", "1-2-3", ""])
def test_a_bad_list_of_frames_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(DroptrackError, match=r"lists no frame|numbers of frames from 1"):
        read_frame_list(file_of(tmp_path, text))


def test_a_box_in_a_frame_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    write_detections(tmp_path / "d.txt", [labels(TWO)] * 3)
    (tmp_path / "frames.txt").write_text("1 3")
    options = ("--detections", str(tmp_path / "d.txt"), "--frames", str(tmp_path / "frames.txt"))
    said = fails(*options, "--out", str(tmp_path / "out"))
    assert "d.txt: frame 2, row 3: has a box, but" in said
    assert not (tmp_path / "out").exists()


def test_a_droplet_is_missed_only_in_frames_that_exist(tmp_path: Path) -> None:
    """One box in every third frame: a droplet if the others do not exist, two misses if they do."""
    frames = [labels([[20.0 + t, 30, 10, 12]] if t % 3 == 0 else []) for t in range(31)]
    write_detections(tmp_path / "d.txt", frames)
    (tmp_path / "some.txt").write_text(" ".join(str(t + 1) for t in range(0, 31, 3)))
    (tmp_path / "all.txt").write_text("1-33")
    n = {}
    for name in ("some", "all"):
        options = ["--detections", str(tmp_path / "d.txt"), "--out", str(tmp_path / name)]
        track(*options, "--frames", str(tmp_path / f"{name}.txt"))
        report = json.loads((tmp_path / name / "report.json").read_text())
        n[name] = [report["summary"][k] for k in ("n_droplets", "n_frames", "n_frames_missing")]
    assert n == {"some": [1, 31, 20], "all": [0, 33, 0]}


def test_a_train_whose_step_may_be_another_is_said_to_be_ambiguous(tmp_path: Path) -> None:
    _, frames = make(train(spacing=2.0, step=0.45), 0)
    write_detections(tmp_path / "d.txt", frames)
    options = ["--detections", str(tmp_path / "d.txt"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, ["track", *options])
    assert "velocity_is_ambiguous" in result.stderr
    assert "--expect-velocity=-1" in result.stderr  # 0.55 of the spacing, backwards
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["summary"]["velocity_is_ambiguous"]
    assert [one.split()[0] for one in report["summary"]["entered_at"]] == ["left"]
    told = CliRunner().invoke(app, ["track", *options, "--expect-velocity", "108,0"])
    assert "ambiguous" not in told.stderr


def test_a_long_gap_is_reported_with_its_length_distance_and_confidence(tmp_path: Path) -> None:
    """One of fourteen droplets is unseen for eight frames, in which it goes 18 px."""
    frames = []
    for t in range(40):
        places = [(20.0 + 2 * t + 40 * i, 30.0 + i % 2 * 30) for i in range(14)]
        if 15 <= t < 23:
            del places[5]
        frames.append(labels([[x, y, 16, 16] for x, y in places]))
    write_detections(tmp_path / "d.txt", frames)
    output = track("--detections", str(tmp_path / "d.txt"), "--out", str(tmp_path / "out"))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    (gap,) = report["gaps"]
    assert (gap["first_frame"], gap["n_frames"], gap["against_flow"]) == (15, 8, False)
    assert gap["distance_px"] == pytest.approx(18)
    assert 0.9 < gap["confidence"] <= 1
    assert report["summary"]["n_long_gaps"] == 1
    assert "Bridged gaps of more than 3 frames" in output


def test_gaps_bridged_against_the_flow_are_said_aloud(tmp_path: Path) -> None:
    said: list[str] = []
    with TrajectoryWriter(tmp_path / "t.csv", {}, FURTHER_COLUMNS) as rows:
        backwards, forwards = Gap(7, 15, 8, 20.0, 0.6, True), Gap(9, 3, 5, 20.0, 0.9, False)
        say_what_is_unsure("d.txt", Results(rows, gaps=[forwards, backwards]), said.append)
    (line,) = said
    assert "against the flow, of droplets 7 (frames 15 to 22): look" in line
