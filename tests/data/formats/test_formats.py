"""Formats, each read by the program's own library where there is one in Python, and back."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.formats.cvat import key_frames
from droptrack.data.trajectories import (
    Trajectories,
    read_trajectories,
    sorted_trajectories,
    write_trajectories,
)

ABOUT = {"video": "video.avi, 640 x 480 px, 25 frames/s", "um per px": "0.5"}


def three_droplets() -> Trajectories:
    """Tracks 1, 2 and 4: ten frames on a line, frames 2 to 6 with a bridged gap, and one frame."""
    rows = []
    for t in range(10):
        rows.append([t, 1, 100.25 + 5 * t, 50.5, 101 + 5 * t, 50.0, 20, 22, 0.9, 1, 19.5])
        if 2 <= t <= 6:
            rows.append([t, 2, 300.0, 60 + t * t, 300, 60 + t * t, 30, 30, 0.8, t != 4, np.nan])
    rows.append([9, 4, 10.0, 400, 10, 400, 12, 12, 0.7, 1, 11.5])
    table = np.array(rows, float)
    return sorted_trajectories(
        frame=table[:, 0].astype(np.int64),
        track_id=table[:, 1].astype(np.int64),
        x=table[:, 2],
        y=table[:, 3],
        boxes=table[:, 4:8],
        scores=table[:, 8],
        observed=table[:, 9].astype(bool),
        columns={"diameter_px": table[:, 10], "area_px2": np.pi / 4 * table[:, 10] ** 2},
    )


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    path = tmp_path / "trajectories.csv"
    write_trajectories(path, three_droplets(), ABOUT)
    return path


def convert(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["convert", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["convert", *map(str, arguments)])
    assert result.exit_code == 1
    assert result.output.count("\n") == 1, result.output
    return result.output


def back(path: Path, *options: object) -> tuple[Trajectories, dict[str, str]]:
    home = path.parent / "home.csv"
    convert(path, home, *options)
    return read_trajectories(home)


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


def test_trackpy_takes_the_table(ours: Path) -> None:
    pandas, trackpy = pytest.importorskip("pandas"), pytest.importorskip("trackpy")
    out = ours.parent / "trackpy.csv"
    convert(ours, out, "--to", "trackpy")
    assert out.read_text().startswith("frame,particle,x,y,")
    table = pandas.read_csv(out)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        speed = trackpy.motion.compute_drift(table[table.particle == 1])
        msd = trackpy.imsd(table, mpp=1, fps=1, max_lagtime=3)
    assert speed["x"].tolist() == pytest.approx([5.0 * t for t in range(1, 10)])
    assert msd[1].iloc[1] == pytest.approx(100)


def test_geff_s_own_reader_of_trackmate_finds_the_tracks(ours: Path) -> None:
    """The full model, as the importer of the GEFF library takes it."""
    pytest.importorskip("lxml")
    trackmate = pytest.importorskip("geff.convert._trackmate_xml")
    core_io = pytest.importorskip("geff.core_io")
    out, graph = ours.parent / "model.xml", ours.parent / "model.geff"
    convert(ours, out)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trackmate.from_trackmate_xml_to_geff(out, graph)
        read = core_io.read_to_memory(graph)
    nodes = {name: one["values"] for name, one in read["node_props"].items()}
    assert len(read["node_ids"]) == 16
    assert len(read["edge_ids"]) == 9 + 4
    expected = three_droplets()
    order = np.argsort(read["node_ids"])
    np.testing.assert_allclose(nodes["POSITION_X"][order], (expected.x - 0.5) * 0.5)
    np.testing.assert_allclose(nodes["POSITION_T"][order], expected.frame / 25)
    radii = np.where(expected.track_id == 2, 30, expected.columns["diameter_px"]) / 4
    np.testing.assert_allclose(nodes["RADIUS"][order], radii)
    assert {str(axis.unit) for axis in read["metadata"].axes} == {"micron", "sec"}


def test_geff_validates_and_knows_axes_and_units(ours: Path) -> None:
    geff = pytest.importorskip("geff")
    out = ours.parent / "t.geff"
    convert(ours, out)
    geff.validate_structure(out)
    metadata = geff.GeffMetadata.read(out)
    axes = {axis.name: axis for axis in metadata.axes}
    assert [axes[name].unit for name in "tyx"] == ["frame", "pixel", "pixel"]
    assert (axes["x"].scale, axes["x"].scaled_unit) == (0.5, "micrometer")
    assert (axes["t"].scale, axes["t"].scaled_unit) == (0.04, "second")
    assert "is there already" in refused(ours, out)


def test_trackeval_finds_a_perfect_result(ours: Path) -> None:
    """Files in the folders of the MOT Challenge, read by TrackEval's own reader."""
    trackeval = pytest.importorskip("trackeval")
    gt, results = ours.parent / "gt", ours.parent / "trackers" / "droptrack" / "data"
    (gt / "s" / "gt").mkdir(parents=True)
    results.mkdir(parents=True)
    (gt / "s" / "seqinfo.ini").write_text("[Sequence]\nname=s\nseqLength=10\n")
    convert(ours, gt / "s" / "gt" / "gt.txt", "--to", "mot-truth")
    convert(ours, results / "s.txt", "--to", "mot")
    settings = {
        **{"GT_FOLDER": str(gt), "TRACKERS_FOLDER": str(ours.parent / "trackers")},
        **{"SEQ_INFO": {"s": None}, "SKIP_SPLIT_FOL": True, "PRINT_CONFIG": False},
    }
    dataset = trackeval.datasets.MotChallenge2DBox(settings)
    data = dataset.get_preprocessed_seq_data(
        dataset.get_raw_seq_data("droptrack", "s"), "pedestrian"
    )
    assert (data["num_gt_dets"], data["num_gt_ids"], data["num_timesteps"]) == (16, 3, 10)
    clear = trackeval.metrics.CLEAR({"PRINT_CONFIG": False}).eval_sequence(data)
    identity = trackeval.metrics.Identity({"PRINT_CONFIG": False}).eval_sequence(data)
    assert (clear["MOTA"], clear["IDSW"], identity["IDF1"]) == (1, 0, 1)


