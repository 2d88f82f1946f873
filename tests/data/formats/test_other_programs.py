"""Files that other programs' own readers take."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from droptrack.data.trajectories import (
    write_trajectories,
)
from tests.data.formats.conversions import ABOUT, convert, refused, three_droplets, with_columns


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


def test_pytrackmate_reads_the_full_model(ours: Path) -> None:
    """It wants of each spot all that is declared, so that unknown sizes are there, as NaN."""
    reader = pytest.importorskip("pytrackmate")
    out = ours.parent / "model.xml"
    convert(ours, out)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = reader.trackmate_peak_import(out, get_tracks=True).sort_values("spot_id")
    expected = three_droplets()
    assert read["x"].tolist() == pytest.approx((expected.x - 0.5) * 0.5)
    assert read["t_stamp"].tolist() == expected.frame.tolist()
    in_tracks = expected.track_id != 4  # a droplet seen once is in no track
    found = read["label"].to_numpy()
    assert all(len(set(found[expected.track_id == one])) == 1 for one in (1, 2))
    assert len(set(found[in_tracks])) == 2


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
