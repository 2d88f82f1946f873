"""Outlines as files: polygons on the edges of drawn ellipses, each with its droplet."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from data_gen.scenes.shapes import draw_ellipses
from droptrack.__main__ import app
from droptrack.data.trajectories import read_trajectories

ELLIPSES = np.array(
    [[300.25, 160.5, 34.0, 24.0, 0.4], [100.0, 90.0, 22.0, 22.0, 0.0], [478.0, 60.0, 22, 22, 0]]
)  # the last one is cut by the image
Points = NDArray[np.float64]


def run(*arguments: str) -> None:
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output


def area_and_centre(points: Points) -> tuple[float, Points]:
    """Of a polygon (K, 2), by the shoelace formula."""
    following = np.roll(points, -1, axis=0)
    cross = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
    area = cross.sum() / 2
    return abs(float(area)), ((points + following) * cross[:, None]).sum(axis=0) / (6 * area)


def off_ellipse(points: Points, ellipse: Points) -> Points:
    """How far points (K, 2) are from an ellipse x, y, a, b, angle, px, to first order."""
    x, y, a, b, angle = ellipse
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = (points - [x, y]) @ turn
    value = (place / [a, b]) ** 2
    slope = 2 * np.hypot(*(place / [a**2, b**2]).T)
    return np.asarray((value.sum(axis=1) - 1) / slope)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    folder = tmp_path / "frames"
    folder.mkdir()
    for t in range(6):
        canvas = np.zeros((240, 480), np.uint8)
        draw_ellipses(canvas, ELLIPSES + np.array([0, 2 * t, 0, 0, 0]), 255)
        cv2.imwrite(str(folder / f"{t:03d}.png"), canvas)
    return folder


def test_coco_has_the_polygons_of_an_image(frames: Path, tmp_path: Path) -> None:
    """Read with pycocotools; areas are those of ellipses, pi a b."""
    coco_tools = pytest.importorskip("pycocotools.coco")
    masks = pytest.importorskip("pycocotools.mask")
    out = tmp_path / "out"
    run("detect", str(frames / "000.png"), "--out", str(out), "--contours", "coco", "--no-images")
    content = json.loads((out / "contours.json").read_text())
    (image,) = content["images"]
    assert (image["file_name"], image["width"], image["height"]) == (
        *(str(frames / "000.png"), 480),
        240,
    )
    assert content["categories"] == [{"id": 1, "name": "droplet"}]
    read = coco_tools.COCO(out / "contours.json")
    rows = [line.split(",") for line in (out / "detections.csv").read_text().splitlines()[1:]]
    assert len(rows) == 3
    annotations = content["annotations"]
    assert [one["row"] for one in annotations] == [0, 1]  # from the left; the third is cut
    for one, ellipse in zip(annotations, ELLIPSES[[1, 0]], strict=True):
        points = np.reshape(one["segmentation"], (-1, 2))
        assert np.abs(off_ellipse(points, ellipse)).max() < 0.15
        assert one["area"] == pytest.approx(np.pi * ellipse[2] * ellipse[3], rel=3e-3)
        n_pixels = masks.area(read.annToRLE(one))
        assert n_pixels == pytest.approx(one["area"], rel=0.02)
        low, high = points.min(axis=0), points.max(axis=0)
        np.testing.assert_allclose(one["bbox"], [*low, *(high - low)], atol=0.2)
        assert float(rows[one["row"]][2]) == pytest.approx(ellipse[0], abs=0.05)


def test_a_video_has_an_outline_for_each_row_with_a_size(frames: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    out, plain = tmp_path / "out", tmp_path / "plain"
    run("track", str(frames), "--out", str(out), "--contours", "parquet", "--no-video")
    run("track", str(frames), "--out", str(plain), "--no-video")
    rows, _ = read_trajectories(out / "trajectories.csv")
    expected, _ = read_trajectories(plain / "trajectories.csv")
    assert list(rows.columns) == list(expected.columns)
    assert not list(plain.glob("contours*"))
    table = parquet.read_table(out / "contours.parquet")
    assert table.column_names == ["frame", "track_id", "x", "y"]
    assert b"droptrack.track" in table.schema.metadata[b"droptrack"]
    found = {
        (one["frame"], one["track_id"]): np.column_stack([one["x"], one["y"]])
        for one in table.to_pylist()
    }
    measured = rows[np.isfinite(rows.columns["area_px2"])]
    assert len(measured) == 2 * 6
    assert set(found) == set(zip(measured.frame.tolist(), measured.track_id.tolist(), strict=True))
    for i in range(len(measured)):
        points = found[int(measured.frame[i]), int(measured.track_id[i])]
        area, centre = area_and_centre(points)
        assert area == pytest.approx(measured.columns["area_px2"][i], rel=3e-3)
        np.testing.assert_allclose(centre, [measured.x[i], measured.y[i]], atol=0.05)


def test_outlines_are_not_to_be_had_without_shapes(frames: Path, tmp_path: Path) -> None:
    for command in ("track", "detect"):
        options = ("--out", str(tmp_path / "out"), "--contours", "coco", "--no-shape")
        done = CliRunner().invoke(app, [command, str(frames), *options])
        assert done.exit_code == 1
        assert "--contours coco: needs outlines, which --no-shape leaves out" in done.stderr
    assert not (tmp_path / "out").exists()
