"""The scale that frames suggest: what the network sees again at other scales is a droplet."""

import numpy as np
import pytest

from data_gen.scenes.shapes import draw_ellipses
from droptrack.data.arrays import Floats
from droptrack.data.frames import Frame, grey_frame
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Network, choose_detector
from droptrack.detection.scale_choice import MIN_SCORE, TILE, choose_scale, scales_for
from droptrack.network.bundled import find_network
from droptrack.network.darknet_cfg import resized


@pytest.fixture(scope="module")
def detector() -> Detector:
    cfg, weights = find_network()
    return choose_detector(
        Network(resized(cfg, TILE, TILE), weights, threshold=MIN_SCORE, max_iou=0.3)
    )


def discs(radius: float, size: tuple[int, int], seed: int = 0) -> tuple[Frame, Floats]:
    """White discs on a lattice of four radii, moved by up to half a radius; x, y of each."""
    rng = np.random.default_rng(seed)
    steps = [np.arange(2 * radius, side - radius, 4 * radius) for side in size]
    places = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2).astype(float)
    places += rng.uniform(-0.5, 0.5, places.shape) * radius
    image = np.zeros(size[::-1], np.uint8)
    rows = np.column_stack([places, np.full((len(places), 2), radius), np.zeros(len(places))])
    draw_ellipses(image, rows, 230)
    return grey_frame(image), places


@pytest.mark.parametrize(("radius", "size"), [(8, (400, 300)), (25, (900, 700)), (90, (1300, 900))])
def test_discs_of_any_size_get_a_scale_at_which_the_network_knows_them(
    radius: float, size: tuple[int, int], detector: Detector
) -> None:
    """It learned discs of some 15 to 120 px; and all of them are seen."""
    frame, places = discs(radius, size)
    choice = choose_scale([frame], detector, default=0.8)
    assert 15 <= 2 * radius * choice.scale <= 120
    assert choice.quality[choice.scale] > 0.9
    assert np.median(choice.diameters) == pytest.approx(2 * radius, rel=0.06)
    # in the tiles looked at, so not more than there are
    assert 0.5 * len(places) <= len(choice.diameters) <= len(places)


def test_without_droplets_the_default_is_taken(detector: Detector) -> None:
    black = grey_frame(np.zeros((300, 400), np.uint8))
    choice = choose_scale([black], detector, default=0.7)
    assert choice.scale == 0.7
    assert not len(choice.diameters)


def test_the_default_is_taken_where_it_is_as_good_as_any(detector: Detector) -> None:
    frame, _ = discs(25, (900, 700))
    for default in (0.6, 1.0):
        assert choose_scale([frame], detector, default=default).scale == default


def test_scales_are_those_that_make_an_input_neither_tiny_nor_huge() -> None:
    assert min(scales_for(4000, 3000, 0.3)) * 3000 >= 96
    assert max(scales_for(4000, 3000, 0.3)) ** 2 * 4000 * 3000 <= 9e6
    assert scales_for(10, 10, 1.0) == []
