import numpy as np
import pytest

from data_gen.scenes.scene_kinds import SCENES
from droptrack.data.degradation import (
    add_noise,
    blur,
    degrade,
    light_unevenly,
    lower_contrast,
    to_pixels,
)


def test_blur_spreads_a_point_by_its_standard_deviation_and_keeps_its_light() -> None:
    point = np.zeros((41, 41))
    point[20, 20] = 200
    blurred = blur(point, 2.5)
    assert blurred.sum() == pytest.approx(200)
    spread = (blurred.sum(axis=0) @ (np.arange(41) - 20) ** 2) / 200
    assert spread == pytest.approx(2.5**2, rel=0.02)


def test_light_contrast_and_noise_change_levels_as_their_names_say() -> None:
    levels = np.array([[0.0, 100.0, 255.0]] * 2)
    lit = light_unevenly(levels, np.array([1.0, 0.5, 0.2]))
    np.testing.assert_allclose(lit, [[0, 50, 51]] * 2)
    np.testing.assert_allclose(lower_contrast(levels, 0.4, 20), [[20, 60, 122]] * 2)
    normal = np.array([[0.0, 1, -1], [2, 0, 0]])
    np.testing.assert_allclose(add_noise(levels, normal, 3), [[0, 103, 252], [6, 100, 255]])
    assert to_pixels(np.array([-3.0, 7.9, 300])).tolist() == [0, 7, 255]


def test_an_image_is_degraded_in_the_same_way_in_all_channels() -> None:
    image = SCENES["c"](np.random.default_rng(0)).image
    grey = degrade(image, np.random.default_rng(4))
    colour = degrade(np.repeat(image[..., None], 3, axis=2), np.random.default_rng(4))
    assert grey.dtype == np.uint8
    assert (colour == grey[..., None]).all()
    assert (grey != image).mean() > 0.02
