"""What a network is shown: grey, of the right channel, in the levels that it learned."""

import cv2
import numpy as np
import pytest

from droptrack.data.frames import Frame, grey_frame, grey_plane
from droptrack.data.normalisation import GENTLE, UNCHANGED, Normalisation, normalisation_for

SIZE = (240, 320)


def discs(background: float, shade: float, noise: float = 0.0) -> Frame:
    """A grey frame with twelve discs of a diameter of 24 px."""
    image = np.full(SIZE, float(background))
    for x in range(40, 320, 80):
        for y in (50, 120, 190):
            cv2.circle(image, (x, y), 12, shade, -1)
    image += np.random.default_rng(0).normal(0, noise, SIZE)
    return grey_frame(np.clip(image, 0, 255).astype(np.uint8))


def in_colour(*planes: Frame) -> Frame:
    """A frame of the planes blue, green and red."""
    return np.stack([plane[..., 0] for plane in planes], axis=2)


def test_frames_of_full_contrast_are_left_as_they_are() -> None:
    for frame in (discs(20, 230), discs(200, 60), discs(90, 230, noise=5)):
        chosen = normalisation_for([frame])
        assert chosen == UNCHANGED
        assert chosen.shown(frame) is not None
        np.testing.assert_array_equal(chosen.shown(frame), frame)
        assert str(chosen) == ""


@pytest.mark.parametrize(("background", "shade"), [(120, 150), (60, 40), (200, 245)])
def test_faint_frames_get_most_of_the_range(background: int, shade: int) -> None:
    frame = discs(background, shade, noise=2)
    chosen = normalisation_for([frame])
    shown = chosen.shown(frame)[..., 0].astype(float)
    disc, around = shown[115:126, 35:46].mean(), np.median(shown)
    low, high = sorted((disc, around))
    assert 10 < low < 40  # SHOWN, less the noise
    assert 205 < high < 250
    assert (disc > around) == (shade > background)


@pytest.mark.parametrize(("shade", "gain"), [(140, 4), (160, 1)])
def test_a_network_that_knows_faint_frames_gets_them_little_stretched(
    shade: int, gain: int
) -> None:
    """Discs of 20 levels get 80, in the middle of the range; discs of 40 stay as they are."""
    frame = discs(120, shade)
    shown = normalisation_for([frame], stretching=GENTLE).shown(frame)[..., 0].astype(float)
    disc, around = shown[115:126, 35:46].mean(), np.median(shown)
    assert disc - around == pytest.approx(gain * (shade - 120), abs=2)
    assert (disc + around) / 2 == pytest.approx((shade + 120) / 2, abs=2)


def test_all_frames_of_a_video_share_what_suits_some_of_them() -> None:
    bright, faint = discs(20, 220), discs(20, 60)
    assert normalisation_for([faint, bright]) == UNCHANGED


@pytest.mark.parametrize("noise", [0, 3, 12])
def test_noise_without_anything_is_not_made_into_contrast(noise: float) -> None:
    empty = discs(100, 100, noise)
    assert normalisation_for([empty]).levels is None


@pytest.mark.parametrize(("place", "name"), [(0, "blue"), (1, "green"), (2, "red")])
def test_a_fluorescence_of_one_colour_is_seen_in_its_channel(place: int, name: str) -> None:
    planes = [discs(10, 14)] * 3
    planes[place] = discs(10, 240)
    frame = in_colour(*planes)
    chosen = normalisation_for([frame])
    assert chosen == Normalisation(grey=True, channel=name)
    np.testing.assert_array_equal(chosen.shown(frame), planes[place])
    assert str(chosen) == f"the {name} channel"


def test_other_colours_become_the_mixture() -> None:
    frame = in_colour(discs(30, 200), discs(40, 210), discs(60, 220))
    chosen = normalisation_for([frame])
    assert chosen == Normalisation(grey=True)
    plane = grey_plane(chosen.shown(frame))
    assert plane is not None
    # ITU-R BT.601, by hand
    assert plane[120, 40] == pytest.approx(0.114 * 200 + 0.587 * 210 + 0.299 * 220, abs=1)


def test_the_negative_is_of_what_is_stretched() -> None:
    frame = discs(120, 150)
    bright = normalisation_for([frame])
    dark = normalisation_for([frame], dark=True)
    np.testing.assert_array_equal(dark.shown(frame), 255 - bright.shown(frame))


def test_an_image_of_a_few_pixels_has_no_contrast_to_speak_of() -> None:
    tiny = grey_frame(np.array([[100]], np.uint8))
    assert normalisation_for([tiny]) == UNCHANGED
