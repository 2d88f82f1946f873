"""Headings beside those of neighbours: drawings whose answers one can say."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.analysis.flock.following import MAX_LAG, follow
from droptrack.analysis.flock.headings import headings_of, local_flow
from droptrack.analysis.flock.report import FlockConfig, analyse_flock
from droptrack.analysis.paths import paths_of
from droptrack.data.arrays import Floats
from droptrack.data.formats.table import Table
from droptrack.data.trajectories import Trajectories, write_trajectories
from tests.analysis.drawings import moving, rows_of


def values(rows: Trajectories, **options: float) -> dict[str, float]:
    found = analyse_flock(Table(rows=rows), FlockConfig(**options))  # type: ignore[arg-type]
    return {one.stem: one.value for one in found.quantities} | dict(found.counts)


GRID = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) * 12 + 20


def test_all_go_one_way() -> None:
    """Aligned, and just as much when shuffled; relative to the mean flow nothing moves."""
    found = values(rows_of(moving(GRID, lambda t: np.array([1.0, 0.5]), 10)))
    assert found["share"] == found["share_shuffled"] == 1
    assert found["polarisation"] == pytest.approx(1)
    assert found["n_pairs"] == 64 * 9
    assert found["n_excluded"] == found["n_excluded_no_next_frame"] == 64
    assert math.isnan(found["share_mean_flow_subtracted"])
    assert math.isnan(found["share_local_flow_subtracted"])
    assert math.isnan(found["following_delay"])  # nobody turns


def test_headings_at_random_are_aligned_by_threshold_over_pi() -> None:
    rng = np.random.default_rng(1)

    def velocity(_: int) -> Floats:
        angles = rng.uniform(-np.pi, np.pi, len(GRID))
        return np.column_stack([np.cos(angles), np.sin(angles)]) * 0.01

    rows = rows_of(moving(GRID, velocity, 200))
    found = values(rows, threshold_rad=0.3)
    # 12,736 pairs; not independent, so four of the errors that independence would give
    assert found["share"] == pytest.approx(0.3 / np.pi, abs=4 * 0.0026)
    assert found["share_shuffled"] == pytest.approx(0.3 / np.pi, abs=0.005)
    assert found["polarisation"] == pytest.approx(np.sqrt(np.pi / 256), rel=0.1)


def test_angles_are_compared_around_the_circle() -> None:
    """3.10 and -3.10 rad are 0.083 rad apart, of which 0.12 are allowed and 0.05 are not."""
    starts = np.array([[0.0, 0], [8, 0]])
    turned = np.array([[np.cos(3.1), np.sin(3.1)], [np.cos(-3.1), np.sin(-3.1)]]) * 0.1
    rows = rows_of(moving(starts + 50, lambda t: turned, 5))
    assert values(rows)["share"] == 1
    assert values(rows, threshold_rad=0.05)["share"] == 0


def test_the_mean_of_neighbours_leaves_out_oneself_and_is_circular() -> None:
    """The middle one goes along 0, its neighbours along 1.0 and -0.8: their mean is 0.1."""
    angles = np.array([1.0, 0.0, -0.8])
    velocity = np.column_stack([np.cos(angles), np.sin(angles)]) * 0.01
    rows = rows_of(moving(np.array([[40.0, 50], [50, 50], [60, 50]]), lambda t: velocity, 3))
    found = values(rows, radius_px=12.0)
    assert found["share"] == pytest.approx(1 / 3)
    assert values(rows, radius_px=12.0, threshold_rad=0.09)["share"] == 0
    # within 25 px all are neighbours: of the outer ones, too, none is within 0.12
    assert values(rows, radius_px=25.0)["share"] == pytest.approx(1 / 3)


def test_two_streams_are_aligned_beyond_chance() -> None:
    """Left half up, right half down: neighbours agree but at the seam, shuffled ones do not."""
    left = GRID[:, 0] < GRID[:, 0].mean()
    velocity = np.column_stack([np.zeros(64), np.where(left, -0.02, 0.02)])
    found = values(rows_of(moving(GRID, lambda t: velocity, 10)), radius_px=13.0)
    # at the seam 1 of 3 or 4 neighbours goes the other way, so the mean is still one's own
    assert found["share"] == 1
    assert 0.2 < found["share_shuffled"] < 0.75
    assert found["share_mean_flow_subtracted"] == 1  # the mean is zero


def test_the_local_flow_is_that_of_the_others() -> None:
    """A steady shear u_x = 0.01 y on a dense grid is found, but for the edge, from the others."""
    rng = np.random.default_rng(2)
    starts = rng.uniform(0, 200, (300, 2))
    places = moving(starts, lambda t: np.column_stack([starts[:, 1], np.zeros(300)]) * 0.01, 6)
    headings, _ = headings_of(paths_of(rows_of(places)))
    flow = local_flow(headings, 20.0)
    y = headings.places[:, 1]
    inside = (y > 60) & (y < 140) & (headings.places[:, 0] > 50) & (headings.places[:, 0] < 150)
    assert np.abs(flow[inside, 0] - 0.01 * y[inside]).mean() < 0.1
    lonely, _ = headings_of(paths_of(rows_of(places[:, :1])))
    assert np.isnan(local_flow(lonely, 20.0)).all()


def test_a_follower_turns_later() -> None:
    """The one behind has the heading that the one ahead had five frames ago."""

    def heading(t: float) -> float:
        return 0.6 * math.sin(t / 4) + 0.4 * math.sin(t / 11)

    def velocity(t: int) -> Floats:
        return np.array([[math.cos(a), math.sin(a)] for a in (heading(t), heading(t - 5))]) * 0.05

    rows = rows_of(moving(np.array([[60.0, 50], [50, 50]]), velocity, 150))
    headings, _ = headings_of(paths_of(rows))
    found = follow(headings, 15.0, np.random.default_rng(0))
    assert found.pairs.tolist() == [[0, 1]]  # the first leads
    assert found.best.tolist() == [5]
    assert found.highest[0] == pytest.approx(1)
    assert values(rows)["following_delay"] == 5
    assert MAX_LAG > 5


def test_gaps_bridged_rows_and_rest_have_no_heading() -> None:
    places = moving(np.array([[50.0, 50], [58, 50], [66, 50]]), lambda t: np.array([0.5, 0]), 6)
    places[3, 0] = np.nan  # the first is missed in frame 3: no step to it nor from it
    places[:, 2] = places[0, 2]  # the third never moves
    rows = rows_of(places)
    observed = rows.observed.copy()
    observed[(rows.frame == 5) & (rows.track_id == 2)] = False
    rows = Trajectories(**{**vars(rows), "observed": observed})
    found = values(rows, radius_px=30.0)
    # steps: droplet 1 from 0, 1, 4; droplet 2 from 0 to 3; in 2 and 3 one of them is alone
    assert found["n_excluded_bridged_or_at_edge"] == 1
    assert found["n_excluded_standing_still"] == 5
    assert found["n_pairs"] == 4  # both in frames 0 and 1
    assert found["n_excluded_no_neighbour"] == 3  # 1 in 4; 2 in 2 and 3
    assert found["n_excluded"] == len(rows) - 4
    parts = [value for key, value in found.items() if key.startswith("n_excluded_")]
    assert sum(parts) == found["n_excluded"]


def test_frames_that_are_apart_have_no_headings_and_that_is_said() -> None:
    rows = rows_of(moving(GRID, lambda t: np.array([1.0, 0]), 4))
    rows = Trajectories(**{**vars(rows), "frame": rows.frame * 10})
    found = analyse_flock(Table(rows=rows), FlockConfig())
    assert "at least 10 apart" in found.notes[0]
    assert found.counts["n_pairs"] == 0


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["analyse", *map(str, arguments)])
    return result.exit_code, result.output


def test_the_command_writes_what_it_promises(tmp_path: Path) -> None:
    rows = rows_of(moving(GRID, lambda t: np.array([1.0, 0.02 * t]), 30))
    write_trajectories(tmp_path / "t.csv", rows, {"video": "v.avi, 300 x 200 px, 50 frames/s"})
    out = tmp_path / "out"
    code, said = run(
        "flock", tmp_path / "t.csv", "--out", out, "--radius-diameters", 2, "--threshold", 0.2
    )
    assert code == 0, said
    found = json.loads((out / "flock.json").read_text())
    assert found["share"] == found["share_shuffled"] == 1
    assert found["n_pairs"] == 64 * 29
    assert found["n_excluded"] == 64
    assert found["settings"]["radius_px"] == pytest.approx(20)
    assert found["following_delay_frames"] == 0
    assert found["following_delay_s"] == 0
    page = (out / "flock.html").read_text()
    for picture in ("scatter", "radius", "threshold", "polarisation", "neighbourhood"):
        assert (out / f"flock_{picture}.png").stat().st_size > 1000
        assert f'src="flock_{picture}.png"' in page
    assert "http" not in page  # nothing from elsewhere
    assert (out / "flock_radius.csv").read_text().startswith("curve,radius_diameters,share,")
    again, said = run("flock", tmp_path / "t.csv", "--out", out)
    assert again == 1
    assert "--overwrite replaces it" in said
    assert run("flock", tmp_path / "t.csv", "--out", out, "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--radius", 0], "--radius 0: should be above 0"),
        (["--radius", 5, "--radius-diameters", 1], "give --radius or --radius-diameters"),
        (["--threshold", 4], "--threshold 4: should be above 0, up to pi"),
    ],
)
def test_options_that_cannot_be_are_refused(
    tmp_path: Path, options: list[object], message: str
) -> None:
    rows = rows_of(moving(GRID, lambda t: np.array([1.0, 0]), 3))
    write_trajectories(tmp_path / "t.csv", rows, {})
    code, said = run("flock", tmp_path / "t.csv", "--out", tmp_path / "out", *options)
    assert code == 1
    assert message in said
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_said_is_not_defined_with_the_reason(tmp_path: Path) -> None:
    one = rows_of(moving(GRID[:1], lambda t: np.array([1.0, 0]), 5))
    frame = rows_of(GRID[None])
    for name, rows in (("one droplet", one), ("one frame", frame)):
        write_trajectories(tmp_path / "t.csv", rows, {})
        code, said = run("flock", tmp_path / "t.csv", "--out", tmp_path / name)
        assert code == 0, said
        assert "Traceback" not in said
        found = json.loads((tmp_path / name / "flock.json").read_text())
        assert found["share"] is None
        assert "neighbour" in found["not_defined"]["share"]
        assert found["n_pairs"] == 0
        assert found["n_excluded"] == len(rows)
    (tmp_path / "none.csv").write_text("frame,track_id,x,y,w,h,score,observed\n")
    code, said = run("flock", tmp_path / "none.csv", "--out", tmp_path / "none")
    assert (code, said.strip().splitlines()[-1].endswith("has no droplets")) == (1, True)


def test_formats_without_sizes_need_a_radius_in_px(tmp_path: Path) -> None:
    lines = ["x,y,frame,particle"]
    lines += [f"{10 + t},{5 * k},{t},{k}" for t in range(4) for k in range(3)]
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    code, said = run("flock", tmp_path / "t.csv", "--out", tmp_path / "a")
    assert code == 1
    assert "give --radius, in px" in said
    assert run("flock", tmp_path / "t.csv", "--out", tmp_path / "a", "--radius", 6)[0] == 0
