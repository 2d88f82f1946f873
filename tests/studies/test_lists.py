"""Lists of videos as people write them, and as spreadsheets do."""

from pathlib import Path

import pytest

from droptrack.errors import DroptrackError
from droptrack.pipeline.config import TrackingConfig
from droptrack.studies.lists import Entry, read_list
from droptrack.studies.options import merged
from droptrack.tracking.choice import TrackerName
from tests.studies.options import OPTIONS


def listed(folder: Path, text: str | bytes) -> list[Entry]:
    path = folder / "list.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_list(path, OPTIONS)


def config(entry: Entry, **common: tuple[str, ...] | bool) -> TrackingConfig:
    return OPTIONS.config(entry.video, merged(common, entry.options))


def refused(folder: Path, text: str) -> str:
    with pytest.raises(DroptrackError) as caught:
        [config(entry) for entry in listed(folder, text)]
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_list_gives_options_and_columns_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "a.avi").touch()
    first, second = listed(
        tmp_path,
        "video,fps,um_per_px,region,dark,sample,flow rate\n"
        'a.avi,500,0.65,"0,0 90,0 90,80",yes,oil 7,1.5\n'
        "/data/b.avi,,,,no,,2\n",
    )
    one = config(first)
    assert one.video == str(tmp_path / "a.avi")
    assert (one.units.fps, one.units.um_per_px, one.dark) == (500, 0.65, True)
    assert one.region == "0,0 90,0 90,80"
    assert dict(first.free) == {"sample": "oil 7", "flow rate": "1.5"}
    other = config(second, dark=True)
    assert (other.video, other.dark, other.units.fps) == ("/data/b.avi", False, None)


def test_spreadsheets_put_a_mark_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    """As Excel saves a list where one writes 0,65; a polygon keeps its commas."""
    text = (
        "\ufeffvideo;fps;um_per_px;region;pressure;note;;\r\n"
        "b.avi;1000,5;0,65;1,2 30,2 30,40;0,21;a,b;;\r\n;;;;;;;\r\n"
    )
    (entry,) = listed(tmp_path, text)
    one = config(entry)
    assert (one.units.fps, one.units.um_per_px) == (1000.5, 0.65)
    assert one.region == "1,2 30,2 30,40"
    assert dict(entry.free) == {"pressure": "0.21", "note": "a,b"}


def test_every_kind_of_option_can_stand_in_a_list(tmp_path: Path) -> None:
    (entry,) = listed(
        tmp_path,
        "video\tscore\tlevels\tno_video\tshape\ttracker\tappearance_size\texpect-velocity\tline\n"
        "b.tif\t0.5\t100 4000\t1\tno\tdroplet\t\t24,-1.5\t1,0,1,9 5,0,5,9\n",
    )
    one = config(entry)
    assert (one.score, one.reading.levels, one.annotated_video) == (0.5, (100.0, 4000.0), False)
    assert (one.shape, one.tracker.name) == (False, TrackerName.droplet)
    assert one.tracker.expect_velocity == (24.0, -1.5)
    assert one.events is not None
    assert one.events.lines == ("1,0,1,9", "5,0,5,9")


def test_a_videos_own_scale_takes_the_place_of_the_one_for_all(tmp_path: Path) -> None:
    first, second = listed(
        tmp_path, 'video,known_length,diameter\na.avi,"0,0,100,0,50",\nb.avi,,30\n'
    )
    assert config(first, um_per_px=("0.65",)).units.um_per_px == 0.5
    assert config(second, um_per_px=("0.65",), scale=("2",)).diameter_px == 30
    assert config(second, um_per_px=("0.65",), scale=("2",)).scale is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("video\n", "names no video, only columns"),
        ("file,fps\na.avi,3\n", "has no column 'video', only file, fps"),
        ("video,fps,fps\na.avi,3,4\n", "has two columns 'fps'"),
        ("video,um_per_pix\na.avi,3\n", "'um_per_pix': is no option; is um_per_px meant?"),
        ("video,--speed\na.avi,3\n", "'--speed': is no option that single videos have"),
        ("video,out\na.avi,x\n", "'out': is no option that single videos have"),
        ("video,track_id\na.avi,3\n", "'track_id': the results have one of this name; rename it"),
        ("video,dark\na.avi,maybe\n", "line 2: dark 'maybe': should be yes or no"),
        ("video,fps\n\na.avi,fast\n", "Invalid value for '--fps'"),
        ("video,nn_budget\na.avi,3\n", "--nn-budget is of --tracker deepsort"),
        ("video,fps\na.avi,3,more\n", "line 2 has 3 cells, the first one 2"),
        ("video,fps\n,3\n", "line 2: names no video"),
    ],
)
def test_what_is_wrong_in_a_list_is_said_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    assert said in refused(tmp_path, text)
