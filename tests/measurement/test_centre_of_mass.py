"""Centres of mass of droplets drawn where the numbers say."""

from collections.abc import Callable
from contextlib import AbstractContextManager

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from data_gen.scenes.scene_kinds import SCENES
from data_gen.scenes.shapes import BLACK, WHITE, draw_contour, draw_ellipses, ellipse_boxes
from droptrack.data.degradation import degrade
from droptrack.measurement.centre_of_mass import centres_of_mass

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("implementation")


def frame_of(canvas: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(canvas[..., None], 3, axis=2)


def random_discs(rng: np.random.Generator, n: int) -> Floats:
    places = np.column_stack([np.arange(n) % 6 * 60 + 50, np.arange(n) // 6 * 60 + 50])
    radius = rng.uniform(10, 25, n)
    return np.column_stack([places + rng.uniform(-1, 1, (n, 2)), radius, radius, np.zeros(n)])


def shaken(rng: np.random.Generator, boxes: Floats) -> Floats:
    """Boxes as a network gives them: off by 5 % of their size."""
    return boxes + rng.normal(0, 0.05, boxes.shape) * boxes[:, [2, 3, 2, 3]]


def wrong(rng: np.random.Generator, boxes: Floats) -> Floats:
    """Boxes within others, across their edges and beyond the frame's."""
    second = rng.permutation(boxes)[:8]
    second[:, :2] += rng.normal(0, 0.3, (len(second), 2)) * second[:, 2:]
    second[:, 2:] *= rng.uniform(0.05, 0.9, (len(second), 2))
    anywhere = np.column_stack([rng.uniform(-20, 640, (8, 2)), rng.uniform(1, 90, (8, 2))])
    return np.concatenate([second, anywhere])


@pytest.mark.parametrize("dark", [False, True], ids=["bright on dark", "dark on bright"])
def test_discs_are_located_to_two_thousandths_of_a_pixel(dark: bool) -> None:
    rng = np.random.default_rng(0)
    discs = random_discs(rng, 36)
    canvas = np.full((420, 420), WHITE if dark else BLACK, np.uint8)
    draw_ellipses(canvas, discs, BLACK if dark else WHITE)
    centres, measured = centres_of_mass(frame_of(canvas), shaken(rng, ellipse_boxes(discs)))
    assert measured.all()
    error = centres - discs[:, :2]
    assert np.sqrt((error**2).mean()) < 0.002
    assert np.abs(error).max() < 0.01


def test_jpeg_and_noise_cost_little() -> None:
    rng = np.random.default_rng(1)
    discs = random_discs(rng, 36)
    canvas = np.full((420, 420), 40, np.uint8)
    draw_ellipses(canvas, discs, 200)
    noisy = np.clip(canvas + rng.normal(0, 5, canvas.shape), 0, 255).astype(np.uint8)
    jpeg = cv2.imdecode(cv2.imencode(".jpg", frame_of(noisy))[1], cv2.IMREAD_COLOR)
    centres, measured = centres_of_mass(
        np.asarray(jpeg, np.uint8), shaken(rng, ellipse_boxes(discs))
    )
    assert measured.all()
    assert np.sqrt(((centres - discs[:, :2]) ** 2).mean()) < 0.05


def test_touching_discs_are_told_apart() -> None:
    """A hexagonal packing without any gap: 19 discs of radius 15, edge to edge."""
    row, column = np.mgrid[-2:3, -3:4].reshape(2, -1)
    places = np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * 30.0
    places = places[np.hypot(*places.T) < 65] + [120.3, 119.6]
    n = len(places)
    discs = np.column_stack([places, np.full((n, 2), 15.0), np.zeros(n)])
    canvas = np.zeros((240, 240), np.uint8)
    draw_ellipses(canvas, discs, WHITE)
    centres, measured = centres_of_mass(frame_of(canvas), ellipse_boxes(discs))
    assert n >= 19
    assert measured.all()
    assert np.abs(centres - places).max() < 0.1


def test_crowded_discs_are_told_apart_by_boxes_that_are_off() -> None:
    """Scene c: discs that touch; at 5 % of their size the boxes are off by a pixel and a half."""
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(20):
        scene = SCENES["c"](rng)
        centres, measured = centres_of_mass(frame_of(scene.image), shaken(rng, scene.boxes))
        assert measured.all()
        errors.append(centres - scene.boxes[:, :2])
    error = np.hypot(*np.concatenate(errors).T)
    assert np.median(error) < 0.002
    assert np.sqrt((error**2).mean()) < 0.12


def test_a_core_in_its_shell_is_not_confused_with_the_white_outside() -> None:
    canvas = np.full((200, 200), WHITE, np.uint8)
    draw_ellipses(canvas, np.array([[100.0, 100, 60, 60, 0]]), BLACK)
    core = np.array([[137.4, 100.7, 20.0, 20.0, 0.0]])  # 2.6 px from the shell's edge
    draw_ellipses(canvas, core, WHITE)
    centres, measured = centres_of_mass(frame_of(canvas), ellipse_boxes(core) * [1, 1, 1.2, 1.2])
    assert measured.all()
    np.testing.assert_allclose(centres, core[:, :2], atol=0.05)


def test_uneven_light_shifts_the_centre_only_with_the_droplet_itself() -> None:
    """The background falls from 80 to 20 grey levels over the image."""
    disc = np.array([[60.4, 59.7, 20.0, 20.0, 0.0]])
    canvas = np.zeros((120, 120), np.uint8)
    draw_ellipses(canvas, disc, WHITE)
    light = np.linspace(80, 20, 120)[None] * (1 - canvas / 255) + 200 * (canvas / 255)
    centres, _ = centres_of_mass(frame_of(light.astype(np.uint8)), ellipse_boxes(disc))
    np.testing.assert_allclose(centres, disc[:, :2], atol=0.1)


def test_a_shape_that_is_no_ellipse_has_the_centre_of_its_area() -> None:
    """The centre of an egg's area, by summing triangles, is not its box's centre."""
    angles = np.arange(256) * 2 * np.pi / 256
    radii = 20 * (1 + 0.25 * np.cos(angles))
    start = np.array([55.3, 60.8])
    canvas = np.zeros((120, 120), np.uint8)
    draw_contour(canvas, start, radii, WHITE)
    area = (radii**2).sum()
    expected = start + np.array([(2 / 3 * radii**3 * np.cos(angles)).sum() / area, 0])
    box = np.array([[58.0, 60.8, 44.0, 44.0]])
    centres, _ = centres_of_mass(frame_of(canvas), box)
    np.testing.assert_allclose(centres[0], expected, atol=0.02)


@pytest.mark.parametrize(
    "box",
    [[50.0, 50, 30, 30], [0.5, 0.5, 2, 2], [-40.0, 300, 20, 20]],
    ids=["nothing there", "tiny in a corner", "outside"],
)
def test_where_no_droplet_stands_out_the_box_centre_is_given(box: list[float]) -> None:
    frame = np.full((100, 100, 3), 77, np.uint8)
    centres, measured = centres_of_mass(frame, np.array([box]))
    assert not measured.any()
    assert centres.tolist() == [box[:2]]


def test_beyond_the_frame_there_is_no_surrounding() -> None:
    """A dark droplet on bright ground, three pixels from the frame's edge."""
    disc = np.array([[15.2, 59.7, 12.0, 12.0, 0.0]])
    canvas = np.full((120, 120), 200, np.uint8)
    draw_ellipses(canvas, disc, 100)
    centres, measured = centres_of_mass(frame_of(canvas), ellipse_boxes(disc))
    assert measured.all()
    np.testing.assert_allclose(centres, disc[:, :2], atol=0.02)


@pytest.mark.parametrize("kind", ["a", "b", "c", "d"])
def test_compiled_loops_do_the_same_as_arrays_to_the_last_bit(
    kind: str, arrays: Callable[[], AbstractContextManager[None]]
) -> None:
    n = 0
    for seed in range(12):
        rng = np.random.default_rng([7, seed])
        scene = SCENES[kind](rng)
        image = [scene.image, 255 - scene.image, degrade(scene.image, rng)][seed % 3]
        boxes = shaken(rng, scene.boxes) * [1, 1, *rng.choice([0.8, 1, 1.2], 2)]
        boxes = np.concatenate([boxes, wrong(rng, scene.boxes)])
        centres, measured = centres_of_mass(frame_of(image), boxes)
        with arrays():
            expected, expected_measured = centres_of_mass(frame_of(image), boxes)
        assert (centres == expected).all()
        assert (measured == expected_measured).all()
        n += int(measured.sum())
    assert n > 12


def test_no_boxes_give_no_centres() -> None:
    centres, measured = centres_of_mass(np.zeros((9, 9, 3), np.uint8), np.zeros((0, 4)))
    assert centres.shape == (0, 2)
    assert measured.shape == (0,)
