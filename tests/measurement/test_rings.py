"""Which edge is the droplet's: that of a ring, outside, or of what is unlike its surroundings."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from data_gen.scenes.shapes import draw_ellipses, ellipse_boxes
from droptrack.data.frames import grey_frame
from droptrack.data.region import Region
from droptrack.measurement.droplets import Measured, measure_droplets
from droptrack.measurement.rings import noise_of
from droptrack.measurement.shapes import COLUMNS

Floats = NDArray[np.float64]
HALF, RADIUS, STEP = np.array([150.0, 75.0]), 74.0, 380.0  # of a plug, and from one to the next
AREA = 4 * HALF.prod() - (4 - np.pi) * RADIUS**2

pytestmark = pytest.mark.usefixtures("implementation")


def diameters(found: Measured) -> Floats:
    return found.shapes[:, COLUMNS.index("diameter_px")]


def covered(distance: Floats) -> Floats:
    return np.clip(0.5 - distance, 0, 1)


def channel(places: Floats, *, rim: float, inside: float, wall: float) -> Floats:
    """Plugs at places (N,) along a channel of 400 x 1200 px, levels added to a ground of 130."""
    y, x = np.mgrid[:400, :1200] + 0.5
    canvas = np.full((400, 1200), 130.0)
    away = np.abs(y - 200) - HALF[1] - 3
    canvas += wall * covered(np.abs(away - 6) - 6)
    for place in places:
        straight = np.maximum(np.abs(np.stack([x - place, y - 200], -1)) - HALF + RADIUS, 0)
        distance = np.hypot(straight[..., 0], straight[..., 1]) - RADIUS
        canvas += inside * covered(distance) + rim * (covered(distance) - covered(distance + 11))
    return canvas


@pytest.mark.parametrize(
    ("rim", "inside", "wall"),
    [(-100, 0, -90), (-100, 20, -90), (90, 0, -100), (0, 80, -100), (0, -90, 0), (0, 70, 90)],
    ids=[
        *("dark rims", "dark rims, bright inside", "bright rims", "bright plugs"),
        *("dark plugs without walls", "bright plugs between bright walls"),
    ],
)
def test_all_plugs_of_a_video_have_one_kind_of_edge_whatever_their_boxes(
    rim: float, inside: float, wall: float
) -> None:
    """Boxes up to a fifth too flat and too long, as networks give them of what they hardly know."""
    for seed in range(6):
        rng = np.random.default_rng([11, seed])
        places = np.array(rng.uniform(160, 280) + STEP * np.arange(3))
        canvas = channel(places, rim=rim, inside=inside, wall=wall)
        canvas += rng.normal(0, 4, canvas.shape)
        off = np.column_stack([rng.uniform(1, 1.15, 3), rng.uniform(0.8, 1, 3)])
        centres = np.column_stack([places, np.full(3, 200)]) + rng.normal(0, 4, (3, 2))
        boxes = np.hstack([centres, 2 * HALF * off])
        whole = places + HALF[0] < 1195
        found = measure_droplets(grey_frame(canvas.clip(0, 255).astype(np.uint8)), boxes)
        known = np.isfinite(diameters(found))
        assert known[whole].all(), seed
        assert (found.rings[known] == (rim != 0)).all(), seed
        expected = np.sqrt(4 / np.pi * AREA)
        assert diameters(found)[known & whole] == pytest.approx(expected, rel=0.03), seed


def test_rays_that_end_in_a_field_stop_tell_nothing_of_rings() -> None:
    """Plugs beside the stop, with a bright line within the dark rim, as a lens makes it."""
    stop = np.ones((400, 1200), bool)
    stop[:, :145] = False
    for seed in range(4):
        rng = np.random.default_rng([12, seed])
        place = np.array([rng.uniform(300, 310)])
        canvas = channel(place, rim=-100, inside=0, wall=-90)
        x, y = np.mgrid[:1200, :400] + 0.5
        away = np.abs(np.hypot(np.maximum(np.abs(x - place) - 76, 0), y - 200) - 60) - 3
        canvas += 110 * covered(away).T
        canvas += rng.normal(0, 3, canvas.shape)
        canvas[~stop] = 4
        boxes = np.array([[place[0], 200, 330, 2 * HALF[1] * rng.uniform(0.85, 1)]])
        frame = grey_frame(canvas.clip(0, 255).astype(np.uint8))
        found = measure_droplets(frame, boxes, region=Region(stop))
        assert found.rings.all()
        assert diameters(found) == pytest.approx(np.sqrt(4 / np.pi * AREA), rel=0.03)


@pytest.mark.parametrize("sigma", [0, 4, 8, 12])
def test_noise_makes_no_rings_and_hides_none_that_are_clear(sigma: float) -> None:
    rng = np.random.default_rng(2)
    places = np.column_stack([np.arange(16) % 4 * 110 + 60, np.arange(16) // 4 * 110 + 60])
    drawn = np.column_stack([places, np.full((16, 2), 30.0), np.zeros(16)])
    for ring in (False, True):
        canvas = np.full((450, 450), 100, np.uint8)
        draw_ellipses(canvas, drawn, 30 if ring else 170)
        draw_ellipses(canvas, drawn - [0, 0, 4, 4, 0], 105 if ring else 170)
        noisy = np.clip(canvas + rng.normal(0, sigma, canvas.shape), 0, 255)
        found = measure_droplets(grey_frame(noisy.astype(np.uint8)), ellipse_boxes(drawn))
        assert (found.rings == ring).all()
        assert diameters(found) == pytest.approx(60, rel=0.01)


def test_noise_is_told_beside_edges() -> None:
    rng = np.random.default_rng(3)
    canvas = np.full((400, 600), 60.0)
    canvas[:, ::50] = 200
    for sigma in (0.0, 3.0, 10.0):
        noisy = np.clip(canvas + rng.normal(0, sigma, canvas.shape), 0, 255).astype(np.uint8)
        assert noise_of(noisy) == pytest.approx(sigma, rel=0.15, abs=0.3)
    assert noise_of(np.zeros((5, 2), np.uint8)) == 0


def test_what_is_behind_the_surroundings_is_no_edge_of_a_filled_droplet() -> None:
    """Dark droplets in a bright channel, between walls as dark, beyond which it is bright again."""
    y = np.arange(200)[:, None] + 0.5
    canvas = np.full((200, 400), 220, np.uint8)
    canvas[((np.abs(y - 100) > 45) & (np.abs(y - 100) < 55))[:, 0]] = 70
    drawn = np.array([[100.0, 100, 60, 35, 0], [300.0, 100, 60, 35, 0]])
    draw_ellipses(canvas, drawn, 70)
    found = measure_droplets(grey_frame(canvas), ellipse_boxes(drawn) * [1, 1, 1.05, 1.2])
    assert not found.rings.any()
    assert diameters(found) == pytest.approx(2 * np.sqrt(60 * 35), rel=0.003)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", [567, 6059, 6110])
def test_where_a_ring_is_level_it_has_no_edge(seed: int) -> None:
    """Rings in few grey levels, whose boxes are off: edges were infinitely far."""
    rng = np.random.default_rng(seed)
    image = np.full((70, 70), int(rng.integers(60, 200)), np.uint8)
    n = int(rng.integers(1, 4))
    levels = rng.integers(0, 255, 3).tolist()
    centres, radii = rng.uniform(10, 60, (n, 2)), rng.uniform(8, 18, n)
    for (x, y), radius in zip(centres.tolist(), radii.tolist(), strict=True):
        draw_ellipses(image, np.array([[x, y, radius, radius * rng.uniform(0.6, 1), 0]]), levels[0])
        draw_ellipses(image, np.array([[x, y, 0.7 * radius, 0.6 * radius, 0]]), levels[1])
        if rng.random() < 0.5:
            draw_ellipses(image, np.array([[x, y, 0.4 * radius, 0.4 * radius, 0]]), levels[2])
    sides = [2 * radii * rng.uniform(0.7, 1.3, n) for _ in range(2)]
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.5, 3)), np.uint8)
    step = int(rng.choice([8, 16, 24, 32]))
    boxes = np.column_stack([centres, *sides])
    boxes[:, 2:] *= rng.uniform(0.6, 1.5)
    boxes[:, :2] += rng.normal(0, 3, (n, 2))
    outlines = measure_droplets(grey_frame(image // step * step), boxes).outlines
    assert not np.isinf(outlines).any()
