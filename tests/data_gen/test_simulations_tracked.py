"""The paper's two flows at their small sizes, simulated and then tracked by the bundled model.

What docs/simulations.md says of longer and larger runs was measured in the same way.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from droptrack.data.trajectories import Trajectories, read_trajectories
from droptrack.evaluation.trajectory_scores import match, score_droplets
from droptrack.track import app as track

RUNNER = CliRunner()


def read(folder: Path) -> tuple[Trajectories, dict[str, NDArray[np.float64]]]:
    """The ground truth of a simulated flow and what was checked in each frame."""
    truth, _ = read_trajectories(folder / "truth.csv")
    with (folder / "checks.csv").open() as file:
        rows = list(csv.DictReader(file))
    return truth, {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def tracked(folder: Path, out: Path, truth: Trajectories) -> dict[str, float]:
    """How well `droptrack track` with its defaults tracks the droplets of the video."""
    arguments = [str(folder / "video.avi"), "--out", str(out), "--no-video"]
    result = RUNNER.invoke(track, arguments)
    assert result.exit_code == 0, result.output
    found, _ = read_trajectories(out / "trajectories.csv")
    matching = match(truth, found)
    droplets = score_droplets(truth, found, matching, float("nan"))
    return {
        "missed": sum(d.n_missed for d in droplets),
        "switches": sum(d.n_switches for d in droplets),
        "false": matching.n_false,
        "mse_y_px2": float(np.mean([d.mse_y_px2 for d in droplets])),
    }


def test_four_cores_turn_as_in_the_paper_and_are_tracked(four_cores: Path, tmp_path: Path) -> None:
    truth, checks = read(four_cores)
    x, y = truth.x.reshape(-1, 4), truth.y.reshape(-1, 4)
    middle = np.array([x.mean(axis=1), y.mean(axis=1)])[:, :, None]
    angle = np.unwrap(np.arctan2(y - middle[1], x - middle[0]), axis=0)  # y down: clockwise
    assert (np.diff(angle, axis=0) > 0).all()
    turned = np.degrees(angle[-1] - angle[0])
    assert turned.mean() == pytest.approx(35, abs=5)
    assert checks["pieces"].max() == 1
    assert checks["droplets"].min() == 4
    assert checks["mass_drift"].max() < 1e-11
    scores = tracked(four_cores, tmp_path / "tracks", truth)
    assert scores["missed"] == scores["switches"] == scores["false"] == 0
    assert scores["mse_y_px2"] < 0.002


def test_nineteen_droplets_pass_the_constriction_whole_and_are_tracked(
    nineteen_droplets: Path, tmp_path: Path
) -> None:
    truth, checks = read(nineteen_droplets)
    assert checks["through"][-1] == 19
    assert checks["pieces"].max() == 1
    assert checks["droplets"].min() == 19
    assert 0.9 < checks["density_min"].min() <= checks["density_max"].max() < 1.12
    assert checks["mass_drift"].max() < 1e-6
    scores = tracked(nineteen_droplets, tmp_path / "tracks", truth)
    assert scores["missed"] == scores["switches"] == 0
