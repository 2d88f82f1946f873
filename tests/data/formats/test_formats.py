"""Formats, each read by the program's own library where there is one in Python, and back."""

import json
from pathlib import Path

import numpy as np
import pytest

from droptrack.data.trajectories import (
    read_trajectories,
)
from tests.data.formats.conversions import (
    ABOUT,
    back,
    convert,
    refused,
    three_droplets,
)


@pytest.mark.parametrize("name", ["t.csv", "t.parquet", "t.geff", "trackpy", "napari"])
def test_everything_comes_home(name: str, ours: Path) -> None:
    if name == "t.parquet":
        pytest.importorskip("pyarrow")
    if name == "t.geff":
        pytest.importorskip("geff")
    out = ours.parent / name
    said = convert(ours, out, *([] if "." in name else ["--to", name]))
    assert ("cannot hold # lines\n" in said) == ("." not in name)
    assert ("cannot hold" in said) == ("." not in name)
    rows, about = back(out)
    expected = three_droplets()
    for field in ("frame", "track_id", "observed"):
        assert (getattr(rows, field) == getattr(expected, field)).all()
    for field in ("x", "y", "boxes", "scores"):
        np.testing.assert_allclose(getattr(rows, field), getattr(expected, field), atol=1e-6)
    for column in ("diameter_px", "area_px2"):
        np.testing.assert_allclose(rows.columns[column], expected.columns[column], atol=1e-6)
    if "." in name:
        assert about == ABOUT


@pytest.mark.parametrize(
    ("name", "to", "lost"),
    [
        (
            "t.xml",
            "trackmate-xml",
            "identities of droplets seen once, boxes, which rows are bridged gaps",
        ),
        ("t.xml", "trackmate-tracks", "boxes, scores, which rows are bridged gaps, diameter_px"),
        ("t.csv", "trackmate-csv", "boxes, which rows are bridged gaps, area_px2"),
        ("t.txt", "mot", "x, y (boxes' centres take their place), which rows are bridged gaps"),
        ("t.txt", "mot-truth", "scores, which rows are bridged gaps, diameter_px, area_px2"),
        ("t.xml", "cvat", "scores, diameter_px, area_px2"),
    ],
)
def test_what_comes_home_is_what_was_held_and_the_rest_is_said(
    name: str, to: str, lost: str, ours: Path
) -> None:
    if name.endswith("xml"):
        pytest.importorskip("defusedxml")
    out = ours.parent / ("out_" + name)
    assert f"cannot hold # lines, {lost}" in convert(ours, out, "--to", to).replace(
        "x, y (boxes' centres take their place), scores", "scores"
    )
    rows, _ = back(out, *(["--um-per-px", 0.5] if to.startswith("trackmate") else []))
    expected = three_droplets()
    if to == "trackmate-xml":  # a track of TrackMate has an edge
        expected = expected[expected.track_id != 4]
    if to in {"trackmate-tracks", "mot", "mot-truth", "cvat"}:
        assert len(np.unique(rows.track_id)) == 3
    else:
        assert (rows.track_id == expected.track_id).all()
    assert (rows.frame == expected.frame).all()
    if to.startswith("trackmate"):
        np.testing.assert_allclose(rows.x, expected.x, atol=1e-6)
        np.testing.assert_allclose(rows.y, expected.y, atol=1e-6)
    else:
        atol = 0.3 if to == "cvat" else 1e-5
        np.testing.assert_allclose(rows.boxes, expected.boxes, atol=atol)
    if to == "cvat":
        assert (rows.observed == expected.observed).all()


def test_files_of_newer_versions_are_refused(ours: Path) -> None:
    pytest.importorskip("defusedxml")
    folder = ours.parent
    (folder / "new.xml").write_text('<TrackMate version="9.1.0"><Model/></TrackMate>')
    (folder / "cvat.xml").write_text("<annotations><version>2.0</version></annotations>")
    out = folder / "out.csv"
    assert "is of TrackMate 9.1.0; files up to those of TrackMate 8" in refused(
        folder / "new.xml", out
    )
    assert "is CVAT for video 2.0; up to 1.1 is read" in refused(folder / "cvat.xml", out)
    pytest.importorskip("geff")
    graph = folder / "t.geff"
    convert(ours, graph)
    about = next(one for one in (graph / "zarr.json", graph / ".zattrs") if one.exists())
    text = about.read_text()
    version = json.loads(text)
    version = version.get("attributes", version)["geff"]["geff_version"]
    about.write_text(text.replace(f'"{version}"', '"99.0"'))
    assert f"{graph}: " in refused(graph, out)
    assert not out.exists()


