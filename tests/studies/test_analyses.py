"""Analyses and events of the videos of a study."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.analyse import asked_for
from droptrack.analysis.choice import ANALYSES
from droptrack.analysis.motion.report import MotionConfig
from droptrack.data.trajectories import read_trajectories
from droptrack.errors import DroptrackError
from droptrack.studies.analyses import NAMES, told_of
from tests.studies.test_batch import Clips, batch, redone, rows, summary, times


def test_analyses_are_asked_for_by_their_names_or_as_their_commands_are() -> None:
    asked = asked_for(["size,flock", "motion --lag 5 --radius 30"])
    assert [one.name for one in asked] == ["size", "flock", "motion"]
    assert asked[2].config == MotionConfig(lag=5, radius_px=30)
    assert told_of(asked[2]) == "radius_px 30.0, lag 5"
    assert {one.name for one in asked_for(["all"])} == set(ANALYSES) == set(NAMES)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sizes", "'sizes' is none of flock, motion, structure, flow, size and all"),
        ("", "'' is none of"),
        ("size,size", "size is asked for twice"),
        ("size,flow --line 1,2,3,4", "options are of one analysis each"),
        ("motion --lag few", "--lag"),
        ("motion --lags 5", "--lags"),
        ("flow --line '1,2", "No closing quotation"),
    ],
)
def test_what_is_no_analysis_is_said_in_one_line(text: str, said: str) -> None:
    with pytest.raises(DroptrackError, match="--analyse ") as problem:
        asked_for([text])
    assert said in str(problem.value)
    assert "\n" not in str(problem.value)


def test_analyses_and_events_of_each_video_are_in_its_folder_the_table_and_the_page(
    clips: Clips, tmp_path: Path
) -> None:
    clips(tmp_path / "a.avi", 0, 8)
    out = tmp_path / "out"
    line = "240,0,240,256"
    options = ("--um-per-px", "0.5", "--line", line, "--line", "9,0,9,256", "--plots", "sizes")
    batch(tmp_path / "a.avi", "--out", out, *options)
    before = rows(out / "a")
    tracked = (out / "a" / "report.json").stat().st_mtime_ns
    said = batch(tmp_path / "a.avi", "--out", out, *options, "--analyse", f"flow --line {line}")
    assert "1 video to do" in said
    batch(tmp_path / "a.avi", "--out", out, *options, "--analyse", "size")
    assert (out / "a" / "report.json").stat().st_mtime_ns == tracked  # only analysed again
    assert rows(out / "a") == before
    folder = out / "a" / "analysis"
    assert {path.name.split("_")[0].split(".")[0] for path in folder.iterdir()} == {"size"}
    found, _ = read_trajectories(out / "a" / "trajectories.csv")
    one = summary(out)["a"]
    assert int(one["size_n_droplets"]) == int(one["n_droplets"]) == len(set(found.track_id))
    content = json.loads((folder / "size.json").read_text())
    in_px = float(one["size_mean_diameter_px"])
    assert float(one["size_mean_diameter_um"]) == pytest.approx(in_px / 2)
    assert in_px == pytest.approx(content["mean_diameter_px"])
    # counted by hand: droplets that are on either side of the line, one frame after the other
    n_across = 0
    for k in np.unique(found.track_id):
        side = found.x[found.track_id == k] > 240
        n_across += int(np.count_nonzero(side[1:] != side[:-1]))
    assert n_across > 0
    assert int(one["line_1_n_forward"]) + int(one["line_1_n_backward"]) == n_across
    page = (out / "index.html").read_text(encoding="utf-8")
    for link in ("a/analysis/size.html", "a/events/passages.csv", "a/events/sizes.png"):
        assert f'href="{link}"' in page
        assert (out / link).is_file()
    assert "analysis/flow.html" not in page


def test_an_analysis_that_fails_keeps_the_trajectories(clips: Clips, tmp_path: Path) -> None:
    clips(tmp_path / "a.avi", 0, 6)
    clips(tmp_path / "b.avi", 3, 6)
    table, out = tmp_path / "list.csv", tmp_path / "out"

    def run(line: str, code: int) -> str:
        table.write_text(f"video;analyse\na.avi;\nb.avi;size | flow --line {line}\n")
        return batch(table, "--out", out, "--analyse", "size", code=code)

    said = run("9", 1)
    assert "b: failed: analyse flow: --line 9: should be " in said
    assert summary(out)["b"]["state"] == "failed"
    before, table_of_b = times(out), (out / "b" / "trajectories.csv").stat().st_mtime_ns
    run("240,0,240,256", 0)
    assert redone(out, before) == {"b"}
    assert (out / "b" / "trajectories.csv").stat().st_mtime_ns == table_of_b
    of_both = summary(out)
    assert of_both["b"]["flow_n_forward"] != ""
    assert of_both["a"]["flow_n_forward"] == ""
    assert of_both["a"]["size_n_droplets"] != ""
    batch(table, "--out", out, "--analyse", "size", "--redo")
    assert (out / "b" / "trajectories.csv").stat().st_mtime_ns != table_of_b


def test_the_commands_have_the_options_that_they_had() -> None:
    result = CliRunner().invoke(app, ["analyse", "motion", "--help"], env={"COLUMNS": "200"})
    names = [word for word in result.output.split() if word.startswith("--")]
    options = ("--out", "--radius", "--radius-diameters", "--lag", "--um-per-px", "--known-length")
    assert [name for name in names if name != "--help"] == [
        *options,
        *("--fps", "--size", "--seed", "--overwrite"),
    ]
