"""Networks with several classes: a droplet has one in each frame, and its track one by vote."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.scenes.shapes import draw_ellipses
from droptrack.__main__ import app
from droptrack.data.darknet_dataset import read_names
from droptrack.data.formats.choice import FORMATS, FormatName
from droptrack.data.formats.table import Table
from droptrack.data.trajectories import (
    Trajectories,
    read_trajectories,
    sorted_trajectories,
    write_trajectories,
)
from droptrack.data.video import Video
from droptrack.errors import DroptrackError
from droptrack.pipeline.classes import NO_CLASS, Classes, ClassVotes
from droptrack.pipeline.drawing import CLASS_COLOURS
from tests.pipeline.two_classes import write_two_classes

N_FRAMES = 12
RUNNER = CliRunner()


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a network of two classes, small and large, and a video of twelve frames.

    A disc of 40 px, one of 150 px, and one that grows from 60 to 82 px.
    """
    folder = tmp_path_factory.mktemp("two")
    write_two_classes(folder)
    (folder / "frames").mkdir()
    for t in range(N_FRAMES):
        canvas = np.zeros((480, 960), np.uint8)
        discs = [[100 + 5 * t, 100, 30 + t], [300 + 5 * t, 200, 75], [800 - 5 * t, 400, 20]]
        draw_ellipses(canvas, np.array([[x, y, r, r, 0.0] for x, y, r in discs]), 255)
        cv2.imwrite(str(folder / "frames" / f"{t:03d}.png"), canvas)
    return folder


def run(command: str, two: Path, out: Path, *options: str) -> str:
    weights = ("--weights", str(two / "two.weights"), "--names", str(two / "two.names"))
    done = RUNNER.invoke(app, [command, str(two / "frames"), "--out", str(out), *weights, *options])
    assert done.exit_code == 0, done.output
    return done.output


def test_a_tracks_class_is_that_of_most_of_its_frames(two: Path, tmp_path: Path) -> None:
    """The growing disc is small at first; the share of its frames is counted in the table."""
    run("track", two, tmp_path, "--cells", "0,1+")
    with (tmp_path / "trajectories.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert len(rows) == 3 * N_FRAMES  # one box a droplet, where both heads see it, too
    assert {(row["class_id"], row["class_name"]) for row in rows} == {
        ("0", "small"),
        ("1", "large"),
    }
    by_track = [[row["class_name"] for row in rows if row["track_id"] == str(k)] for k in (1, 2, 3)]
    growing = by_track[0]
    assert (growing[0], growing[-1]) == ("small", "large")
    assert by_track[1:] == [["large"] * N_FRAMES, ["small"] * N_FRAMES]
    report = json.loads((tmp_path / "report.json").read_text())
    said = [(row["class_id"], row["class_name"], row["class_share"]) for row in report["droplets"]]
    n_large = growing.count("large")
    assert n_large > N_FRAMES / 2
    assert said == [(1, "large", pytest.approx(n_large / 12)), (1, "large", 1), (0, "small", 1)]
    assert report["settings"]["classes"] == ["small", "large"]
    assert report["summary"]["n_of_class"] == ["small 1", "large 2"]
    assert report["summary"]["cells_observed"] == ["0 1", "1+ 2"]
    assert report["summary"]["cells_per_droplet"] == pytest.approx(np.log(3))  # exp(-m) = 1/3
    last = list(Video(str(tmp_path / "tracked.mp4")))[-1]
    for (x, y), colour in (((355 - 75, 200), CLASS_COLOURS[1]), ((745, 420), CLASS_COLOURS[0])):
        near = last[y - 2 : y + 3, x - 2 : x + 3].reshape(-1, 3).astype(int)
        assert np.abs(near - colour).sum(axis=1).min() < 60  # of the box, through MPEG-4


def test_images_have_classes_and_counts(two: Path, tmp_path: Path) -> None:
    run("detect", two, tmp_path, "--no-shape")
    with (tmp_path / "detections.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * N_FRAMES
    assert {(row["class_id"], row["class_name"]) for row in rows} == {
        ("0", "small"),
        ("1", "large"),
    }
    summary = json.loads((tmp_path / "report.json").read_text())["summary"]
    n_small = sum(row["class_name"] == "small" for row in rows)
    assert summary["n_of_class"] == [f"small {n_small}", f"large {3 * N_FRAMES - n_small}"]
    assert "cells_observed" not in summary


def test_a_network_of_one_class_says_nothing_of_classes(two: Path, tmp_path: Path) -> None:
    frames = str(two / "frames")
    done = RUNNER.invoke(app, ["track", frames, "--out", str(tmp_path / "t"), "--max-frames", "3"])
    assert done.exit_code == 0, done.output
    found, _ = read_trajectories(tmp_path / "t" / "trajectories.csv")
    assert not {"class_id", "class_name"} & set(found.columns)
    report = json.loads((tmp_path / "t" / "report.json").read_text())
    assert "n_of_class" not in report["summary"]
    assert "class_id" not in report["droplets"][0]
    for option in (("--names", str(two / "two.names")), ("--cells", "0,1")):
        done = RUNNER.invoke(app, ["detect", frames, "--out", str(tmp_path / "d"), *option])
        assert done.exit_code == 1
        assert "has one class only" in done.stderr
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--names", "one.names"), "has 1 names"),
        (("--names", "none.names"), "no such file"),
        (("--cells", "0,1,2"), "each of the 2 classes"),
        (("--cells", "0,x"), "each of the 2 classes"),
        (("--cells", "1,1"), "two classes at least"),
        (("--cells", "0+,1"), "only the largest number may be open"),
    ],
)
def test_names_and_cells_that_do_not_fit_are_refused(
    two: Path, tmp_path: Path, options: tuple[str, str], problem: str
) -> None:
    (two / "one.names").write_text("droplet\n")
    option, value = options
    value = str(two / value) if option == "--names" else value
    weights = ("--weights", str(two / "two.weights"), "--out", str(tmp_path / "out"))
    done = RUNNER.invoke(app, ["track", str(two / "frames"), *weights, option, value])
    assert done.exit_code == 1
    assert problem in done.stderr
    assert not (tmp_path / "out").exists()


