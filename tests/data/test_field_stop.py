"""A dark round field stop is told by its circle; nothing else that is dark is one."""

import numpy as np
import pytest

from data_gen.scenes.scene_kinds import SCENES
from data_gen.scenes.shapes import draw_ellipses
from droptrack.data.field_stop import find_field_stop
from droptrack.data.frames import Frame, grey_frame

WIDTH, HEIGHT = 480, 320


def through_stop(
    canvas: np.ndarray, x: float, y: float, radius: float, level: float = 8, soft: float = 1.0
) -> Frame:
    """What a stop leaves of an image, with an edge some px wide."""
    rows, columns = np.mgrid[: canvas.shape[0], : canvas.shape[1]] + 0.5
    open_ = np.clip((radius - np.hypot(columns - x, rows - y)) / soft + 0.5, 0, 1)
    return grey_frame((level + open_ * (canvas - level)).astype(np.uint8))


def background(rng: np.random.Generator, level: int = 130, *, drops: int = 12) -> np.ndarray:
    canvas = np.full((HEIGHT, WIDTH), level, np.uint8)
    places = rng.uniform([0, 0], [WIDTH, HEIGHT], (drops, 2))
    draw_ellipses(
        canvas, np.column_stack([places, np.full((drops, 2), 14.0), np.zeros(drops)]), 220
    )
    return np.clip(canvas + rng.normal(0, 3, canvas.shape), 0, 255)


@pytest.mark.parametrize(
    ("x", "y", "radius"), [(240, 160, 150), (236.4, 165.2, 190), (240, 160, 260), (200, 150, 200)]
)
def test_the_circle_of_a_stop_is_found(x: float, y: float, radius: float) -> None:
    """With noise and droplets, some of them at the border; of the last two parts are seen only."""
    rng = np.random.default_rng(3)
    frames = [through_stop(background(rng), x, y, radius, soft=2) for _ in range(4)]
    stop = find_field_stop(frames)
    assert stop is not None
    assert (stop.x, stop.y, stop.radius) == pytest.approx((x, y, radius), abs=1)
    assert stop.region.mask[int(y), int(x)]
    assert not stop.region.mask[0, 0]


def test_a_stop_that_only_two_corners_show_is_found_beside_the_dark_walls_of_a_channel() -> None:
    rng = np.random.default_rng(5)
    canvas = background(rng)
    canvas[90:110] = canvas[200:220] = 20
    stop = find_field_stop([through_stop(canvas, 330, 165, 300)])
    assert stop is not None
    assert (stop.x, stop.y, stop.radius) == pytest.approx((330, 165, 300), abs=3)
    assert not stop.region.mask[:, 0].any()


def channel_behind_stop(rng: np.random.Generator) -> Frame:
    """A bright channel between dark walls, with a plug somewhere, behind a large and soft stop."""
    canvas = np.clip(rng.normal(120, 3, (416, 1024)), 0, 255)
    canvas[130:290] = 200
    canvas[120:130] = canvas[290:300] = 25
    rims, inside = np.array([[0.0, 210, 170, 75, 0]]), [0, 0, 12, 12, 0]
    rims[0, 0] = rng.uniform(-100, 1100)
    plug = canvas.astype(np.uint8)
    draw_ellipses(plug, rims, 30)
    draw_ellipses(plug, rims - inside, 230)
    return through_stop(plug.astype(float), 545.0, 212.0, 521.0, soft=14)


def test_a_large_stop_is_the_same_whatever_frames_are_chosen() -> None:
    """Only an arc of it is seen, whose edge is soft and meets what is bright and what is not."""
    for seed in range(8):
        rng = np.random.default_rng([4, seed])
        stop = find_field_stop([channel_behind_stop(rng) for _ in range(1 + 2 * seed)])
        assert stop is not None, seed
        assert (stop.x, stop.y, stop.radius) == pytest.approx((545, 212, 521), abs=4)


def test_a_dark_background_is_no_field_stop() -> None:
    """All scenes; a packing of discs, a large one, a channel between dark walls, a window."""
    for kind in SCENES:
        for seed in range(3):
            image = np.asarray(SCENES[kind](np.random.default_rng([9, seed])).image)
            for one in (image, 255 - image):
                assert find_field_stop([grey_frame(one)]) is None, kind
    row, column = np.mgrid[-2:3, -3:4].reshape(2, -1)
    places = np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * 62.0
    places = places[np.argsort(np.hypot(*places.T))[:19]] + [240, 160]
    packing = np.zeros((HEIGHT, WIDTH), np.uint8)
    discs = np.column_stack([places, np.full((19, 2), 32.0), np.zeros(19)])
    draw_ellipses(packing, discs, 220)
    large = np.full((HEIGHT, WIDTH), 10, np.uint8)
    draw_ellipses(large, np.array([[240.0, 160, 110, 110, 0]]), 220)
    channel = np.full((HEIGHT, WIDTH), 10, np.uint8)
    channel[80:240] = 150
    window = np.full((HEIGHT, WIDTH), 10, np.uint8)
    window[30:-30, 40:-40] = 150
    plain = np.full((HEIGHT, WIDTH), 90, np.uint8)
    for canvas in (packing, large, channel, window, plain, plain[:20, :20]):
        assert find_field_stop([grey_frame(canvas)]) is None
