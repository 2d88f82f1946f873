from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from droptrack.data.trajectories import (
    Trajectories,
    read_trajectories,
    sorted_trajectories,
    write_trajectories,
)
from droptrack.errors import DroptrackError

HEADER = "frame,track_id,x,y,w,h,score,observed\n"


def some(n: int = 50) -> Trajectories:
    rng = np.random.default_rng(0)
    frame, track_id = np.divmod(rng.permutation(n), 7)
    return sorted_trajectories(
        frame,
        track_id + 1,
        rng.uniform(0, 600, n).round(6),
        rng.uniform(0, 600, n).round(6),
        rng.uniform(1, 60, (n, 4)).round(6),
        rng.random(n).round(6),
        rng.random(n) < 0.5,
    )


def test_a_file_reads_back_to_the_same_rows(tmp_path: Path) -> None:
    rows, path = some(), tmp_path / "t.csv"
    write_trajectories(path, rows, {"made by": "a test", "video": "v.avi, 1200 x 600 px"})
    again, about = read_trajectories(path)
    for name in vars(rows):
        np.testing.assert_array_equal(getattr(again, name), getattr(rows, name))
    assert about == {"made by": "a test", "video": "v.avi, 1200 x 600 px"}
    assert path.read_text().splitlines()[2].startswith(HEADER.strip())


def test_a_file_without_box_centres_has_them_at_the_positions(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEADER + "1,2,30.5,40.25,8,6,1,1\n0,2,30,40,8,6,1,0\n")
    rows, _ = read_trajectories(path)
    assert rows.frame.tolist() == [0, 1]
    assert rows.boxes.tolist() == [[30, 40, 8, 6], [30.5, 40.25, 8, 6]]
    assert rows.observed.tolist() == [False, True]


def test_a_name_of_two_lines_stays_in_its_line(tmp_path: Path) -> None:
    write_trajectories(tmp_path / "t.csv", some(), {"video": "two\nlines.avi", "made by": "x"})
    rows, about = read_trajectories(tmp_path / "t.csv")
    assert len(rows) == len(some())
    assert about == {"video": r"two\nlines.avi", "made by": "x"}


def test_an_empty_table_is_a_valid_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_trajectories(path, some(0), {})
    assert len(read_trajectories(path)[0]) == 0


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "should have the columns frame,track_id"),
        ("x,y\n1,2\n", "should have the columns"),
        (HEADER + "0,1,5,5,2,2,1\n", "8 columns"),
        (HEADER + "0,1,5,five,2,2,1,1\n", "five"),
        (HEADER + "0,1,5,nan,2,2,1,1\n", "y should be finite"),
        (HEADER + "0,1,5,5,2,2,1,1\n0.5,1,5,5,2,2,1,1\n", "row 2 .*: frame should be a whole"),
        (HEADER + "-1,1,5,5,2,2,1,1\n", "frame should be a whole number from 0"),
        (HEADER + "1e30,1,5,5,2,2,1,1\n", "frame should be a whole number"),
        (HEADER + "0,1.5,5,5,2,2,1,1\n", "track_id should be a whole number"),
        (HEADER + "0,1,5,5,-2,2,1,1\n", "w and h should not be below 0"),
        (HEADER + "0,1,5,5,2,2,1,2\n", "observed should be 0 or 1"),
        (HEADER.strip() + ",a,a\n0,1,5,5,2,2,1,1,3,4\n", "two columns of one name"),
        (HEADER + "0,1,5,5,2,2,1,1\n0,1,6,6,2,2,1,1\n", "each pair once"),
    ],
)
def test_a_damaged_file_is_refused_with_its_name(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(DroptrackError, match=problem) as caught:
        read_trajectories(path)
    assert "t.csv" in str(caught.value)


def test_a_missing_file_and_an_unwritable_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(DroptrackError, match="no such file"):
        read_trajectories(tmp_path / "none.csv")
    with pytest.raises(DroptrackError, match="cannot be written"):
        write_trajectories(tmp_path / "no" / "folder.csv", some(), {})


def test_further_columns_come_back_by_their_names(tmp_path: Path) -> None:
    rows = some()
    speed = np.arange(len(rows)) / 4
    wide = replace(rows, columns={"speed": speed})
    write_trajectories(tmp_path / "t.csv", wide, {})
    found, _ = read_trajectories(tmp_path / "t.csv")
    np.testing.assert_array_equal(found.columns["speed"], speed)
    np.testing.assert_array_equal(found.boxes, rows.boxes)
    np.testing.assert_array_equal(found[found.frame > 0].columns["speed"], speed[rows.frame > 0])
    with pytest.raises(ValueError, match="speed should have shape"):
        replace(rows, columns={"speed": speed[1:]})


def test_a_data_frame_has_trackpys_columns_first() -> None:
    pandas = pytest.importorskip("pandas", reason="needs the extra [pandas]")
    rows = replace(some(), columns={"speed": np.zeros(len(some()))})
    table = rows.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    names = [
        "frame",
        "particle",
        "x",
        "y",
        "box_x",
        "box_y",
        "w",
        "h",
        "score",
        "observed",
        "speed",
    ]
    assert list(table.columns) == names
    by_hand = table[table.particle == rows.track_id[0]].sort_values("frame")
    np.testing.assert_array_equal(by_hand.x, rows.x[rows.track_id == rows.track_id[0]])
