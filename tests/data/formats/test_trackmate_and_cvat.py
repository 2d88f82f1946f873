"""Files of TrackMate and CVAT, as these programs write and read them."""

from pathlib import Path

import numpy as np
import pytest

from droptrack.data.formats.cvat import key_frames
from droptrack.data.trajectories import (
    read_trajectories,
    write_trajectories,
)
from tests.data.formats.conversions import ABOUT, back, convert, three_droplets, with_columns


def test_trackmate_s_csv_has_its_four_lines(ours: Path) -> None:
    """As files of TrackMate 7 have them."""
    out = ours.parent / "spots.csv"
    convert(ours, out, "--to", "trackmate-csv")
    assert out.read_text().splitlines()[:5] == [
        "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS,VISIBILITY",
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius,Visibility",
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R,Visibility",
        ",,,(quality),(micron),(micron),(micron),(sec),,(micron),",
        "ID0,0,0,0.9,49.875,25.0,0.0,0.0,0,4.875,1",
    ]


def test_features_are_declared_as_trackmate_declares_them(ours: Path) -> None:
    """Feature, name, short name, dimension, isint: as in a file that TrackMate 7.11 wrote."""
    defused = pytest.importorskip("defusedxml.ElementTree")
    out = ours.parent / "model.xml"
    convert(ours, out)
    root = defused.parse(out).getroot()
    names = ("feature", "name", "shortname", "dimension", "isint")
    declared = {tuple(one.attrib[name] for name in names) for one in root.iter("Feature")}
    assert declared == {
        ("QUALITY", "Quality", "Quality", "QUALITY", "false"),
        ("POSITION_X", "X", "X", "POSITION", "false"),
        ("POSITION_Y", "Y", "Y", "POSITION", "false"),
        ("POSITION_Z", "Z", "Z", "POSITION", "false"),
        ("POSITION_T", "T", "T", "TIME", "false"),
        ("FRAME", "Frame", "Frame", "NONE", "true"),
        ("RADIUS", "Radius", "R", "LENGTH", "false"),
        ("VISIBILITY", "Visibility", "Visibility", "NONE", "true"),
        ("AREA", "Area", "Area", "AREA", "false"),
        ("SPOT_SOURCE_ID", "Source spot ID", "Source ID", "NONE", "true"),
        ("SPOT_TARGET_ID", "Target spot ID", "Target ID", "NONE", "true"),
        ("LINK_COST", "Edge cost", "Cost", "COST", "false"),
        ("TRACK_INDEX", "Track index", "Index", "NONE", "true"),
        ("TRACK_ID", "Track ID", "ID", "NONE", "true"),
        ("NUMBER_SPOTS", "Number of spots in track", "N spots", "NONE", "true"),
    }
    settings = root.find("Settings")
    assert [one.tag for one in settings] == [
        *("ImageData", "BasicSettings", "DetectorSettings", "InitialSpotFilter"),
        *("SpotFilterCollection", "TrackerSettings", "TrackFilterCollection"),
        "AnalyzerCollection",
    ]
    image = settings.find("ImageData").attrib
    assert {name: image[name] for name in ("width", "height", "nframes", "pixelwidth")} == {
        **{"width": "640", "height": "480", "nframes": "10", "pixelwidth": "0.5"}
    }
    assert float(image["timeinterval"]) == 0.04
    assert settings.find("BasicSettings").attrib["xend"] == "639"


def test_areas_come_home_from_trackmate_and_what_does_not_is_said(ours: Path) -> None:
    pytest.importorskip("defusedxml")
    out = ours.parent / "model.xml"
    convert(ours, out)
    text = out.read_text().replace('<Spot ID="0"', '<Spot SNR_CH1="2.5" ID="0"')
    out.write_text(text)
    assert "left out of spots: SNR_CH1" in convert(out, ours.parent / "home.csv")
    rows, _ = read_trajectories(ours.parent / "home.csv")
    expected = three_droplets()
    expected = expected[expected.track_id != 4]
    np.testing.assert_allclose(
        rows.columns["area_px2"], expected.columns["area_px2"], rtol=1e-6, equal_nan=True
    )
    assert np.isnan(rows.columns["area_px2"]).sum() == 5


def test_classes_come_home_from_cvat(tmp_path: Path) -> None:
    """A droplet's label is the class that it has in most frames."""
    pytest.importorskip("defusedxml")
    ids = np.array([0, 7, 3])[np.searchsorted([1, 2, 4], three_droplets().track_id)]
    seen = ids.copy()
    seen[0] = 7  # of droplet 1, in one frame
    names = np.array(["empty", "", "", "debris", "", "", "", "one cell"])
    path, out = tmp_path / "classes.csv", tmp_path / "cvat.xml"
    rows = with_columns(class_id=seen, class_name=names[seen])
    write_trajectories(path, rows, ABOUT)
    assert "cannot hold # lines, scores" not in convert(path, tmp_path / "t.csv")
    assert "classes of single frames" in convert(path, out, "--to", "cvat")
    found, _ = back(out)
    assert found.columns["class_name"].tolist() == names[ids].tolist()
    assert np.unique(found.columns["class_id"]).tolist() == [0, 1, 2]  # in the task's order