def test_what_cannot_be_is_refused_in_one_line(ours: Path) -> None:
    folder = ours.parent
    bomb = folder / "bomb.xml"
    bomb.write_text('<!DOCTYPE a [<!ENTITY b "c">]><TrackMate>&b;</TrackMate>')
    (folder / "half.xml").write_text("<TrackMate><Model>")
    (folder / "other.xml").write_text("<html/>")
    (folder / "no.csv").write_text("a,b\n1,2\n")
    (folder / "det.txt").write_text("1,-1,5,5,5,5,1\n")
    (folder / "um.csv").write_text(
        "LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,FRAME\n,,,,,\n,,,,,\n,,,(micron),(micron),\n"
    )
    (folder / "far.xml").write_text(
        '<annotations><track id="0"><box frame="1e12" xtl="1" ytl="1" xbr="2" ybr="2"/></track>'
        "</annotations>"
    )
    (folder / "nan.xml").write_text(
        '<Tracks spaceUnits="pixel"><particle><detection t="0" x="nan" y="1"/></particle></Tracks>'
    )
    out = folder / "out.csv"
    assert "frames should be 0 to 10000000" in refused(folder / "far.xml", out)
    assert "should have a number x, not nan" in refused(folder / "nan.xml", out)
    assert "has a DTD" in refused(bomb, out)
    assert "cannot be read as XML" in refused(folder / "half.xml", out)
    assert "no file of TrackMate's" in refused(folder / "other.xml", out)
    assert "should have the columns" in refused(folder / "no.csv", out)
    assert "droptrack track --detections" in refused(folder / "det.txt", out)
    assert "give --um-per-px" in refused(folder / "um.csv", out)
    assert "no such file" in refused(folder / "missing.csv", out)
    assert "say what it is with --to" in refused(ours, folder / "out.doc")
    assert "would be overwritten" in refused(ours, ours)
    assert "should be above 0" in refused(ours, out, "--um-per-px", 0)
    assert "should be apart" in refused(ours, out, "--known-length", "1,1,1,1,5")
    assert "not both" in refused(ours, out, "--known-length", "1,1,3,1,5", "--um-per-px", 1)
    assert "there are no droplets" in refused(ours, out, "--frames", "77")
    assert "--frames" in refused(ours, out, "--frames", "a")
    assert "--size" in refused(ours, out, "--size", "640")
    assert "can be written, not read" in refused(ours, out, "--from", "coco")
    assert not out.exists()


def test_units_given_to_the_command_stay_in_the_file(ours: Path) -> None:
    out = ours.parent / "out.csv"
    convert(ours, out, "--known-length", "0,0,300,400,250", "--fps", 2000)
    _, about = read_trajectories(out)
    assert (about["um per px"], about["frames per s"]) == ("0.5", "2000")
    assert json.loads(json.dumps(about))["video"] == ABOUT["video"]


def test_columns_that_are_no_numbers_are_left_out_and_said(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path, home = tmp_path / "other.parquet", tmp_path / "home.csv"
    columns = {"frame": [0, 1], "track_id": [1, 1], "x": [1.0, 2], "y": [3.0, 4]}
    parquet.write_table(pyarrow.table({**columns, "who": ["a", "b"], "n": [5, 6]}), path)
    assert "column who is no numbers and is left out" in convert(path, home)
    rows, _ = read_trajectories(home)
    assert list(rows.columns) == ["n"]
    parquet.write_table(pyarrow.table({**columns, "x": ["a", "b"]}), path)
    assert "column x should be numbers" in refused(path, tmp_path / "two.csv")
