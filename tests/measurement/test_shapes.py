"""Sizes and shapes of droplets drawn where, and as large as, the numbers say."""

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
import pytest
from numpy.typing import NDArray

from data_gen.scenes import scene_kinds
from data_gen.scenes.shapes import WHITE, draw_contour, draw_ellipses, ellipse_boxes
from droptrack.data.degradation import degrade
from droptrack.data.region import Region
from droptrack.measurement.droplets import Measured, at_edge, measure_droplets
from droptrack.measurement.shapes import COLUMNS

Floats = NDArray[np.float64]
Canvas = NDArray[np.uint8]

pytestmark = pytest.mark.usefixtures("implementation")


def column(found: Measured, name: str) -> Floats:
    return found.shapes[:, COLUMNS.index(name)]


def measure(canvas: Canvas, boxes: Floats) -> Measured:
    return measure_droplets(np.repeat(canvas[..., None], 3, axis=2), boxes)


def ellipses(rng: np.random.Generator, n: int, longest: float = 1.0) -> Floats:
    """Ellipses (n, 5) in a grid, as large as circles of 6 to 25 px."""
    places = np.column_stack([np.arange(n) % 6 * 90 + 60, np.arange(n) // 6 * 90 + 60])
    r, stretch = rng.uniform(6, 25, n), np.sqrt(rng.uniform(1, longest, n))
    where = places + rng.uniform(-1, 1, (n, 2))
    return np.column_stack([where, r * stretch, r / stretch, rng.uniform(0, np.pi, n)])


def shaken(rng: np.random.Generator, boxes: Floats) -> Floats:
    """Boxes as a network gives them: off by 4 % of their size."""
    return boxes + rng.normal(0, 0.04, boxes.shape) * boxes[:, [2, 3, 2, 3]]


def diameters(drawn: Floats) -> Floats:
    """Of the circles as large as ellipses (N, 5)."""
    return 2 * np.sqrt(drawn[:, 2] * drawn[:, 3])


@pytest.mark.parametrize(("ground", "level"), [(0, 255), (255, 0), (40, 90), (150, 110)])
@pytest.mark.parametrize("longest", [1.0, 2.33], ids=["discs", "ellipses"])
def test_filled_droplets_are_measured_to_a_tenth_of_a_pixel(
    ground: int, level: int, longest: float
) -> None:
    rng = np.random.default_rng(0)
    drawn = ellipses(rng, 36, longest)
    canvas = np.full((600, 600), ground, np.uint8)
    draw_ellipses(canvas, drawn, level)
    found = measure(canvas, shaken(rng, ellipse_boxes(drawn)))
    error = column(found, "diameter_px") - diameters(drawn)
    assert np.sqrt((error**2).mean()) < 0.05
    assert abs(error.mean()) < 0.0015 * diameters(drawn).mean()
    a, b = drawn[:, 2:4].T
    np.testing.assert_allclose(column(found, "deformation"), (a - b) / (a + b), atol=0.01)
    np.testing.assert_allclose(column(found, "major_px"), 2 * a, atol=0.25)
    np.testing.assert_allclose(column(found, "minor_px"), 2 * b, atol=0.25)
    np.testing.assert_allclose(found.boxes, ellipse_boxes(drawn), atol=0.3)
    np.testing.assert_allclose(found.centres, drawn[:, :2], atol=0.02)
    assert (column(found, "outline_seen") == 1).all()
    assert not column(found, "at_edge").any()
    turned = a / b > 1.2
    off = np.abs(column(found, "angle_rad") - drawn[:, 4])[turned] % np.pi
    assert np.minimum(off, np.pi - off).max(initial=0) < 0.05


def test_perimeter_and_circularity_of_an_ellipse_are_those_of_ramanujan() -> None:
    a, b = 40.0, 20.0
    canvas = np.zeros((120, 120), np.uint8)
    ellipse = np.array([[60.3, 59.6, a, b, 0.4]])
    draw_ellipses(canvas, ellipse, 255)
    found = measure(canvas, ellipse_boxes(ellipse))
    h = ((a - b) / (a + b)) ** 2
    perimeter = np.pi * (a + b) * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h)))
    assert column(found, "perimeter_px")[0] == pytest.approx(perimeter, rel=2e-3)
    circularity = 4 * np.pi * np.pi * a * b / perimeter**2
    assert column(found, "circularity")[0] == pytest.approx(circularity, rel=5e-3)


