"""Outlines beside dirt and walls: droplets keep their sizes, or have none, hollow ones too."""

import cv2
import numpy as np
import pytest

from droptrack.data.arrays import Floats, Pixels
from droptrack.data.frames import grey_frame
from droptrack.measurement.droplets import Measured, measure_droplets
from droptrack.measurement.rays import ANGLES
from droptrack.measurement.shapes import COLUMNS, smooth_outlines

FINE = 8  # drawn so many times larger, then made smaller


def diameter(found: Measured) -> float:
    return float(found.shapes[0, COLUMNS.index("diameter_px")])


def drawn(*shapes: tuple[Floats, int], ground: int = 0) -> Pixels:
    """Polygons of a level each, on 200 x 160 px, anti-aliased."""
    canvas = np.full((160 * FINE, 200 * FINE), ground, np.uint8)
    for points, level in shapes:
        cv2.fillPoly(canvas, [np.round(points * FINE).astype(np.int32)], level)
    return np.asarray(cv2.resize(canvas, (200, 160), interpolation=cv2.INTER_AREA), np.uint8)


def disc(x: float, y: float, radius: float) -> Floats:
    angles = np.arange(720) * (np.pi / 360)
    return np.array([x, y]) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize("width", [2, 4, 6])
def test_a_hair_on_a_droplet_does_not_count(width: float) -> None:
    """A disc of 30 px from which a hair leads to the image's edge."""
    low, high = 80 - width / 2, 80 + width / 2
    hair = np.array([[100, low], [200, low], [200, high], [100, high]])
    image = drawn((disc(100, 80, 30), 220), (hair, 220))
    found = measure_droplets(grey_frame(image), np.array([[100.5, 79.5, 61, 59]]))
    assert diameter(found) == pytest.approx(60, rel=0.01)


def test_a_droplet_half_of_whose_outline_is_another_things_has_no_size() -> None:
    """A disc of 30 px that melts into a bar 110 px wide behind it."""
    bar = np.array([[100.0, 25], [200, 25], [200, 135], [100, 135]])
    image = drawn((disc(100, 80, 30), 220), (bar, 220))
    found = measure_droplets(grey_frame(image), np.array([[100.0, 80, 60, 60]]))
    assert np.isnan(diameter(found))
    np.testing.assert_array_equal(found.boxes, [[100, 80, 60, 60]])


def test_a_hollow_droplet_keeps_its_size() -> None:
    """Two discs of 30 px, 36 px apart, are one droplet with two waists: by the lens they share."""
    image = drawn((disc(82, 80, 30), 220), (disc(118, 80, 30), 220))
    found = measure_droplets(grey_frame(image), np.array([[100.0, 80, 97, 60]]))
    lens = 2 * 30**2 * np.arccos(36 / 60) - 18 * np.sqrt(4 * 30**2 - 36**2)
    area = 2 * np.pi * 30**2 - lens
    assert diameter(found) == pytest.approx(2 * np.sqrt(area / np.pi), rel=0.01)


def test_a_rectangle_keeps_its_corners() -> None:
    """As a plug with square ends: corners stick out, but it bends inwards nowhere."""
    half = np.array([60.0, 25.0])
    with np.errstate(divide="ignore"):
        sides = half / np.abs(np.column_stack([np.cos(ANGLES), np.sin(ANGLES)]))
    radii = sides.min(axis=1)[None]
    left, whole, good, bent = smooth_outlines(radii)
    np.testing.assert_array_equal(left, radii)
    np.testing.assert_array_equal(whole, radii)
    assert good.all()
    assert not bent.any()


@pytest.mark.parametrize("aspect", [1.0, 2.0, 4.0])
def test_single_edges_that_are_off_are_bridged(aspect: float) -> None:
    """One in eight edges of an ellipse lies half as far again, or two thirds as far."""
    a, b = 20 * np.sqrt(aspect), 20 / np.sqrt(aspect)
    smooth = a * b / np.hypot(b * np.cos(ANGLES), a * np.sin(ANGLES))
    rough = smooth.copy()
    rough[4::16] *= 1.5
    rough[12::16] /= 1.5
    left, whole, good, bent = smooth_outlines(rough[None])
    assert good.all()
    assert bent.all()
    assert np.isnan(left[0, 4::8]).all()
    np.testing.assert_allclose(whole[0], smooth, rtol=0.12)
    assert (whole**2).sum() == pytest.approx((smooth**2).sum(), rel=0.02)