def test_names_are_those_of_a_file_or_of_obj_data(tmp_path: Path) -> None:
    (tmp_path / "obj.names").write_text("empty\n one cell \n\n")
    (tmp_path / "obj.data").write_text("classes = 2\nnames = obj.names\n")
    for name in ("obj.names", "obj.data"):
        assert read_names(tmp_path / name) == ("empty", "one cell")
    (tmp_path / "bad.data").write_text("classes = 2\n")
    with pytest.raises(DroptrackError, match=r"no line names"):
        read_names(tmp_path / "bad.data")


def rows_of(votes: list[tuple[int, float]]) -> tuple[Trajectories, "np.ndarray"]:
    """One track, a frame for each (class, score)."""
    n = len(votes)
    classes, scores = (np.array(column) for column in zip(*votes, strict=True))
    rows = sorted_trajectories(
        np.arange(n), np.full(n, 7), np.ones(n), np.ones(n), np.ones((n, 4)), scores, scores > 0
    )
    return rows, classes.astype(np.int64)


def test_bridged_gaps_do_not_vote_and_scores_decide_between_equals() -> None:
    votes = ClassVotes(Classes(("empty", "one", "several")))
    votes.add(*rows_of([(1, 0.9), (2, 0.5), (NO_CLASS, 0.0), (1, 0.6)]))
    assert votes.of(7) == (1, 2 / 3)
    votes.add(*rows_of([(2, 0.95)]))
    assert votes.of(7) == (1, 0.5)  # 1.5 against 1.45
    votes.add(*rows_of([(0, 0.5)] * 2 + [(2, 0.5)]))
    assert votes.of(7) == (2, 3 / 7)


NAMES = np.array(['one, "two" # three', "", "größer"])


def table_with_classes() -> Table:
    rows = sorted_trajectories(
        np.array([0, 1, 2]),
        np.array([1, 1, 1]),
        np.array([5.0, 6, 7]),
        np.array([5.0, 5, 5]),
        np.array([[5.0, 5, 4, 4], [6, 5, 4, 4], [7, 5, 4, 4]]),
        np.array([0.9, 0, 0.8]),
        np.array([True, False, True]),
        {"class_id": np.array([2, NO_CLASS, 1]), "class_name": NAMES},
    )
    return Table(rows=rows, about={"video": "v.avi, 40 x 30 px, 25 frames/s"})


def test_names_of_classes_survive_a_table_whatever_they_are(tmp_path: Path) -> None:
    table = table_with_classes()
    write_trajectories(tmp_path / "t.csv", table.rows, table.about)
    rows, _ = read_trajectories(tmp_path / "t.csv")
    assert rows.columns["class_name"].tolist() == NAMES.tolist()
    assert rows.columns["class_id"].tolist() == [2, NO_CLASS, 1]
    assert rows.columns["class_id"].dtype == np.int64
    (tmp_path / "t.csv").write_text((tmp_path / "t.csv").read_text() + "3,1,1\n")
    with pytest.raises(DroptrackError, match=r"t\.csv: after line 2"):
        read_trajectories(tmp_path / "t.csv")


@pytest.mark.parametrize("name", ["csv", "parquet", "trackpy", "napari", "geff"])
def test_formats_that_hold_all_columns_hold_classes(name: str, tmp_path: Path) -> None:
    kind = FORMATS[FormatName(name)]
    if name in {"parquet", "geff"}:
        pytest.importorskip("pyarrow" if name == "parquet" else "geff")
    kind.write(tmp_path / f"t.{name}", table_with_classes())
    assert kind.read is not None
    columns = kind.read(tmp_path / f"t.{name}", None).rows.columns
    assert columns["class_id"].tolist() == [2, NO_CLASS, 1]
    assert columns["class_name"].tolist() == NAMES.tolist()


def test_labels_for_training_have_the_classes(tmp_path: Path) -> None:
    """Of the bridged row, of which nobody knows, that of most of the others: one of each, so 1."""
    table = table_with_classes()
    FORMATS[FormatName.darknet].write(tmp_path / "labels", table)
    lines = [(tmp_path / "labels" / f"00000{t}.txt").read_text() for t in range(3)]
    assert [line.split()[0] for line in lines] == ["2", "1", "1"]
    FORMATS[FormatName.coco].write(tmp_path / "t.json", table)
    coco = json.loads((tmp_path / "t.json").read_text())
    assert [one["category_id"] for one in coco["annotations"]] == [3, 2, 2]
    assert coco["categories"] == [{"id": 2, "name": "größer"}, {"id": 3, "name": NAMES[0]}]