@pytest.mark.parametrize(
    ("ring", "inside"), [(20, 120), (30, 200), (230, 120), (60, 110)],
    ids=["dark", "dark round bright", "bright", "faint"],
)  # fmt: skip
def test_the_edge_of_a_ring_is_its_outside(ring: int, inside: int) -> None:
    """Rings 3 px wide on a ground of 120 grey levels."""
    rng = np.random.default_rng(1)
    drawn = ellipses(rng, 36, 1.5)
    canvas = np.full((600, 600), 120, np.uint8)
    draw_ellipses(canvas, drawn, ring)
    draw_ellipses(canvas, drawn - [0, 0, 3, 3, 0], inside)
    found = measure(canvas, shaken(rng, ellipse_boxes(drawn)))
    error = column(found, "diameter_px") - diameters(drawn)
    known = np.isfinite(error)
    assert known.sum() >= 34
    assert np.sqrt((error[known] ** 2).mean()) < 0.1
    a, b = drawn[known, 2:4].T
    deformation = column(found, "deformation")[known]
    assert np.sqrt(((deformation - (a - b) / (a + b)) ** 2).mean()) < 0.01
    assert found.measured[known].all()
    assert np.abs(found.centres[known] - drawn[known, :2]).max() < 0.25


@pytest.mark.parametrize("width", [1.0, 1.3, 1.6, 2.0])
@pytest.mark.parametrize(("ground", "ring", "inside"), [(120, 20, 125), (110, 230, 105)])
def test_the_outside_of_a_ring_too_thin_to_be_as_dark_as_drawn_is_told_from_its_width(
    width: float, ground: int, ring: int, inside: int
) -> None:
    """Half of its own height lies 0.04 px (2 px wide) to 0.27 px (1 px) too far outside."""
    rng = np.random.default_rng(4)
    drawn = ellipses(rng, 36, 2.33)
    canvas = np.full((600, 600), ground, np.uint8)
    draw_ellipses(canvas, drawn, ring)
    draw_ellipses(canvas, drawn - [0, 0, width, width, 0], inside)
    found = measure(canvas, shaken(rng, ellipse_boxes(drawn)))
    error = column(found, "diameter_px") - diameters(drawn)
    assert np.isfinite(error).sum() >= 34
    assert np.sqrt(np.nanmean(error**2)) < 0.12
    assert abs(np.nanmean(error)) < 0.05


