"""Sizes, passages, tails and turns: hand counts, closed forms, and powerlaw."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.analysis.flow.report import FlowConfig, analyse_flow
from droptrack.analysis.flow.tails import fit_tail
from droptrack.analysis.records import Chart, Quantity
from droptrack.analysis.size.report import SizeConfig, analyse_size
from droptrack.data.arrays import Floats
from droptrack.data.formats.table import Table
from droptrack.data.trajectories import write_trajectories
from tests.analysis.drawings import moving, rows_of

ABOUT = {"video": "v.avi, 400 x 200 px, 100 frames/s", "um per px": "2"}


def flow(places: Floats, **options: str | float) -> dict[str, Quantity]:
    table = Table(rows=rows_of(places), about=ABOUT)
    found = analyse_flow(table, FlowConfig(**options))  # type: ignore[arg-type]
    return {one.stem: one for one in found.quantities}


def train(starts: NDArray[np.floating[Any]], n_frames: int = 100) -> Floats:
    """Droplets on a line along y = 100 that go 2 px a frame to the right, from x (N,)."""
    places = np.column_stack([starts, np.full(len(starts), 100.0)])
    return moving(places, lambda t: np.array([2.0, 0.0]), n_frames)


def test_a_regular_train_passes_at_its_rate() -> None:
    """Ten droplets 16 px apart, 2 px a frame: one in 8 frames."""
    found = flow(train(20.0 + 16 * np.arange(10)), line="171,200,171,0", region="181,0,221,200")
    assert found["mean_interval"].value == pytest.approx(8)
    assert found["interval_irregularity"].value == pytest.approx(0, abs=1e-6)
    assert found["flow_rate"].value == pytest.approx(10 / 100)
    assert found["area_flow_rate"].value == pytest.approx(10 * np.pi * 25 / 100)
    assert found["n_clogs"].value == 0
    assert found["residence"].value == pytest.approx(20)  # of 40 px
    assert found["residence"].null == pytest.approx(20)
    assert math.isnan(found["interval_tail_exponent"].value)
    assert "needs 50 intervals" in found["interval_tail_exponent"].reason


def test_a_clog_is_seen_and_its_time() -> None:
    """Eleven droplets 4 frames apart, then one that comes 80 frames later."""
    starts = np.append(60.0 - 8 * np.arange(11), 60.0 - 8 * 10 - 160)
    found = flow(train(starts, 200), line="91,200,91,0")
    assert found["n_clogs"].value == 1
    assert found["longest_interval"].value == pytest.approx(80)
    assert found["clogged_share"].value == pytest.approx(80 / 120)
    mean = 120 / 11
    limit = 10 * 4
    expected = (1 + limit / mean) * math.exp(-limit / mean)
    assert found["clogged_share"].null == pytest.approx(expected)
    assert flow(train(starts, 200), line="91,200,91,0", clog_frames=100.0)["n_clogs"].value == 0


def test_droplets_that_turn_back_are_taken_off() -> None:
    places = train(np.array([20.0, 60.0]), 60)
    places[:, 0, 0] = 100 - np.abs(100 - places[:, 0, 0])  # to 100 and back
    found = flow(places, line="90,200,90,0")
    assert found["flow_rate"].value == pytest.approx((1 + 1 - 1) / 60)


@pytest.mark.filterwarnings("ignore")  # of powerlaw itself
def test_the_tail_is_found_as_powerlaw_finds_it() -> None:
    powerlaw = pytest.importorskip("powerlaw")
    rng = np.random.default_rng(1)
    body, tail = rng.uniform(1, 5, 300), 5 * (rng.pareto(1.3, 500) + 1)
    values = np.concatenate([body, tail])
    ours = fit_tail(values)
    assert ours is not None
    theirs = powerlaw.Fit(values, discrete=False, verbose=False)
    assert ours.exponent == pytest.approx(theirs.power_law.alpha, rel=0.02)
    assert ours.least == pytest.approx(theirs.xmin, rel=0.05)
    assert abs(ours.exponent - 2.3) < 3 * ours.error
    ratio, p = theirs.distribution_compare("power_law", "exponential")
    assert ours.likelihood == pytest.approx(ratio, rel=0.1)
    assert ours.p == pytest.approx(p, abs=0.01)


def test_an_exponential_tail_is_not_taken_for_a_power_law() -> None:
    ours = fit_tail(np.random.default_rng(2).exponential(10, 3000) + 0.1)
    assert ours is not None
    assert ours.exponent > 3.5 or ours.likelihood < 0
    assert fit_tail(np.full(100, 3.0)) is None
    assert fit_tail(np.arange(1.0, 40)) is None


def turning(n: int, rate: float, n_frames: int) -> Floats:
    phases = np.arange(n) * 2 * np.pi / max(n, 2) + rate * np.arange(n_frames)[:, None]
    return 100 + 40 * np.stack([np.cos(phases), np.sin(phases)], axis=-1)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_cores_turn_in_their_period(n: int) -> None:
    """0.05 rad a frame, clockwise as one sees it: y points down; 126 frames a turn."""
    centre = {"centre": "100,100"} if n == 1 else {}
    found = flow(turning(n, 0.05, 200), **centre)
    assert found["circulation_period"].value == pytest.approx(2 * np.pi / 0.05)
    assert found["angular_velocity_rad"].value == pytest.approx(0.05)
    assert found["angular_velocity_rad"].null == pytest.approx(0.05 / np.sqrt(199))
    assert flow(turning(n, -0.05, 200), **centre)["angular_velocity_rad"].value < 0
    short = flow(turning(n, 0.005, 20), **centre)["circulation_period"]
    assert math.isnan(short.value)
    assert "of a turn" in short.reason


def test_a_drift_of_the_whole_does_not_turn_it() -> None:
    places = turning(4, 0.05, 200) + np.arange(200)[:, None, None] * [0.5, 0.2]
    assert flow(places)["circulation_period"].value == pytest.approx(2 * np.pi / 0.05)


def test_the_numbers_of_the_flow_are_in_si_units() -> None:
    """2 px a frame = 400 um/s; Ca = 0.1 * 4e-4 / 0.005; Re = 1000 * 4e-4 * 20e-6 / 0.1."""
    places = train(np.arange(5) * 20.0 + 10)
    found = flow(places, viscosity=0.1, tension=0.005, density=1000.0)
    assert found["capillary_number"].value == pytest.approx(0.008)
    assert found["reynolds_number"].value == pytest.approx(8e-5)
    assert flow(places)["capillary_number"].reason == "give --viscosity and --tension"
    plain = analyse_flow(Table(rows=rows_of(places)), FlowConfig(viscosity=0.1, tension=0.005))
    (one,) = (one for one in plain.quantities if one.stem == "capillary_number")
    assert "--um-per-px, --fps" in one.reason


def test_sizes_of_two_kinds_of_droplets() -> None:
    """10 and 20 px, half each: D_32 = 9000 / 500 = 18; standard deviation by n - 1."""
    diameters = np.repeat([10.0, 20.0], 8)
    places = np.repeat((np.arange(32.0).reshape(1, 16, 2) * 12), 5, axis=0)
    found = analyse_size(Table(rows=rows_of(places, diameters)), SizeConfig())
    values = {one.stem: one for one in found.quantities}
    assert values["mean_diameter"].value == pytest.approx(15)
    assert values["mean_diameter"].error == pytest.approx(5 / 4, rel=0.15)
    assert values["polydispersity"].value == pytest.approx(np.std(diameters, ddof=1) / 15)
    assert values["polydispersity"].null == 0
    assert values["sauter_diameter"].value == pytest.approx(18)
    assert values["stretch_x"].value == 0
    assert "no deformations" in values["deformation"].reason
    one = analyse_size(Table(rows=rows_of(places[:, :1])), SizeConfig())
    (spread,) = (one for one in one.quantities if one.stem == "polydispersity")
    assert math.isnan(spread.value)
    assert spread.reason == "one droplet has no spread of sizes"


def test_boxes_stand_for_sizes_only_where_a_droplet_has_no_others_and_that_is_said() -> None:
    """Boxes of 12 px: one droplet measured as 10 px in every second frame, the other never."""
    rows = rows_of(np.repeat(np.arange(4.0).reshape(1, 2, 2) * 30, 6, axis=0), np.full(2, 12.0))
    first = rows.track_id == rows.track_id[0]
    measured = np.where(first & (rows.frame % 2 == 0), 10.0, np.nan)
    found = analyse_size(Table(rows=replace(rows, columns={"diameter_px": measured})), SizeConfig())
    values = {one.stem: one.value for one in found.quantities}
    assert values["mean_diameter"] == pytest.approx((10 + 12) / 2)
    assert len(found.notes) == 1
    assert found.notes[0].startswith("6 of 9 sizes are those of boxes")
    only = analyse_size(
        Table(rows=replace(rows, columns={"diameter_px": np.full(len(first), 10.0)})), SizeConfig()
    )
    assert not only.notes


def test_deformation_is_taken_from_the_axes_where_only_these_are_known() -> None:
    """3 to 1 and 1 to 1, as often; a chart of one curve says of what it is."""
    rows = rows_of(np.repeat(np.arange(8.0).reshape(1, 4, 2) * 30, 2, axis=0))
    major = np.where(rows.frame == 0, 15.0, 10.0)
    axes = {"major_px": major, "minor_px": np.where(rows.frame == 0, 5.0, 10.0)}
    found = analyse_size(Table(rows=replace(rows, columns=axes)), SizeConfig())
    values = {one.stem: one.value for one in found.quantities}
    assert values["deformation"] == pytest.approx((0.5 + 0) / 2)
    labels = {one.name: one.y.label for one in found.figures if isinstance(one, Chart)}
    assert labels["deformation_x"] == "deformation"
    plain = analyse_size(Table(rows=rows), SizeConfig())
    labels = {one.name: one.y.label for one in plain.figures if isinstance(one, Chart)}
    assert labels["deformation_x"] == "Stretch of the boxes along x"


def test_noise_of_the_measurement_is_told_from_differences() -> None:
    rng = np.random.default_rng(3)
    rows = rows_of(np.repeat(rng.uniform(0, 300, (1, 200, 2)), 16, axis=0))
    measured = rng.normal(10, 0.8, len(rows))
    rows = type(rows)(**{**vars(rows), "columns": {"diameter_px": measured}})
    (one,) = (
        one
        for one in analyse_size(Table(rows=rows), SizeConfig()).quantities
        if one.stem == "polydispersity"
    )
    # medians of 16 scatter by sqrt(pi / 2) more than means
    assert one.value == pytest.approx(0.08 / 4 * 1.22, rel=0.2)
    assert one.null == pytest.approx(0.08 / 4, rel=0.1)


def test_the_commands_write_their_pages(tmp_path: Path) -> None:
    write_trajectories(tmp_path / "t.csv", rows_of(train(np.arange(8) * 16.0 + 10)), ABOUT)
    options = ["--line", "120,200,120,0", "--region", "130,0,160,200"]
    for name, more in (("flow", options), ("size", [])):
        arguments = ["analyse", name, str(tmp_path / "t.csv"), "--out", str(tmp_path)]
        result = CliRunner().invoke(app, [*arguments, *more])
        assert result.exit_code == 0, result.output
        assert (tmp_path / f"{name}.html").exists()
    found = json.loads((tmp_path / "flow.json").read_text())
    assert found["mean_interval_frames"] == pytest.approx(8)
    assert found["mean_interval_s"] == pytest.approx(0.08)
    assert found["mean_speed_um_per_s"] == pytest.approx(400)
    header = (tmp_path / "flow_passages.csv").read_text().splitlines()[0]
    assert header.startswith("track_id,frame,x,y,forward")
    assert json.loads((tmp_path / "size.json").read_text())["mean_diameter_um"] == 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--line", "1,2,3"], "--line 1,2,3: should be X1,Y1,X2,Y2"),
        (["--region", "500,0,600,100"], "lies outside the image, 400 x 200 px"),
        (["--centre", "middle"], "--centre middle: should be X,Y"),
        (["--viscosity", "-1"], "--viscosity -1: should be above 0"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, options: list[str], message: str) -> None:
    write_trajectories(tmp_path / "t.csv", rows_of(train(np.array([10.0]))), ABOUT)
    arguments = ["analyse", "flow", str(tmp_path / "t.csv"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*arguments, *options])
    assert result.exit_code == 1
    assert message in result.output


def test_one_frame_has_no_flow_and_says_why() -> None:
    for one in flow(train(np.array([10.0, 30.0]), 1), line="20,200,20,0").values():
        assert math.isfinite(one.value) or one.reason, one.stem
    nothing = flow(train(np.array([10.0, 30.0]), 5), line="300,200,300,0")
    assert nothing["flow_rate"].value == 0
    assert "fewer than two droplets" in nothing["mean_interval"].reason