def test_pycocotools_loads_images_and_boxes(ours: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco")
    out = ours.parent / "t.json"
    convert(ours, out)
    read = coco.COCO(str(out))
    assert (len(read.imgs), len(read.anns)) == (10, 16)
    first = read.loadAnns(read.getAnnIds(imgIds=[1]))[0]
    assert first["bbox"] == [91, 39, 20, 22]
    assert first["area"] == pytest.approx(np.pi / 4 * 19.5**2)
    assert (read.imgs[1]["width"], read.imgs[1]["height"]) == (640, 480)


def test_darknet_labels_of_chosen_frames_are_shares_of_the_image(ours: Path) -> None:
    out = ours.parent / "labels"
    convert(ours, out, "--to", "darknet", "--frames", "0,4")
    assert sorted(path.name for path in out.iterdir()) == ["000000.txt", "000004.txt"]
    line = (out / "000000.txt").read_text()
    assert line == f"0 {101 / 640:.6f} {50 / 480:.6f} {20 / 640:.6f} {22 / 480:.6f}\n"
    assert len((out / "000004.txt").read_text().splitlines()) == 2


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


def with_columns(**columns: np.ndarray) -> Trajectories:
    rows = three_droplets()
    whole = (rows.frame, rows.track_id, rows.x, rows.y, rows.boxes, rows.scores, rows.observed)
    return sorted_trajectories(*whole, columns)


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


def test_parents_are_edges_of_the_graph(tmp_path: Path) -> None:
    """Droplet 4 came of 1 and 2: from their last nodes to its first."""
    pytest.importorskip("geff")
    core_io = pytest.importorskip("geff.core_io")
    of_4 = three_droplets().track_id == 4
    rows = with_columns(parent_id=np.where(of_4, 1, 0), parent_id_2=np.where(of_4, 2, 0))
    path, out = tmp_path / "born.csv", tmp_path / "born.geff"
    write_trajectories(path, rows, ABOUT)
    convert(path, out)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = core_io.read_to_memory(out)
    edges = {tuple(pair) for pair in np.asarray(read["edge_ids"]).tolist()}
    assert len(edges) == 9 + 4 + 2
    child = int(np.flatnonzero(of_4)[0])
    last = [int(np.flatnonzero(rows.track_id == k)[-1]) for k in (1, 2)]
    assert {pair for pair in edges if pair[1] == child} == {(one, child) for one in last}


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