@pytest.mark.parametrize("kind", ["a", "b", "c"])
def test_the_papers_scenes_are_measured_to_a_tenth_of_a_pixel(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shells, cores, and crowds 0 to 4 px apart; what was drawn is caught on its way."""
    drawn: list[Floats] = []
    draw = draw_ellipses

    def caught(canvas: Canvas, some: Floats, level: int) -> None:
        if level == WHITE:
            drawn.append(some)
        draw(canvas, some, level)

    monkeypatch.setattr(scene_kinds, "draw_ellipses", caught)
    errors = []
    for seed in range(6):
        rng = np.random.default_rng([5, seed])
        drawn.clear()
        scene = scene_kinds.SCENES[kind](rng)
        found = measure(scene.image, shaken(rng, scene.boxes))
        errors.append(column(found, "diameter_px") - diameters(np.concatenate(drawn)))
    error = np.concatenate(errors)
    assert np.sqrt((error**2).mean()) < 0.05


@pytest.mark.parametrize(("gap", "most"), [(0.5, 0.2), (1.0, 0.05), (3.0, 0.05)])
def test_a_packing_is_measured_through_its_films(gap: float, most: float) -> None:
    """A hexagonal packing of 19 discs of 15 px."""
    row, line = np.mgrid[-2:3, -3:4].reshape(2, -1)
    places = np.column_stack([line + (row % 2) / 2, row * np.sqrt(0.75)]) * (30.0 + gap)
    places = places[np.hypot(*places.T) < 75] + [120.3, 119.6]
    n = len(places)
    assert n == 19
    drawn = np.column_stack([places, np.full((n, 2), 15.0), np.zeros(n)])
    canvas = np.zeros((240, 240), np.uint8)
    draw_ellipses(canvas, drawn, 255)
    found = measure(canvas, ellipse_boxes(drawn))
    error = column(found, "diameter_px") - 30
    assert np.sqrt((error**2).mean()) < most


@pytest.mark.parametrize(("gap", "most"), [(1.0, 0.1), (2.0, 0.05), (4.0, 0.05)])
@pytest.mark.parametrize("ring", [20, 230], ids=["dark", "bright"])
def test_rings_in_a_packing_are_measured_though_they_run_into_each_other(
    ring: int, gap: float, most: float
) -> None:
    """A hexagonal packing of 19 rings 3 px wide, 15 px in radius, on a ground of 120 levels."""
    row, line = np.mgrid[-2:3, -3:4].reshape(2, -1)
    places = np.column_stack([line + (row % 2) / 2, row * np.sqrt(0.75)]) * (30.0 + gap)
    places = places[np.hypot(*places.T) < 75] + [120.3, 119.6]
    drawn = np.column_stack([places, np.full((19, 2), 15.0), np.zeros(19)])
    canvas = np.full((240, 240), 120, np.uint8)
    draw_ellipses(canvas, drawn, ring)
    draw_ellipses(canvas, drawn - [0, 0, 3, 3, 0], 125)
    found = measure(canvas, shaken(np.random.default_rng(0), ellipse_boxes(drawn)))
    error = column(found, "diameter_px") - 30
    assert np.sqrt((error**2).mean()) < most
    assert np.abs(column(found, "deformation")).max() < 0.01


def test_a_bent_shape_has_the_area_of_its_contour() -> None:
    """r = 30 (1 + 0.15 cos 3 t): its area is 900 pi (1 + 0.15^2 / 2)."""
    angles = np.arange(256) * 2 * np.pi / 256
    canvas = np.zeros((120, 120), np.uint8)
    draw_contour(canvas, np.array([60.2, 59.7]), 30 * (1 + 0.15 * np.cos(3 * angles)), 255)
    found = measure(canvas, np.array([[60.0, 60, 66, 62]]))
    expected = 900 * np.pi * (1 + 0.15**2 / 2)
    assert column(found, "area_px2")[0] == pytest.approx(expected, rel=3e-3)


def test_of_a_droplet_that_the_image_cuts_the_whole_circle_s_centre_is_told() -> None:
    discs = np.array([[7.3, 60.2, 20, 20, 0], [60.4, 111.0, 18, 18, 0], [60.0, 50.0, 20, 20, 0]])
    canvas = np.full((120, 120), 30, np.uint8)
    draw_ellipses(canvas, discs, 200)
    boxes = np.array([[13.6, 60, 27, 40], [60, 106, 36, 27], [60.0, 50, 40, 40]])
    found = measure(canvas, boxes)
    assert column(found, "at_edge").tolist() == [1, 1, 0]
    assert np.isnan(found.shapes[:2, : COLUMNS.index("outline_seen")]).all()
    seen = column(found, "outline_seen")
    assert (seen[:2] < 0.95).all()
    assert (seen[:2] > 0.4).all()
    np.testing.assert_allclose(found.centres, discs[:, :2], atol=0.1)
    assert found.measured.tolist() == [False, False, True]
    assert (found.boxes[:2] == boxes[:2]).all()


def test_where_there_is_no_droplet_nothing_is_guessed() -> None:
    rng = np.random.default_rng(3)
    noise = np.clip(rng.normal(120, 5, (200, 200)), 0, 255).astype(np.uint8)
    boxes = np.array([[100.0, 100, 40, 40], [0.5, 0.5, 2, 2], [-40, 300, 20, 20], [50, 50, 12, 9]])
    found = measure(noise, boxes)
    assert np.isnan(found.shapes[:, : COLUMNS.index("outline_seen")]).all()
    assert (found.boxes == boxes).all()
    assert measure(noise, np.zeros((0, 4))).shapes.shape == (0, len(COLUMNS))
    assert np.isnan(measure(np.zeros((1, 1), np.uint8), boxes).shapes[:, 0]).all()


@pytest.mark.parametrize("kind", ["a", "b", "c", "d"])
def test_compiled_loops_see_the_same_outlines_as_arrays(
    kind: str, arrays: Callable[[], AbstractContextManager[None]]
) -> None:
    n = 0
    for seed in range(6):
        rng = np.random.default_rng([7, seed])
        scene = scene_kinds.SCENES[kind](rng)
        image = [scene.image, 255 - scene.image, degrade(scene.image, rng)][seed % 3]
        boxes = shaken(rng, scene.boxes)
        anywhere = np.column_stack([rng.uniform(-20, 640, (8, 2)), rng.uniform(1, 90, (8, 2))])
        boxes = np.concatenate([boxes, anywhere, boxes[:3] * [1, 1, 0.4, 0.5]])
        found = measure(image, boxes)
        with arrays():
            expected = measure(image, boxes)
        np.testing.assert_allclose(found.shapes, expected.shapes, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.centres, expected.centres, rtol=1e-9)
        np.testing.assert_allclose(found.boxes, expected.boxes, rtol=1e-9)
        n += int(np.isfinite(found.shapes[:, 0]).sum())
    assert n > 10


def disc_region() -> Region:
    """What lies within 70 px of (100, 100), of 200 x 200 px."""
    y, x = np.mgrid[:200, :200] + 0.5
    return Region(np.asarray(np.hypot(x - 100, y - 100) < 70))


@pytest.mark.parametrize("stop", [True, False])
def test_droplets_cut_by_a_region_are_flagged_and_their_circle_is_told(*, stop: bool) -> None:
    """One inside, one across the border, which a field stop darkens or not."""
    discs = np.array([[95.3, 100.2, 20, 20, 0], [155.4, 120.8, 18, 18, 0]])
    canvas = np.full((200, 200), 60, np.uint8)
    draw_ellipses(canvas, discs, 200)
    region = disc_region()
    if stop:
        canvas[~region.mask] = 5
    boxes = np.array([[95.0, 100, 41, 41], [151 if stop else 155.0, 120, 28 if stop else 36, 36]])
    frame = np.repeat(canvas[..., None], 3, axis=2)
    found = measure_droplets(frame, boxes, region=region)
    assert column(found, "at_edge").tolist() == [0, 1]
    assert column(found, "diameter_px")[0] == pytest.approx(40, abs=0.1)
    assert np.isnan(column(found, "diameter_px")[1])
    assert found.measured.tolist() == [True, False]
    np.testing.assert_allclose(found.centres, discs[:, :2], atol=0.3)
    assert at_edge(boxes, (200, 200), region).tolist() == [False, True]
    assert at_edge(boxes, (200, 200)).tolist() == [False, False]
    everywhere = measure_droplets(frame, boxes, region=Region(np.ones((200, 200), bool)))
    plain = measure_droplets(frame, boxes)
    np.testing.assert_array_equal(everywhere.shapes, plain.shapes)
    np.testing.assert_array_equal(everywhere.centres, plain.centres)
