"""Columns of one's own, and tables that are read fast."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from droptrack.data.formats.tables import read_csv
from droptrack.data.trajectories import FIELDS, TrajectoryWriter, sorted_trajectories
from droptrack.pipeline.config import TrackingConfig
from droptrack.studies.data_set import write_data_set
from droptrack.studies.jobs import Job
from droptrack.studies.tables import free_types, free_values, read_table


def job(**free: str) -> Job:
    return Job(
        name="a", folder=Path("a"), config=TrackingConfig(video="a"), free=free, made_from={}
    )


def test_a_column_of_numbers_is_one_of_numbers_and_any_other_is_text() -> None:
    jobs = [
        job(n="1", flow="1.5", id="007", note="", mixed="1"),
        job(n="-20", flow="2", id="12", note="", mixed="x"),
        job(n="", flow="1e-3"),
    ]
    types = free_types(jobs)
    assert types == {"n": int, "flow": float, "id": str, "note": str, "mixed": str}
    assert free_values(jobs[0], types) == {
        "n": 1,
        "flow": 1.5,
        "id": "007",
        "note": None,
        "mixed": "1",
    }
    assert free_values(jobs[2], types) == {
        "n": None,
        "flow": 0.001,
        "id": None,
        "note": None,
        "mixed": None,
    }


@pytest.mark.parametrize("n", [0, 50])
def test_a_table_is_read_as_it_is_without_pyarrow(tmp_path: Path, n: int) -> None:
    pytest.importorskip("pyarrow")
    rng = np.random.default_rng(3)
    x, y, w, h = rng.uniform(5, 90, (4, n))
    rows = sorted_trajectories(
        frame=rng.integers(0, 9, n),
        track_id=np.arange(n) + 1,
        x=x,
        y=y,
        boxes=np.column_stack([x, y, w, h]),
        scores=rng.uniform(0, 1, n),
        observed=rng.uniform(0, 1, n) < 0.5,
    )
    diameter = np.where(rows.observed, rows.x, np.nan)
    path = tmp_path / "trajectories.csv"
    about = {"video": "a.avi, 640 x 480 px, 25 frames/s", "note": "a: b", "units": "px"}
    ids = np.where(rows.observed, rows.frame % 2, -1)
    names = np.array(['a, "b"', "full", ""])[ids]
    columns = ("diameter_px", "at_edge", "class_id", "class_name")
    with TrajectoryWriter(path, about, columns) as writer:
        writer.write(rows, (diameter, rows.observed, ids, names))
    fast, slow = read_table(path), read_csv(path)
    assert fast.size == slow.size == (640, 480)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(fast.rows, name), getattr(slow.rows, name))
    for name, column in slow.rows.columns.items():
        np.testing.assert_array_equal(fast.rows.columns[name], column)


def test_names_of_classes_are_in_the_data_set(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow.parquet")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "trajectories.csv").write_text(
        "# video: a.avi\nframe,track_id,x,y,w,h,score,observed,class_id,class_name\n"
        "0,1,2,3,4,5,0.5,1,1,two cells\n1,1,2,3,4,5,0.5,0,-1,\n"
    )
    write_data_set(tmp_path / "set", [replace(job(), folder=tmp_path / "a")], {})
    found = arrow.read_table(tmp_path / "set").to_pydict()
    assert found["class_name"] == ["two cells", ""]
    assert found["class_id"] == [1, -1]
    assert found["observed"] == [True, False]
    assert found["video"] == ["a", "a"]
