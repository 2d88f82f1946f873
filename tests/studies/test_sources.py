"""What patterns, folders and files stand for, and what their results are called."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from droptrack.errors import DroptrackError
from droptrack.studies.lists import Entry
from droptrack.studies.names import name_videos
from droptrack.studies.sources import find_videos
from tests.studies.options import OPTIONS


def found(*sources: Path | str) -> tuple[list[str], list[str]]:
    """The videos that sources stand for, and what is said."""
    said: list[str] = []
    entries = find_videos([str(one) for one in sources], OPTIONS, said.append)
    return [entry.video for entry in entries], said


def test_folders_and_patterns_stand_for_the_videos_in_them(tmp_path: Path) -> None:
    for name in ("b.avi", "a.MP4", "deep/c.cine", ".hidden.avi", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "images").mkdir()
    for t in range(2):
        cv2.imwrite(str(tmp_path / "images" / f"{t}.png"), np.zeros((20, 20), np.uint8))
    videos, said = found(tmp_path)
    assert videos == [str(tmp_path / name) for name in ("a.MP4", "b.avi", "images")]
    assert said == [f"{tmp_path}: left out, as no videos by their names: notes.txt"]
    assert found(tmp_path / "images")[0] == [str(tmp_path / "images")]
    assert found(tmp_path / "**" / "*.cine")[0] == [str(tmp_path / "deep" / "c.cine")]
    again, said = found(tmp_path / "b.avi", tmp_path / "*.avi")
    assert again == [str(tmp_path / "b.avi")]
    assert said == [f"1 video is named more than once, and done once: {tmp_path / 'b.avi'}"]


def test_single_tiffs_are_the_images_of_a_video_and_stacks_are_videos(tmp_path: Path) -> None:
    for folder, shape in (("images", (20, 30)), ("stacks", (3, 20, 30))):
        (tmp_path / folder).mkdir()
        for k in range(2):
            tifffile.imwrite(
                tmp_path / folder / f"{k}.tif", np.zeros(shape, np.uint8), photometric="minisblack"
            )
    assert found(tmp_path / "images")[0] == [str(tmp_path / "images")]
    assert found(tmp_path / "stacks")[0] == [str(tmp_path / "stacks" / f"{k}.tif") for k in (0, 1)]
    assert found(tmp_path / "s*" / "*.tif")[0] == found(tmp_path / "stacks")[0]


def test_where_there_is_no_video_it_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.txt").touch()
    with pytest.raises(DroptrackError, match="has no video and no folder of images"):
        found(tmp_path)
    with pytest.raises(DroptrackError, match=r"\*.avi: matches no video"):
        found(tmp_path / "*.avi")
    with pytest.raises(DroptrackError, match="no such video, folder, pattern or list"):
        found(tmp_path / "none.avi")
    with pytest.raises(DroptrackError, match="is live; a batch takes files: droptrack track rtsp"):
        found("rtsp://camera/*")


def test_one_video_with_two_sets_of_options_needs_two_names(tmp_path: Path) -> None:
    (tmp_path / "a.avi").touch()
    path = tmp_path / "list.csv"
    path.write_text("video,score\na.avi,0.3\na.avi,0.5\n")
    with pytest.raises(
        DroptrackError, match=r"line 3: .*a.avi was in .*line 2 already, with other"
    ):
        found(path)
    path.write_text("video,score,name\na.avi,0.3,low\na.avi,0.5,high\n")
    entries = find_videos([str(path)], OPTIONS, print)
    assert name_videos(entries, {}) == ["low", "high"]


def names(*videos: str, before: dict[str, str] | None = None) -> list[str]:
    return name_videos([Entry(video=video, where="") for video in videos], before or {})


def test_names_are_short_and_never_clash() -> None:
    assert names("/d/a.avi", "/d/b.avi") == ["a", "b"]
    assert names("/d/mon/a.avi", "/d/tue/a.avi", "/d/b.avi") == ["mon_a", "tue_a", "b"]
    assert names("/d/a.avi", "/d/a.mp4") == ["a_avi", "a_mp4"]
    assert names("/x/d/a.avi", "/y/d/a.avi") == ["x_d_a", "y_d_a"]
    assert names("/d/mon/A.avi", "/d/tue/a.avi") == ["mon_A", "tue_a"]  # one file on a Mac
    assert names("/d/trajectories.avi") == ["trajectories_avi"]  # the data set's folder
    assert names("s3://lab/mon/a.avi", "s3://lab/tue/a.avi") == ["mon_a", "tue_a"]
    assert len(set(names("/d/a.avi", "/d/b/a.avi", "/d/b_a.avi", "/b/a.avi"))) == 4


def test_a_video_keeps_its_name_when_others_come() -> None:
    assert names("/d/mon/a.avi") == ["a"]
    before = {"/d/mon/a.avi": "a"}
    assert names("/d/mon/a.avi", "/d/tue/a.avi", before=before) == ["a", "a_avi"]
    assert names("/d/tue/a.avi", before=before) == ["a_avi"]  # not the folder of the other one


def test_names_in_lists_are_those_of_folders() -> None:
    for name in ("a/b", "..", "Trajectories"):
        with pytest.raises(DroptrackError, match="is no name for a folder"):
            name_videos([Entry(video="a.avi", where="list.csv: line 2", name=name)], {})
    twice = [Entry(video=f"{k}.avi", where=f"line {k}", name="one") for k in (2, 3)]
    with pytest.raises(DroptrackError, match="line 3: name 'one': line 2 has it already"):
        name_videos(twice, {})
