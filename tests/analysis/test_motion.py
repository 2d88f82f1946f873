"""Displacements and velocities: closed forms, trackpy, and least squares by NumPy."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.analysis.bootstrap import ratio
from droptrack.analysis.motion.displacements import lags_for, moments, van_hove
from droptrack.analysis.motion.non_affine import non_affine
from droptrack.analysis.motion.report import MotionConfig, analyse_motion
from droptrack.analysis.motion.velocities import autocorrelation, fluctuations, profile
from droptrack.analysis.neighbourhoods import close_pairs
from droptrack.analysis.paths import free_of_drift, paths_of
from droptrack.analysis.records import Chart, Quantity
from droptrack.data.arrays import Floats
from droptrack.data.formats.table import Table
from droptrack.data.trajectories import write_trajectories
from tests.analysis.drawings import hexagonal, moving, rows_of


def walks(n: int, n_frames: int, sigma: float, seed: int = 0) -> Floats:
    """Brownian walks (T, N, 2), steps of a standard deviation px along each axis."""
    rng = np.random.default_rng(seed)
    starts = rng.uniform(100, 400, (n, 2))
    return moving(starts, lambda _: rng.normal(0, sigma, (n, 2)), n_frames)


def found(places: Floats) -> dict[str, Quantity]:
    return {
        one.stem: one
        for one in analyse_motion(Table(rows=rows_of(places)), MotionConfig()).quantities
    }


def test_a_brownian_walk_has_exponent_1_within_its_error() -> None:
    quantities = found(walks(100, 200, 0.5))
    for stem in ("msd_exponent", "msd_exponent_drift_subtracted"):
        one = quantities[stem]
        assert abs(one.value - 1) < 4 * one.error
        assert one.error < 0.05
    # the fluctuation along each axis is that of the steps, of 19,900 each
    assert quantities["velocity_fluctuation_x"].value == pytest.approx(0.5, rel=0.03)
    assert abs(quantities["velocity_fluctuation_excess_kurtosis_x"].value) < 0.15
    assert quantities["velocity_correlation_time"].value < 1


def test_the_mean_square_displacement_of_a_walk_is_2_d_sigma_squared_lag() -> None:
    paths = paths_of(rows_of(walks(400, 100, 0.5)))
    lags = lags_for(paths.longest)
    of = moments(paths, paths.places, lags)
    mean = ratio(of.second, of.counts)
    short = lags <= 10
    assert mean[short] == pytest.approx(2 * 0.25 * lags[short], rel=0.05)
    # a Gaussian in two dimensions: <r⁴> = 2 <r²>²
    assert ratio(of.fourth, of.counts)[0] == pytest.approx(2 * mean[0] ** 2, rel=0.05)


@pytest.mark.filterwarnings("ignore:The inplace keyword")
def test_trackpy_finds_the_same_mean_square_displacement_and_drift() -> None:
    trackpy = pytest.importorskip("trackpy")
    places = walks(20, 60, 0.7) + np.arange(60)[:, None, None] * [0.3, -0.1]
    rows = rows_of(places)
    paths = paths_of(rows)
    lags = np.arange(1, 20)
    table = rows.to_pandas()
    for subtracted, of in ((False, paths.places), (True, free_of_drift(paths))):
        some = table
        if subtracted:
            some = trackpy.subtract_drift(table.copy().reset_index(drop=True))
        expected = trackpy.emsd(some.reset_index(drop=True), mpp=1, fps=1, max_lagtime=19)
        ours = moments(paths, of, lags)
        assert ratio(ours.second, ours.counts) == pytest.approx(expected.to_numpy(), rel=1e-9)


def test_gaps_leave_the_straight_way_as_it_is() -> None:
    places = moving(np.array([[50.0, 50], [80, 50]]), lambda t: np.array([2.0, 1.0]), 30)
    places[5:9, 0] = places[20, 1] = np.nan
    paths = paths_of(rows_of(places))
    lags = lags_for(30)
    of = moments(paths, paths.places, lags)
    assert ratio(of.second, of.counts) == pytest.approx(5.0 * lags**2)
    # lag 1 of droplet 1: 29 steps, less the five that begin or end in frames 5 to 8
    assert of.counts[:, 0].tolist() == [24, 27]
    assert np.nanmax(np.abs(free_of_drift(paths) - free_of_drift(paths)[0])[:5]) < 1e-9


def test_drift_is_not_lost_in_frames_without_any_droplet() -> None:
    places = moving(np.array([[50.0, 50], [80, 50]]), lambda t: np.array([2.0, 1.0]), 30)
    places[10:14] = np.nan
    paths = paths_of(rows_of(places))
    still = free_of_drift(paths)
    known = np.isfinite(still[:, 0])
    assert still[known] == pytest.approx(paths.places[np.where(paths.owners[known], 30, 0)])


def test_velocities_of_solid_rotation_correlate_as_the_cosine() -> None:
    """Frames of a turn by 0.1 rad; the speed grows with the distance from the centre."""
    rng = np.random.default_rng(3)
    radii, phases = rng.uniform(5, 50, 40), rng.uniform(0, 2 * np.pi, 40)
    angles = phases + 0.1 * np.arange(80)[:, None]
    places = 100 + radii[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    paths = paths_of(rows_of(places))
    lags = np.array([0, 1, 5, 10, 31])
    correlation = ratio(*autocorrelation(paths, paths.displacements(1), lags))
    assert correlation / correlation[0] == pytest.approx(np.cos(0.1 * lags), abs=1e-9)


def test_the_profile_of_a_channel_is_found_with_its_error() -> None:
    """Poiseuille's parabola and noise of steps of 0.2 px: 30 droplets a bin, 50 frames."""
    rng = np.random.default_rng(4)
    starts = np.column_stack([np.zeros(600), rng.uniform(0, 100, 600)])
    parabola = starts[:, 1] * (100 - starts[:, 1]) / 2500

    def velocity(_: int) -> Floats:
        return np.column_stack([parabola + rng.normal(0, 0.2, 600), np.zeros(600)])

    paths = paths_of(rows_of(moving(starts, velocity, 50)))
    of = profile(paths, paths.places[:, 1], paths.displacements(1)[:, 0])
    mean = ratio(of.sums, of.counts)
    # in a bin of width w the parabola's mean is that of the middle less w² / 12 / 2500
    expected = of.middles * (100 - of.middles) / 2500
    assert mean == pytest.approx(expected, abs=0.03)


