"""Readers of tables and texts, fed with anything: they read it, or refuse it in one line."""

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("hypothesis", reason="needs the extra [dev]")
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from droptrack.data.darknet_dataset import read_labels
from droptrack.data.mot_files import open_detections, read_frame_list
from droptrack.data.region import Region
from droptrack.data.trajectories import read_trajectories
from droptrack.data.units import parse_known_length, units_of
from droptrack.detection.scale import parse_diameter, parse_scale
from droptrack.errors import DroptrackError
from droptrack.studies.lists import read_list
from tests.studies.options import OPTIONS

QUICK = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
ODD = ["", " ", "nan", "-inf", "1e999", "9" * 30, "0x1", "1_0", "\u0663", "1,5", "#"]
NUMBERS = st.one_of(st.integers(-3, 12).map(str), st.floats().map(repr), st.sampled_from(ODD))
CELLS = st.one_of(NUMBERS, st.text(max_size=6), st.sampled_from(['"', '"a', "a.avi", "\0"]))
HEADS = {
    "trajectories.csv": "frame,track_id,x,y,w,h,score,observed",
    "list.csv": "video,fps,um_per_px,region,dark,size,diameter,sample",
}
READERS: dict[str, Callable[[Path], object]] = {
    "trajectories.csv": read_trajectories,
    "list.csv": lambda path: [
        OPTIONS.config(one.video, dict(one.options)) for one in read_list(path, OPTIONS)
    ],
    "detections.txt": lambda path: [len(found) for found, _ in open_detections(path)],
    "frames.txt": lambda path: read_frame_list(path).last,
    "labels.txt": read_labels,
}


def refused_or_read(read: Callable[[], object]) -> None:
    """Nothing but DroptrackError may come, in one line."""
    try:
        read()
    except DroptrackError as error:
        assert str(error)  # noqa: PT017


@pytest.mark.parametrize("name", READERS)
@QUICK
@given(data=st.data())
def test_any_table_is_read_or_refused(name: str, data: st.DataObject, tmp_path: Path) -> None:
    n = len(HEADS.get(name, "," * 6).split(","))
    row = st.one_of(st.lists(NUMBERS, min_size=n, max_size=n), st.lists(CELLS, max_size=n + 1)).map(
        ",".join
    )
    rows = data.draw(st.lists(row, max_size=6))
    about = data.draw(st.sampled_from([[], ["# um_per_px: 1"], ["#"], ["# video: 1.2.3 frames/s"]]))
    if name == "labels.txt":
        rows = [one.replace(",", " ") for one in rows]
    end = data.draw(st.sampled_from(["\n", "\r\n", "\r"]))
    text = end.join([*about, *[HEADS.get(name, "")] * (name in HEADS), *rows])
    path = tmp_path / name
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    refused_or_read(lambda: READERS[name](path))


@QUICK
@given(st.dictionaries(st.sampled_from(["um_per_px", "fps", "video"]), CELLS))
def test_any_units_of_a_table_are_read_or_refused(about: dict[str, str]) -> None:
    if "video" in about:
        about["video"] += " frames/s"
    refused_or_read(lambda: units_of(about))


@QUICK
@given(st.one_of(CELLS, st.lists(NUMBERS, max_size=6).map(",".join), st.lists(CELLS).map("-".join)))
def test_any_scale_diameter_and_length_are_positive_or_refused(text: str) -> None:
    for parse in (parse_scale, parse_diameter, parse_known_length):
        try:
            found = parse(text)
        except DroptrackError:
            continue
        values = found if isinstance(found, tuple) else (found,)
        assert found == "auto" or all(0 < v < math.inf for v in values if isinstance(v, float))


@QUICK
@given(
    st.lists(st.tuples(st.floats(-1e12, 1e12), st.floats(-1e12, 1e12)), min_size=1, max_size=5),
    st.sampled_from([" ", ";", "", "\n"]),
)
def test_any_polygon_has_its_pixels_or_is_refused(
    corners: list[tuple[float, float]], between: str
) -> None:
    text = between.join(f"{x:.3f},{y:.3f}" for x, y in corners)
    refused_or_read(lambda: Region.read(text, 30, 20))


@QUICK
@given(st.floats(-1e7, 10), st.floats(20, 1e7), st.floats(-1e7, 5), st.floats(10, 1e7))
def test_a_rectangle_has_the_pixels_whose_centres_lie_in_it(
    left: float, right: float, top: float, bottom: float
) -> None:
    """However far it reaches beyond the frame; centres near its edge are not judged."""
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    text = " ".join(f"{x:.3f},{y:.3f}" for x, y in corners)
    try:
        mask = Region.read(text, 30, 20).mask
    except DroptrackError as error:
        assert "too far" in str(error)  # noqa: PT017
        return
    x, y = np.meshgrid(np.arange(30) + 0.5, np.arange(20) + 0.5)
    depth = np.min([x - left, right - x, y - top, bottom - y], axis=0)
    assert mask[depth > 0.6].all()
    assert not mask[depth < -0.6].any()


@QUICK
@given(content=st.binary(max_size=200), in_png=st.booleans())
def test_any_image_of_a_region_is_read_or_refused(
    content: bytes, in_png: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "region.png"
    if in_png:
        whole = cv2.imencode(".png", np.full((20, 30), 255, np.uint8))[1].tobytes()
        content = whole[:20] + content + whole[20 + len(content) // 2 :]
    path.write_bytes(content)
    refused_or_read(lambda: Region.read(str(path), 30, 20))


@QUICK
@given(
    rows=st.lists(
        st.tuples(st.integers(0, 99), *[st.floats(-1e6, 1e6)] * 2, *[st.floats(0, 1e4)] * 2),
        unique_by=lambda row: row[0],
    ),
    mark=st.booleans(),
)
def test_a_good_table_is_read_as_it_is(
    rows: list[tuple[int, float, float, float, float]], mark: bool, tmp_path: Path
) -> None:
    """In any order of its rows, with or without a mark before it; sorted by their frames."""
    path = tmp_path / "t.csv"
    lines = [f"{f},7,{x!r},{y!r},{w!r},{h!r},0.5,1" for f, x, y, w, h in rows]
    text = "\n".join([HEADS["trajectories.csv"], *lines]) + "\n"
    path.write_text(text, encoding="utf-8-sig" if mark else "utf-8")
    found, _ = read_trajectories(path)
    expected = np.array(sorted(rows)).reshape(-1, 5)
    assert (found.frame == expected[:, 0]).all()
    assert (np.column_stack([found.x, found.y, found.boxes[:, 2:]]) == expected[:, 1:]).all()


def test_what_was_found_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text('video,fps\n"a.avi,25\n')
    with pytest.raises(DroptrackError, match="cannot be read as a table"):
        read_list(path, OPTIONS)
    with pytest.raises(DroptrackError, match="a corner is too far away"):
        Region.read("0,0 0,20 134217724,20", 30, 20)
    table = tmp_path / "t.csv"
    table.write_text(HEADS["trajectories.csv"] + "\n\n# nothing\n")
    assert len(read_trajectories(table)[0]) == 0
    empty = tmp_path / "mask.png"
    empty.touch()
    with pytest.raises(DroptrackError, match="cannot be decoded"):
        Region.read(str(empty), 30, 20)
    assert units_of({"video": "at 1.2.3 frames/s"}).fps is None
    assert units_of({"video": "v.avi, 3 x 4 px, 29.97 frames/s"}).fps == 29.97
