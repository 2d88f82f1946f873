"""Tracking a file of detections: no video, no network."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack import DroptrackError
from droptrack.__main__ import app
from droptrack.detections import labels
from droptrack.from_detections import read_descriptors
from droptrack.mot_files import read_detections, write_detections
from droptrack.trajectories import read_trajectories

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
    frames, rows = read_detections(path)
    assert [found.boxes.tolist() for found in frames] == [TWO, [], TWO[:1]]
    assert [r.tolist() for r in rows] == [[0, 1], [], [2]]
    assert path.read_text().splitlines()[0] == (
        "1,-1,15.000000,24.000000,10.000000,12.000000,1.000000"
    )


def test_rows_in_any_order_more_columns_and_frames_that_skip(tmp_path: Path) -> None:
    path = file_of(tmp_path, "4 -1 0 0 8 8 0.5 -1 -1 -1\n1 -1 2 0 8 8 0.9 -1 -1 -1\n")
    frames, rows = read_detections(path)
    assert [len(found) for found in frames] == [1, 0, 0, 1]
    assert (frames[0].scores.tolist(), frames[0].boxes[0].tolist()) == ([0.9], [6, 4, 8, 8])
    assert [r.tolist() for r in rows] == [[1], [], [], [0]]


def test_an_empty_file_has_no_frames(tmp_path: Path) -> None:
    assert read_detections(file_of(tmp_path, "\n")) == ([], [])


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("2,-1,0,0,8,nan,1", "frame 2, row 2: boxes and scores should be finite"),
        ("2,-1,0,0,inf,8,1", "frame 2, row 2: boxes and scores should be finite"),
        ("3,-1,0,0,-8,8,1", "frame 3, row 2: boxes need a width and height above 0"),
        ("0,-1,0,0,8,8,1", "frame 0, row 2: a frame should be a whole number from 1"),
        ("1.5,-1,0,0,8,8,1", "frame 1.5, row 2: a frame should be a whole number"),
        ("99999999,-1,0,0,8,8,1", "row 2: a frame should be 10000000 or less"),
        ("1,-1,0,0,8,eight,1", "eight"),
        ("1,-1,0,0,8,8", "columns"),
    ],
)
def test_what_cannot_be_a_box_is_refused_with_its_place(
    tmp_path: Path, row: str, problem: str
) -> None:
    path = file_of(tmp_path, f"1,-1,0,0,8,8,1\n{row}\n")
    with pytest.raises(DroptrackError, match=r"detections\.txt: .*" + problem):
        read_detections(path)


def test_too_few_columns_and_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match="rows should be frame,-1,left"):
        read_detections(file_of(tmp_path, "1,-1,0,0,8\n"))
    with pytest.raises(DroptrackError, match="no such file"):
        read_detections(tmp_path / "none.txt")


def moving(n_frames: int) -> list[list[list[float]]]:
    """Two droplets, one partly and at last wholly beyond the picture's left edge."""
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


def test_descriptors_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    rows = [np.array([0, 1]), np.array([2])]
    path = tmp_path / "d.npy"
    for table, problem in (
        (np.ones((2, 4)), r"should be 3 rows of numbers, not \(2, 4\)"),
        (np.ones(3), "should be 3 rows"),
        (np.array([[1.0, 0], [0, 0], [0, 1]]), "row 2 has no direction"),
        (np.array([[1.0, 0], [0, 1], [np.nan, 1]]), "row 3 has no direction"),
    ):
        np.save(path, table)
        with pytest.raises(DroptrackError, match=problem):
            read_descriptors(path, rows)
    path.write_text("no array")
    with pytest.raises(DroptrackError, match=r"cannot be read as \.npy"):
        read_descriptors(path, rows)
    np.save(path, np.array([[3.0, 4], [0, 2], [1, 0]]))
    looks = read_descriptors(path, rows)
    assert [look.tolist() for look in looks] == [[[0.6, 0.8], [0, 1]], [[1, 0]]]


def test_options_that_exclude_each_other_are_refused(tmp_path: Path) -> None:
    path = str(file_of(tmp_path, ""))
    assert "takes the place of a video" in fails("video.avi", "--detections", path)
    assert "name a video" in fails()
    assert "name a video" in fails("video.avi", "--descriptors", path)
