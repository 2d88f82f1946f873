"""Passages and stays that one can count by hand."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.trajectories import Trajectories, sorted_trajectories, write_trajectories
from droptrack.tracking.events.passages import Line, Region, parse_region, passages, stays


def train(n: int = 5, frames: int = 100) -> Trajectories:
    """Droplets of 12 px, 40 px apart, that go 2.5 px a frame to the right; the first from 0."""
    table = np.array(
        [
            [t, k + 1, x, 50.0 + k]
            for t in range(frames)
            for k in range(n)
            if 0 <= (x := 2.5 * t - 40 * k) <= 200
        ]
    )
    x, y = table[:, 2:].T
    m = len(table)
    return sorted_trajectories(
        table[:, 0].astype(np.int64),
        table[:, 1].astype(np.int64),
        x,
        y,
        np.column_stack([x, y, np.full((m, 2), 12.0)]),
        np.ones(m),
        np.ones(m, bool),
        {"diameter_px": np.full(m, 11.0)},
    )


def test_a_train_passes_a_line_at_its_frequency() -> None:
    """At x = 101, every 16 frames, from frame 40.4 on."""
    found = passages(train(), Line(101, 90, 101, 10))
    assert [one.track_id for one in found] == [1, 2, 3, 4]
    assert [one.frame for one in found] == pytest.approx([40.4 + 16 * k for k in range(4)])
    assert {one.forward for one in found} == {1}
    assert {one.speed_px_per_frame for one in found} == {2.5}
    assert {one.diameter_px for one in found} == {11.0}
    back = passages(train(), Line(101, 10, 101, 90))
    assert {one.forward for one in back} == {-1}
    assert len(passages(train(), Line(101, 90, 101, 52.5))) == 1  # only the fourth, at y = 53
    assert passages(train(), Line(101, 40, 101, 10)) == []


def test_who_touches_a_line_and_turns_back_has_not_passed() -> None:
    x = np.array([0.0, 5, 10, 5, 10, 12])
    n = len(x)
    rows = sorted_trajectories(
        np.arange(n), np.ones(n, np.int64), x, np.full(n, 5.0), np.full((n, 4), 4.0),
        np.ones(n), np.ones(n, bool),
    )  # fmt: skip
    (one,) = passages(rows, Line(10, 10, 10, 0))
    assert one.x == pytest.approx(10)
    assert 3 <= one.frame <= 5


def test_stays_are_counted_from_the_first_to_the_last_frame_inside() -> None:
    """Centres from x = 50 up to, but without, 60: the first droplet's frames 20 to 23."""
    found = stays(train(), parse_region("50,0,60,100", (200, 100)))
    assert [(one.track_id, one.first_frame, one.last_frame) for one in found] == [
        (k + 1, 20 + 16 * k, 23 + 16 * k) for k in range(5)
    ]
    assert all(one.whole for one in found[:4])
    triangle = Region(np.array([[0.0, 0], [200, 100], [0, 100]]))
    assert [one.track_id for one in stays(train(1), triangle)] == [1]
    assert stays(train(1), triangle)[0].last_frame == 39  # until x < 2 y = 100


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["events", *map(str, arguments)])
    return result.exit_code, result.output


def test_the_command_writes_tables_and_a_report(tmp_path: Path) -> None:
    path, out = tmp_path / "trajectories.csv", tmp_path / "out"
    write_trajectories(path, train(), {"video": "v.avi, 200 x 100 px, 100 frames/s"})
    code, said = run(
        *(path, "--out", out, "--line", "101,90,101,10", "--region", "50,0,60,100"),
        *("--um-per-px", 2),
    )
    assert code == 0, said
    summary = json.loads((out / "report.json").read_text())["summary"]
    assert (summary["line_1_n_forward"], summary["line_1_n_backward"]) == (4, 0)
    assert summary["line_1_frequency_hz"] == pytest.approx(4)  # four in 100 frames, a second
    assert summary["line_1_mean_spacing_px"] == pytest.approx(40)
    assert summary["line_1_mean_spacing_um"] == pytest.approx(80)
    assert summary["region_1_mean_whole_stay_frames"] == 4
    assert summary["region_1_mean_whole_stay_s"] == pytest.approx(0.04)
    assert summary["n_entering"] == 4
    with (out / "passages.csv").open() as file:
        first = next(csv.DictReader(file))
    assert float(first["speed_um_per_s"]) == pytest.approx(500)
    assert float(first["time_s"]) == pytest.approx(0.404)
    assert (out / "events.csv").read_text().startswith("frame,kind,parents,children,x,y,")
    assert "has a trajectories.csv already" in run(path, "--out", out)[1]


@pytest.mark.parametrize(
    ("option", "text", "problem"),
    [
        ("--line", "1,2,1,2", "has no length"),
        ("--line", "1,2,3", "should be X1,Y1,X2,Y2"),
        ("--line", "1,2,900,4", "lies outside the image, 200 x 100 px"),
        ("--region", "1,2,1,9", "has no area"),
        ("--region", "1,2,3,4,5", "should be"),
        ("--region", "a", "should be"),
        ("--region", "-1,2,3,9", "lies outside"),
        ("--um-per-px", "0", "should be above 0"),
        ("--size", "0x5", "should be WxH"),
        ("--plots", "size", "should be all, or some of sizes,deformation"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(
    option: str, text: str, problem: str, tmp_path: Path
) -> None:
    path = tmp_path / "trajectories.csv"
    write_trajectories(path, train(), {"video": "v.avi, 200 x 100 px, 100 frames/s"})
    code, said = run(path, "--out", tmp_path / "out", option, text)
    assert code == 1
    assert problem in said
    assert not (tmp_path / "out").exists()


def test_plots_are_drawn_as_pdf_and_png(tmp_path: Path) -> None:
    """With velocities and without deformations, which is said in the figure."""
    rows, path = train(), tmp_path / "trajectories.csv"
    columns = {**rows.columns, "velocity_x": np.full(len(rows), 2.5)}
    columns |= {"velocity_y": np.zeros(len(rows)), "at_edge": (rows.x < 10).astype(float)}
    fields = {name: getattr(rows, name) for name in ("frame", "track_id", "x", "y", "boxes")}
    rows = Trajectories(**fields, scores=rows.scores, observed=rows.observed, columns=columns)
    write_trajectories(path, rows, {"video": "v.avi, 200 x 100 px, 100 frames/s"})
    out = tmp_path / "out"
    code, said = run(path, "--out", out, "--plots", "all", "--um-per-px", 2)
    assert code == 0, said
    names = ("sizes", "deformation", "speed", "kymograph", "paths")
    for name in names:
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        image = cv2.imread(str(out / f"{name}.png"))
        assert image is not None
        assert (image < 128).any()
    code, _ = run(path, "--out", tmp_path / "two", "--plots", "sizes,paths")
    assert code == 0
    assert not (tmp_path / "two" / "speed.png").exists()
