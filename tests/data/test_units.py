"""Micrometres and seconds."""

import numpy as np
import pytest

from droptrack.data.units import Units, parse_known_length, scale_bar, units_of
from droptrack.errors import DroptrackError


def test_columns_have_their_fellows_in_other_units() -> None:
    """0.5 um a px, 200 frames/s: 3 px a frame are 300 um/s."""
    one = np.array([2.0])
    columns = {
        **{"frame": np.array([100]), "x": one, "track_id": np.array([1])},
        **{"area_px2": one, "velocity_y": np.array([3.0]), "deformation": one},
    }
    units = Units(um_per_px=0.5, fps=200)
    found = {name: column.tolist() for name, column in units.further(columns).items()}
    assert found == {
        "time_s": [0.5],
        "x_um": [1.0],
        "area_um2": [0.5],
        "velocity_y_um_per_s": [300.0],
    }
    assert units.names(columns) == tuple(found)
    assert Units(um_per_px=0.5).names(columns) == ("x_um", "area_um2")
    assert Units().names(columns) == ()


def test_what_a_file_says_is_understood() -> None:
    about = {"video": "a.avi, 640 x 480 px, 29.97 frames/s", "um per px": "0.65"}
    assert units_of(about) == Units(um_per_px=0.65, fps=29.97)
    assert units_of({**about, "frames per s": "2000"}).fps == 2000
    assert units_of({}) == Units()
    assert units_of(Units(um_per_px=0.1, fps=3).about()) == Units(um_per_px=0.1, fps=3)
    with pytest.raises(DroptrackError, match="should be a number"):
        units_of({"um per px": "half"})


@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf")])
def test_impossible_units_are_refused(value: float) -> None:
    with pytest.raises(DroptrackError, match="--um-per-px"):
        Units(um_per_px=value)
    with pytest.raises(DroptrackError, match="--fps"):
        Units(fps=value)


@pytest.mark.parametrize("text", ["1,2,1,2,9", "1,2,3,4,0", "1,2,3,4", "a", "1,2,nan,4,5"])
def test_a_length_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(DroptrackError, match="--known-length"):
        parse_known_length(text)


@pytest.mark.parametrize(("um", "width"), [(0.65, 1200), (3, 640), (0.02, 100), (120, 4000)])
def test_a_scale_bar_is_round_and_fits(um: float, width: int) -> None:
    length, px = scale_bar(um, width)
    assert f"{length:e}"[0] in "125"
    assert px == pytest.approx(length / um, abs=0.5)
    assert width / 10.1 <= px <= width / 4
