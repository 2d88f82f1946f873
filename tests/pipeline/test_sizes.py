"""Sizes and shapes in the tables of a run, against the truth of the paper's test video."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.scenes.shapes import draw_ellipses
from droptrack.__main__ import app
from droptrack.data.trajectories import read_trajectories
from droptrack.evaluation.trajectory_scores import match
from droptrack.measurement.shapes import COLUMNS

OPTIONS = ("--backend", "opencv", "--size", "640x320", "--no-video")


def test_tracks_have_the_diameters_of_their_discs(sine: Path, tmp_path: Path) -> None:
    """Through JPEG."""
    result = CliRunner().invoke(
        app, ["track", str(sine / "video.avi"), "--out", str(tmp_path), *OPTIONS]
    )
    assert result.exit_code == 0, result.output
    truth, _ = read_trajectories(sine / "truth.csv")
    found, _ = read_trajectories(tmp_path / "trajectories.csv")
    assert tuple(found.columns)[-len(COLUMNS) :] == COLUMNS
    pairs = match(truth, found)
    error = found.columns["diameter_px"][pairs.result] - truth.boxes[pairs.truth, 2]
    assert np.isfinite(error).all()
    assert np.sqrt((error**2).mean()) < 0.1
    np.testing.assert_allclose(found.boxes[pairs.result], truth.boxes[pairs.truth], atol=0.5)
    assert found.columns["deformation"][pairs.result].max() < 0.01
    assert set(np.unique(found.columns["at_edge"])) <= {0, 1}


def test_without_shape_there_are_no_such_columns(sine: Path, tmp_path: Path) -> None:
    arguments = [str(sine / "video.avi"), "--out", str(tmp_path), *OPTIONS, "--no-shape"]
    result = CliRunner().invoke(app, ["track", *arguments, "--max-frames", "5"])
    assert result.exit_code == 0, result.output
    found, _ = read_trajectories(tmp_path / "trajectories.csv")
    assert not set(COLUMNS) & set(found.columns)


@pytest.mark.parametrize("kind", ["track", "detect"])
def test_droplets_cut_by_the_edge_are_flagged(kind: str, tmp_path: Path) -> None:
    """A disc that leaves the image: flagged, without a size, and told where its centre is."""
    folder = tmp_path / "frames"
    folder.mkdir()
    places = 427.5 + 5 * np.arange(10)  # of 480 px: cut from 450 on
    for t, x in enumerate(places.tolist()):
        canvas = np.zeros((240, 480), np.uint8)
        draw_ellipses(canvas, np.array([[x, 120.4, 30, 30, 0], [90, 60, 25, 25, 0]]), 255)
        cv2.imwrite(str(folder / f"{t:03d}.png"), canvas)
    out, plain = tmp_path / "out", ("--no-video",) if kind == "track" else ("--no-images",)
    result = CliRunner().invoke(app, [kind, str(folder), "--out", str(out), *plain])
    assert result.exit_code == 0, result.output
    name = "trajectories.csv" if kind == "track" else "detections.csv"
    lines = (out / name).read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    header = lines[0].split(",")
    table = [dict(zip(header, line.split(","), strict=True)) for line in lines[1:]]
    leaving = [row for row in table if float(row["x"]) > 300]
    assert len(leaving) == 10
    assert [row["at_edge"] for row in leaving] == ["0"] * 5 + ["1"] * 5
    for row in leaving:
        cut = row["at_edge"] == "1"
        assert np.isnan(float(row["diameter_px"])) == cut
        assert (row["centre_of_mass"] == "0") == cut
    error = [abs(float(row["x"]) - x) for row, x in zip(leaving, places.tolist(), strict=True)]
    assert max(error) < 0.2
