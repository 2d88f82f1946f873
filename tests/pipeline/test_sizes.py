"""Sizes and shapes in the tables of a run, against the truth of the paper's test video."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from data_gen.scenes.shapes import draw_ellipses
from droptrack.__main__ import app
from droptrack.data.trajectories import read_trajectories
from droptrack.evaluation.trajectory_scores import match
from droptrack.measurement.shapes import COLUMNS
from droptrack.pipeline.drawing import draw_scale_bar

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


@pytest.mark.parametrize("kind", ["track", "detect"])
def test_droplets_cut_by_a_field_stop_are_flagged(kind: str, tmp_path: Path) -> None:
    """A disc of 25 px goes behind the border of the field, which is 390 px from the left there."""
    folder = tmp_path / "frames"
    folder.mkdir()
    rows, columns = np.mgrid[:320, :480] + 0.5
    outside = np.hypot(columns - 240, rows - 160) > 150
    places = 341.0 + 6 * np.arange(8)  # cut from 365 on
    for t, x in enumerate(places.tolist()):
        canvas = np.full((320, 480), 70, np.uint8)
        draw_ellipses(canvas, np.array([[x, 160.3, 25, 25, 0], [180.0, 120, 25, 25, 0]]), 220)
        canvas[outside] = 4
        cv2.imwrite(str(folder / f"{t:03d}.png"), canvas)
    out, plain = tmp_path / "out", ("--no-video",) if kind == "track" else ("--no-images",)
    result = CliRunner().invoke(app, [kind, str(folder), "--out", str(out), *plain])
    assert result.exit_code == 0, result.output
    name = "trajectories.csv" if kind == "track" else "detections.csv"
    lines = [line for line in (out / name).read_text().splitlines() if line[0] != "#"]
    header = lines[0].split(",")
    table = [dict(zip(header, line.split(","), strict=True)) for line in lines[1:]]
    leaving = [row for row in table if float(row["x"]) > 300]
    assert [row["at_edge"] for row in leaving] == ["0"] * 4 + ["1"] * 4
    assert {row["at_edge"] for row in table if float(row["x"]) < 300} == {"0"}
    error = [abs(float(row["x"]) - x) for row, x in zip(leaving, places.tolist(), strict=True)]
    assert max(error) < 0.5
    if kind == "track":
        assert "a round field stop, 300 px wide at 240, 160" in result.stderr


def test_columns_in_micrometres_and_seconds_stand_beside_the_pixels(
    sine: Path, tmp_path: Path
) -> None:
    """0.5 um a px; 25 frames/s are the file's: a step of 5 px in x is 62.5 um/s."""
    arguments = [str(sine / "video.avi"), "--out", str(tmp_path), *OPTIONS, "--max-frames", "8"]
    result = CliRunner().invoke(app, ["track", *arguments, "--known-length", "0,0,300,400,250"])
    assert result.exit_code == 0, result.output
    found, about = read_trajectories(tmp_path / "trajectories.csv")
    columns = found.columns
    assert (about["um per px"], about["frames per s"]) == ("0.5", "25")
    for name, expected in (
        ("x_um", found.x / 2),
        ("w_um", found.boxes[:, 2] / 2),
        ("diameter_um", columns["diameter_px"] / 2),
        ("area_um2", columns["area_px2"] / 4),
        ("time_s", found.frame / 25),
        ("velocity_x_um_per_s", columns["velocity_x"] * 12.5),
    ):
        np.testing.assert_allclose(columns[name], expected, atol=1e-5)
    assert columns["velocity_x_um_per_s"].mean() == pytest.approx(62.5, rel=0.01)
    report = json.loads((tmp_path / "report.json").read_text())
    first = report["droplets"][0]
    assert first["diameter_um"] == pytest.approx(first["diameter_px"] / 2)
    assert first["speed_um_per_s"] == pytest.approx(first["speed_px_per_frame"] * 12.5)


def stack_of(folder: Path, **about: object) -> Path:
    """Four frames of a disc that goes 5 px a frame, as ImageJ writes them: 0.5 um a px."""
    images = np.zeros((4, 240, 480), np.uint8)
    for t, canvas in enumerate(images):
        draw_ellipses(canvas, np.array([[200.0 + 5 * t, 120.4, 30, 30, 0]]), 255)
    path = folder / "stack.tif"
    metadata = {"axes": "TYX", "unit": "um", **about}
    tifffile.imwrite(path, images, imagej=True, resolution=(2, 2), metadata=metadata)
    return path


@pytest.mark.parametrize(
    ("about", "options", "um_per_px", "fps"),
    [
        ({"finterval": 0.002}, (), "0.5", "500"),
        ({}, (), "0.5", None),  # nobody says the rate
        ({"finterval": 0.002}, ("--um-per-px", "0.25"), "0.25", "500"),
        ({"finterval": 0.002}, ("--pixels-only",), None, None),
    ],
)
def test_a_pixels_size_is_what_the_file_says_unless_another_is_given(
    tmp_path: Path,
    about: dict[str, object],
    options: tuple[str, ...],
    um_per_px: str | None,
    fps: str | None,
) -> None:
    path, out = stack_of(tmp_path, **about), tmp_path / "out"
    arguments = ["track", str(path), "--out", str(out), *OPTIONS, *options]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert ("a pixel is 0.5 um wide, as the file says" in result.stderr) == (not options)
    found, said = read_trajectories(out / "trajectories.csv")
    assert (said.get("um per px"), said.get("frames per s")) == (um_per_px, fps)
    assert ("frames/s" in said["video"]) == ("finterval" in about)
    assert ("x_um" in found.columns) == (um_per_px is not None)
    assert ("velocity_x_um_per_s" in found.columns) == (fps is not None)
    if um_per_px is not None:
        np.testing.assert_allclose(found.columns["x_um"], found.x * float(um_per_px), atol=1e-5)


def test_a_pixels_size_and_none_contradict_each_other(tmp_path: Path) -> None:
    path = stack_of(tmp_path)
    arguments = ["track", str(path), "--out", str(tmp_path / "out"), "--pixels-only"]
    result = CliRunner().invoke(app, [*arguments, "--um-per-px", "2"])
    assert result.exit_code == 1
    assert "--pixels-only, not both" in result.stderr


def test_a_scale_bar_is_as_long_as_it_says() -> None:
    """0.65 um a px, 1200 px: 100 um are 154 px."""
    image = np.full((300, 1200, 3), 90, np.uint8)
    draw_scale_bar(image, 0.65)
    line = (image[288] == 255).all(axis=1)
    assert line.sum() == 154 + 1
    assert (image[250:280] != 90).any()