def test_a_table_that_trackmate_wrote_is_read(tmp_path: Path) -> None:
    """Its columns and lines are those of a real export; one spot is in no track."""
    path = tmp_path / "export.csv"
    path.write_text(
        "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS,"
        "VISIBILITY,MANUAL_SPOT_COLOR,MEAN_INTENSITY_CH1\n"
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius,Visibility,Manual spot color,Mean\n"
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R,Visibility,Spot color,Mean ch1\n"
        ",,,(quality),(pixel),(pixel),(pixel),(frame),,(pixel),,,(counts)\n"
        "ID77827,77827,1,3.3,1323.25,1057.5,0.0,497.0,497,5.0,1,,135.8\n"
        "ID77828,77828,1,3.4,1324.25,1058.5,0.0,498.0,498,5.0,1,,135.8\n"
        "ID77829,77829,,3.4,1.25,1.5,0.0,498.0,498,5.0,1,,135.8\n"
    )
    home = tmp_path / "home.csv"
    said = convert(path, home)
    assert "1 spots in no track left out" in said
    assert "columns left out: MANUAL_SPOT_COLOR, MEAN_INTENSITY_CH1" in said
    rows, _ = read_trajectories(home)
    assert rows.frame.tolist() == [497, 498]
    assert rows.track_id.tolist() == [2, 2]
    assert rows.x.tolist() == [1323.75, 1324.75]
    assert rows.boxes[0].tolist() == [1323.75, 1058, 10, 10]


def test_a_split_that_was_drawn_in_trackmate_becomes_a_parent_and_its_children(
    tmp_path: Path,
) -> None:
    pytest.importorskip("defusedxml")
    path = tmp_path / "split.xml"
    spots = {1: (0, 10), 2: (1, 12), 3: (2, 9), 4: (2, 16), 5: (3, 8), 6: (3, 18)}
    edges = [(1, 2), (2, 3), (2, 4), (3, 5), (4, 6)]
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?><TrackMate version="7.12.1">'
        '<Model spatialunits="micron" timeunits="sec"><AllSpots nspots="6">'
        + "".join(
            f'<SpotsInFrame frame="{t}"><Spot ID="{i}" name="ID{i}" QUALITY="1.0" POSITION_X="{x}" '
            f'POSITION_Y="5" POSITION_Z="0" POSITION_T="{t}" FRAME="{t}" RADIUS="2" '
            'VISIBILITY="1"/></SpotsInFrame>'
            for i, (t, x) in spots.items()
        )
        + '</AllSpots><AllTracks><Track name="Track_0" TRACK_ID="0">'
        + "".join(f'<Edge SPOT_SOURCE_ID="{a}" SPOT_TARGET_ID="{b}"/>' for a, b in edges)
        + '</Track></AllTracks><FilteredTracks><TrackID TRACK_ID="0"/></FilteredTracks></Model>'
        '<Settings><ImageData pixelwidth="2.0"/></Settings></TrackMate>'
    )
    rows, about = back(path)
    assert rows.track_id.tolist() == [1, 1, 2, 3, 2, 3]
    assert rows.columns["parent_id"].tolist() == [0, 0, 1, 1, 1, 1]
    assert rows.x.tolist() == [x / 2 + 0.5 for _, x in spots.values()]
    assert about["um per px"] == "2"


def test_key_frames_are_those_that_lines_need() -> None:
    """A path of two lines needs three, a parabola more; none is off by more than is allowed."""
    t = np.arange(21)
    corner = np.repeat(np.where(t < 8, 2.0 * t, 16 - (t - 8))[:, None], 4, axis=1)
    assert key_frames(t, corner, np.zeros(21, bool)).tolist() == [0, 8, 20]
    bend = np.repeat((0.1 * t**2)[:, None], 4, axis=1)
    kept = key_frames(t, bend, np.zeros(21, bool))
    assert 4 < len(kept) < 12
    assert np.abs(np.interp(t, kept, bend[kept, 0]) - bend[:, 0]).max() <= 0.25


def test_boxes_of_cvat_end_with_outside(ours: Path) -> None:
    defused = pytest.importorskip("defusedxml.ElementTree")
    out = ours.parent / "cvat.xml"
    convert(ours, out, "--to", "cvat")
    root = defused.parse(out).getroot()
    assert root.findtext("version") == "1.1"
    boxes = {track.attrib["id"]: track.findall("box") for track in root.iter("track")}
    assert [box.attrib["frame"] for box in boxes["1"]] == ["0", "9"]
    last = boxes["2"][-1].attrib
    assert (last["frame"], last["outside"]) == ("7", "1")
    assert all(box.attrib["keyframe"] == "1" for box in boxes["2"])
