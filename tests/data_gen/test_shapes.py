"""Shapes against an image made by counting 32 x 32 points in every pixel."""

import numpy as np
import pytest
from numpy.typing import NDArray

from data_gen.scenes.shapes import (
    BLACK,
    WHITE,
    contour_box,
    draw_contour,
    draw_ellipses,
    draw_polygon,
    ellipse_boxes,
)

Floats = NDArray[np.float64]


def counted_ellipse(ellipse: Floats, width: int, height: int, n: int = 32) -> Floats:
    """The covered fraction of every pixel, by counting points."""
    y, x = (np.mgrid[: height * n, : width * n] + 0.5) / n
    cx, cy, a, b, angle = ellipse
    u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
    v = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
    inside = (u / a) ** 2 + (v / b) ** 2 <= 1
    return np.asarray(inside.reshape(height, n, width, n).mean(axis=(1, 3)))


ELLIPSES = [
    pytest.param([20.3, 18.6, 12.0, 12.0, 0.0], id="disc"),
    pytest.param([22.7, 19.1, 14.0, 8.0, 0.6], id="ellipse"),
    pytest.param([20.0, 20.0, 17.0, 9.0, 2.5], id="ellipse on a pixel corner"),
]


@pytest.mark.parametrize("ellipse", ELLIPSES)
def test_drawn_ellipse_has_the_area_and_centre_of_the_exact_one(ellipse: list[float]) -> None:
    canvas = np.zeros((40, 44), np.uint8)
    draw_ellipses(canvas, np.array([ellipse]), WHITE)
    grey = canvas / 255
    cx, cy, a, b, _ = ellipse
    assert grey.sum() == pytest.approx(np.pi * a * b, rel=1e-3)
    assert (grey.sum(axis=0) @ (np.arange(44) + 0.5)) / grey.sum() == pytest.approx(cx, abs=0.003)
    assert (grey.sum(axis=1) @ (np.arange(40) + 0.5)) / grey.sum() == pytest.approx(cy, abs=0.003)


@pytest.mark.parametrize("ellipse", ELLIPSES)
def test_every_pixel_of_an_ellipse_is_covered_as_counting_says(ellipse: list[float]) -> None:
    canvas = np.zeros((40, 44), np.uint8)
    draw_ellipses(canvas, np.array([ellipse]), WHITE)
    counted = counted_ellipse(np.array(ellipse), 44, 40)
    assert np.abs(canvas / 255 - counted).max() < 0.05
    assert np.abs(canvas / 255 - counted).mean() < 0.002


@pytest.mark.parametrize("ellipse", ELLIPSES)
def test_box_of_an_ellipse_touches_its_outermost_points(ellipse: list[float]) -> None:
    cx, cy, a, b, angle = ellipse
    t = np.linspace(0, 2 * np.pi, 100_000)
    x = cx + a * np.cos(t) * np.cos(angle) - b * np.sin(t) * np.sin(angle)
    y = cy + a * np.cos(t) * np.sin(angle) + b * np.sin(t) * np.cos(angle)
    box = ellipse_boxes(np.array([ellipse]))[0]
    expected = [(x.max() + x.min()) / 2, (y.max() + y.min()) / 2, np.ptp(x), np.ptp(y)]
    np.testing.assert_allclose(box, expected, atol=1e-6)


def test_contour_of_constant_radius_is_the_disc() -> None:
    centre = np.array([21.4, 19.8])
    contour, disc = np.zeros((40, 44), np.uint8), np.zeros((40, 44), np.uint8)
    draw_contour(contour, centre, np.full(128, 13.0), WHITE)
    draw_ellipses(disc, np.array([[*centre, 13, 13, 0]]), WHITE)
    assert np.abs(contour.astype(int) - disc).max() <= 3
    np.testing.assert_allclose(contour_box(centre, np.full(128, 13.0)), [21.4, 19.8, 26, 26])


def test_contour_of_an_ellipse_is_the_ellipse() -> None:
    a, b, centre = 16.0, 9.0, np.array([20.5, 20.2])
    angles = np.arange(256) * 2 * np.pi / 256
    radii = a * b / np.hypot(b * np.cos(angles), a * np.sin(angles))
    canvas = np.zeros((40, 44), np.uint8)
    draw_contour(canvas, centre, radii, WHITE)
    counted = counted_ellipse(np.array([*centre, a, b, 0.0]), 44, 40)
    assert np.abs(canvas / 255 - counted).mean() < 0.002
    np.testing.assert_allclose(contour_box(centre, radii), [*centre, 32, 18], atol=0.01)


def test_polygon_of_an_ellipse_is_the_ellipse_also_where_the_image_ends() -> None:
    for cx in (20.5, 3.2):
        a, b, cy = 16.0, 9.0, 20.2
        t = np.arange(256) * 2 * np.pi / 256
        canvas = np.zeros((40, 44), np.uint8)
        draw_polygon(canvas, np.column_stack([cx + a * np.cos(t), cy + b * np.sin(t)]), WHITE)
        counted = counted_ellipse(np.array([cx, cy, a, b, 0.0]), 44, 40)
        assert np.abs(canvas / 255 - counted).max() < 0.13  # a place is 1/8 px wide
        assert np.abs(canvas / 255 - counted).mean() < 0.005


def test_black_is_drawn_over_white() -> None:
    canvas = np.full((40, 44), WHITE, np.uint8)
    draw_ellipses(canvas, np.array([[20.0, 20.0, 10.0, 10.0, 0.0]]), BLACK)
    assert (1 - canvas / 255).sum() == pytest.approx(np.pi * 100, rel=2e-3)


def test_shapes_beyond_the_image_are_cut_off() -> None:
    canvas = np.zeros((40, 44), np.uint8)
    draw_ellipses(canvas, np.array([[44.0, 20.0, 10, 10, 0], [200.0, -50, 10, 10, 0]]), WHITE)
    assert canvas.sum() / 255 == pytest.approx(np.pi * 100 / 2, rel=5e-3)