def test_fluctuations_leave_the_mean_flow_of_a_place_out() -> None:
    rng = np.random.default_rng(5)
    starts = rng.uniform(0, 100, (500, 2))

    def velocity(_: int) -> Floats:
        return np.column_stack([np.full(500, 7.0), rng.normal(0, 0.3, 500)])

    paths = paths_of(rows_of(moving(starts, velocity, 20)))
    of = fluctuations(paths, paths.displacements(1))
    assert np.nanstd(of[:, 0]) < 1e-9
    assert np.sqrt(np.nanmean(of[:, 1] ** 2)) == pytest.approx(0.3, rel=0.03)


def test_the_van_hove_function_counts_every_displacement() -> None:
    paths = paths_of(rows_of(walks(50, 40, 1.0)))
    edges, counts, rms = van_hove(paths, paths.places, 4, 0)
    assert counts.sum() == 50 * 36
    assert rms == pytest.approx(2.0, rel=0.05)
    middles = (edges[1:] + edges[:-1]) / 2
    spread = np.sqrt((counts.sum(axis=0) @ middles**2) / counts.sum())
    assert spread == pytest.approx(rms, rel=0.02)


def test_non_affine_motion_is_what_least_squares_leave() -> None:
    rng = np.random.default_rng(6)
    before = rng.uniform(0, 100, (60, 2))
    after = before @ np.array([[1.1, 0.2], [-0.1, 0.9]]) + rng.normal(0, 1, (60, 2))
    after[7] = np.nan  # lost
    first, second = close_pairs(np.zeros(60, np.int64), before, 30.0)
    ours = non_affine(before, after, first, second)
    for k in (0, 7, 20, 59):
        near = np.flatnonzero(np.hypot(*(before - before[k]).T) <= 30)
        near = near[(near != k) & (near != 7)]
        if k == 7 or len(near) < 3:
            assert np.isnan(ours[k])
            continue
        r, moved = before[near] - before[k], after[near] - after[k]
        rest = np.linalg.lstsq(r, moved)[1]
        assert ours[k] == pytest.approx(rest.sum() / len(near))


def test_sheared_and_turned_lattices_have_none() -> None:
    lattice = hexagonal(10, 10, 10.0) + 50
    turned = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    pairs = close_pairs(np.zeros(100, np.int64), lattice, 15.0)
    for matrix in (turned, np.array([[1, 0], [0.5, 1]])):
        d2 = non_affine(lattice, lattice @ matrix + [5, 3], *pairs)
        assert np.nanmax(d2) < 1e-9
        assert np.isfinite(d2).sum() > 90


def test_the_command_carries_units_and_has_every_figure(tmp_path: Path) -> None:
    rows = rows_of(walks(30, 60, 0.5) + np.arange(60)[:, None, None] * [0.8, 0])
    about = {"video": "v.avi, 600 x 500 px, 100 frames/s", "um per px": "0.5"}
    write_trajectories(tmp_path / "t.csv", rows, about)
    out = tmp_path / "out"
    arguments = ["analyse", "motion", str(tmp_path / "t.csv"), "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    json_found = json.loads((out / "motion.json").read_text())
    in_px = json_found["mean_velocity_x_px_per_frame"]
    assert in_px == pytest.approx(0.8, abs=4 * json_found["mean_velocity_x_px_per_frame_error"])
    assert json_found["mean_velocity_x_um_per_s"] == pytest.approx(in_px * 50)
    header, first = (out / "motion_msd.csv").read_text().splitlines()[:2]
    assert header == "curve,lag_s,msd_um2,msd_um2_error"
    assert first.split(",")[1] == "0.01"
    page = (out / "motion.html").read_text()
    for name in ("msd", "van_hove_x", "velocity_autocorrelation", "velocity_profile_y", "d2min"):
        assert f'src="motion_{name}.png"' in page
        assert (out / f"motion_{name}.png").exists()


def test_jumps_through_the_walls_of_a_periodic_box_are_pointed_out() -> None:
    places = walks(5, 30, 0.5)
    places[15:, 2, 0] -= 390
    about = {"video": "v.avi, 500 x 500 px"}
    analysis = analyse_motion(Table(rows=rows_of(places), about=about), MotionConfig())
    assert "1 steps are longer than half the image" in analysis.notes[0]


@pytest.mark.parametrize("places", [np.full((1, 5, 2), 50.0), np.full((6, 1, 2), 50.0)])
def test_one_frame_and_one_droplet_at_rest_are_not_defined(places: Floats) -> None:
    places = places + np.arange(places.shape[1])[None, :, None] * 8
    analysis = analyse_motion(Table(rows=rows_of(places)), MotionConfig())
    for one in analysis.quantities:
        assert np.isfinite(one.value) or one.reason, one.stem
    for figure in analysis.figures:
        assert isinstance(figure, Chart)
