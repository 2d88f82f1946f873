"""``droptrack track --line --stays --plots`` does what ``droptrack events`` does with its table."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app

OPTIONS = ("--backend", "opencv", "--size", "640x320", "--no-video", "--max-frames", "25")
LINES = ("--line", "600,0,600,600", "--line", "0,300,1200,300")
REGION, PLOTS = "300,100,700,500", ("--plots", "paths")


def run(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(one) for one in arguments])
    return done.exit_code, done.output


def test_events_of_a_run_are_those_of_its_table(sine: Path, tmp_path: Path) -> None:
    video, out, after = sine / "video.avi", tmp_path / "out", tmp_path / "after"
    code, said = run(*("track", video, "--out", out, *OPTIONS, *LINES, "--stays", REGION, *PLOTS))
    assert code == 0, said
    assert "line 1 n forward" in said
    table = out / "trajectories.csv"
    code, said = run("events", table, "--out", after, *LINES, "--region", REGION, *PLOTS)
    assert code == 0, said
    names = sorted(path.name for path in after.iterdir())
    assert names == sorted(path.name for path in (out / "events").iterdir())
    for name in ("events.csv", "passages.csv", "stays.csv", "trajectories.csv", "report.json"):
        assert (out / "events" / name).read_text() == (after / name).read_text()
    summary = json.loads((after / "report.json").read_text())["summary"]
    assert summary["region_1_n_stays"] > 0
    code, said = run(
        *("track", video, "--out", out, *OPTIONS, "--overwrite", "--line", "600,0,600,600")
    )
    assert code == 0, said
    summary = json.loads((out / "events" / "report.json").read_text())["summary"]
    assert "line_2_n_forward" not in summary


@pytest.mark.parametrize(
    ("option", "text", "problem"),
    [
        ("--line", "1,2,1,2", "--line 1,2,1,2: has no length"),
        ("--stays", "1,2,1300,9", "--stays 1,2,1300,9: lies outside the image, 1200 x 600 px"),
        ("--plots", "size", "should be all, or some of sizes,deformation"),
    ],
)
def test_what_cannot_be_is_refused_before_tracking(
    sine: Path, tmp_path: Path, option: str, text: str, problem: str
) -> None:
    code, said = run("track", sine / "video.avi", "--out", tmp_path / "out", option, text)
    assert code == 1
    assert problem in said
    assert not (tmp_path / "out").exists()
