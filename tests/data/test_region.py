"""Regions of interest: polygons and masks."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from droptrack.data.region import Region
from droptrack.errors import DroptrackError


def test_a_polygon_has_the_pixels_within_its_corners() -> None:
    """A triangle of legs 40 and 20 px: half of their product in area, and half a
    pixel more along the border of 105 px."""
    region = Region.read("10,10 50,10 10,30", 100, 60)
    assert region.mask.shape == (60, 100)
    assert region.mask.sum() == pytest.approx(400 + 52, abs=30)
    points = np.array([[12.0, 12.0], [45.0, 28.0], [9.0, 12.0], [-5.0, 12.0], [12.0, 70.0]])
    assert region.contains(points).tolist() == [True, False, False, False, False]


def test_a_mask_is_an_image_of_the_frames_size(tmp_path: Path) -> None:
    mask = np.zeros((40, 60), np.uint8)
    mask[10:20, 30:] = 255
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), mask)
    region = Region.read(str(path), 60, 40)
    np.testing.assert_array_equal(region.mask, mask > 0)
    with pytest.raises(DroptrackError, match=r"is 60 x 40 px, the frames 80 x 40 px"):
        Region.read(str(path), 80, 40)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("10,10 50,10", "at least three corners"),
        ("200,200 300,200 300,300", "no pixel of the 100 x 60 px frames"),
        ("no_such_mask.png", "neither a polygon"),
        ("10,10 20,20 x", "neither a polygon"),
    ],
)
def test_what_is_no_region_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(DroptrackError, match=message):
        Region.read(text, 100, 60)


def test_a_file_that_is_no_image_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mask.png"
    path.write_bytes(b"no image")
    with pytest.raises(DroptrackError, match="cannot be decoded"):
        Region.read(str(path), 100, 60)
