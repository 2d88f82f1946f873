"""What is measured on images equals what was drawn into them."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_gen.scenes.dataset import image_source
from data_gen.scenes.own_set_up import OwnDroplets
from droptrack.adaptation.appearance import Measured, measure, without_structures
from droptrack.adaptation.backgrounds import background, painted_over, views_of
from droptrack.adaptation.crops import cut_out, paste
from droptrack.adaptation.training_set import _extended, _in_turn, taught
from droptrack.adaptation.trust import Trust
from droptrack.data.arrays import Float32s, Floats, Pixels
from droptrack.data.detections import iou_matrix
from droptrack.data.set_up import (
    ELLIPSE,
    Profile,
    SetUp,
    View,
    outline_distance,
    part_of,
    read_set_up,
    write_set_up,
)
from droptrack.detection.scale import Canvas
from droptrack.errors import DroptrackError
from tests.adaptation.drawn import (
    HEIGHT,
    NOISE,
    RADIUS,
    WIDTH,
    boxes_at,
    channel_image,
    empty_channel,
    seen_of,
)


def trust_of(frames: range, rng: np.random.Generator) -> Trust:
    """Frames of the drawn channel whose droplets are known."""
    seen = [seen_of(channel_image(frame, rng), boxes_at(frame), frame) for frame in frames]
    return Trust(seen=tuple(seen), by_tracks=True, n_tracks=6)


@pytest.fixture(scope="module")
def measured() -> Measured:
    return measure(trust_of(range(30), np.random.default_rng(4)), [])


def test_the_background_is_what_was_drawn_behind_the_droplets(measured: Measured) -> None:
    """Droplets cover the middle of the channel half of the time; the noise of a median is less."""
    (view,) = measured.set_up.views
    difference = view.background[..., 0] - empty_channel()
    assert np.abs(difference).max() < 4 * NOISE
    assert np.abs(difference.mean()) < 0.5
    assert difference.std() < NOISE / 2


def test_where_droplets_never_leave_the_background_continues_what_is_around() -> None:
    """One frame only: the median knows nothing of what is behind its droplets."""
    rng = np.random.default_rng(5)
    image = background([seen_of(channel_image(3, rng), boxes_at(3))], 1)
    inside = outline_distance(boxes_at(3)[1], ELLIPSE, *_axes()) < -4
    assert inside.sum() > 500
    assert np.abs(image[inside, 0] - empty_channel()[inside]).mean() < 2 * NOISE


def test_two_views_of_a_camera_are_told_apart() -> None:
    rng = np.random.default_rng(6)
    one = [seen_of(channel_image(frame, rng), boxes_at(frame), frame) for frame in range(4)]
    other = [seen_of(np.roll(channel_image(f, rng), 60, 0), boxes_at(f), f) for f in range(4, 8)]
    assert sorted(views_of([*one, *other], related=False)) == [[0, 1, 2, 3], [4, 5, 6, 7]]


def test_diameters_noise_and_shape_are_those_drawn(measured: Measured) -> None:
    assert np.median(measured.diameters) == pytest.approx(2 * RADIUS, abs=0.01)
    assert measured.set_up.noise == pytest.approx(NOISE, rel=0.1)
    (view,) = measured.set_up.views
    assert view.profile.corners in (ELLIPSE, 1.0)  # of a disc they are the same
    assert not measured.set_up.dense


def test_the_grey_levels_of_a_filled_droplet_are_those_drawn(measured: Measured) -> None:
    """170 levels inside, none outside, half of them at the outline."""
    profile_of = measured.set_up.views[0].profile
    at, profile = profile_of.distances, profile_of.levels[:, 0]
    assert np.interp([-15, -5, -2], at, profile) == pytest.approx([170] * 3, abs=2)
    assert np.interp([2, 4], at, profile) == pytest.approx([0, 0], abs=1)
    assert 60 < np.interp(0, at, profile) < 110


def _axes() -> tuple[Float32s, Float32s]:
    x, y = np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32)
    return x + np.float32(0.5), y + np.float32(0.5)


def _rimmed(box: Floats, corners: float) -> Pixels:
    """A droplet with a dark rim 3 px within its outline, on 150."""
    distance = outline_distance(box, corners, *_axes())
    return np.round(150 - 70 * np.exp(-(((distance + 3) / 2) ** 2))).astype(np.uint8)


@pytest.mark.parametrize("corners", [ELLIPSE, 1.0, 0.5])
def test_rims_and_outlines_are_those_drawn(corners: float) -> None:
    boxes = [np.array([100.0 + 5 * k, 80, 110, 50]) for k in range(8)]
    seen = [seen_of(_rimmed(box, corners), box[None], k) for k, box in enumerate(boxes)]
    (view,) = measure(Trust(seen=tuple(seen), by_tracks=True, n_tracks=1), []).set_up.views
    assert view.profile.corners == corners
    at, levels = view.profile.distances, view.profile.levels[:, 0]
    assert at[levels.argmin()] == pytest.approx(-3, abs=0.5)
    assert levels.min() == pytest.approx(-70, abs=4)
    assert np.interp(-15, at, levels) == pytest.approx(0, abs=3)


def _filled(*, dense: bool) -> SetUp:
    """Bright droplets on black, without noise."""
    rng = np.random.default_rng(2)
    row, column = np.mgrid[1:5, 1:8].reshape(2, -1)
    packed = np.column_stack([38.0 * column, 36.0 * row, *np.full((2, 28), 37.0)])
    apart = np.array([[60.0, 60, 50, 40], [200, 90, 44, 44]])
    at = np.arange(-30, 3, 0.5)
    return SetUp(
        views=(
            View(
                background=np.zeros((HEIGHT, WIDTH, 1), np.uint8),
                frames=(packed if dense else apart, apart + rng.normal(0, 1, apart.shape)),
                profile=Profile(
                    distances=at,
                    levels=np.where(at < 0, 200.0, 0.0)[:, None],
                    corners=ELLIPSE,
                ),
            ),
        ),
        noise=0.0,
        dense=dense,
    )


@pytest.mark.parametrize("dense", [False, True])
def test_labels_of_drawn_images_are_where_the_droplets_are(dense: bool) -> None:
    """Found again as connected bright regions, to a pixel."""
    set_up = _filled(dense=dense)
    draw = OwnDroplets(replace(set_up, views=(replace(set_up.views[0]),)))
    n = 0
    for seed in range(6):
        image, boxes = draw(np.random.default_rng(seed))
        assert image.shape == (HEIGHT, WIDTH, 3)
        _, _, stats, _ = cv2.connectedComponentsWithStats((image[..., 0] > 90).astype(np.uint8))
        found = stats[1:, :4].astype(float)
        found[:, :2] += found[:, 2:] / 2
        for box in boxes:
            if (iou_matrix(box[None], boxes) > 0).sum() > 1 or dense:
                continue  # droplets that touch are one region
            assert np.abs(found - box).max(axis=1).min() < 1.5
            n += 1
        if dense:
            bright = image[..., 0] > 90
            for cx, cy, w, h in boxes:
                part = bright[
                    round(cy - h / 2) : round(cy + h / 2), round(cx - w / 2) : round(cx + w / 2)
                ]
                assert part.mean() > 0.7
            n += len(boxes)
    assert n > 8


def test_droplets_are_drawn_where_they_were_seen() -> None:
    """Of a channel along x, none is drawn beside it."""
    draw = OwnDroplets(measure(trust_of(range(20), np.random.default_rng(1)), []).set_up)
    for seed in range(5):
        _, boxes = draw(np.random.default_rng(seed))
        assert len(boxes)
        assert (np.abs(boxes[:, 1] - 80) < 14).all()
        assert boxes[:, 2:].max() == pytest.approx(2 * RADIUS, rel=0.4)


def test_pasted_droplets_are_real_ones_and_their_labels_fit(measured: Measured) -> None:
    crops = cut_out(measured, np.random.default_rng(0))
    assert len(crops) > 50
    n = 0
    for seed in range(5):
        image, boxes = paste(np.random.default_rng(seed), measured.set_up.views[0], crops)
        _, _, stats, _ = cv2.connectedComponentsWithStats((image[..., 0] > 105).astype(np.uint8))
        found = stats[1:, :4].astype(float)
        found[:, :2] += found[:, 2:] / 2
        for box in boxes:
            if (iou_matrix(box[None] * [1, 1, 1.1, 1.1], boxes) > 0).sum() == 1:
                assert np.abs(found - box).max(axis=1).min() < 2
                n += 1
    assert n > 8


def test_what_is_at_one_place_in_most_images_of_a_view_is_part_of_it() -> None:
    """A corner of the channel in four of five images, and something in one."""
    rng = np.random.default_rng(3)
    corner, once = np.array([300.0, 20, 30, 30]), np.array([100.0, 140, 20, 20])
    seen = [seen_of(channel_image(frame, rng), boxes_at(frame), frame) for frame in range(5)]
    doubtful = [[corner, once], [corner + 1], [corner], [corner - 1], []]
    seen = [
        replace(one, doubtful=np.array(boxes).reshape(-1, 4))
        for one, boxes in zip(seen, doubtful, strict=True)
    ]
    assert [one.doubtful.tolist() for one in without_structures(seen)] == [
        [once.tolist()],
        [],
        [],
        [],
        [],
    ]
    assert [len(one.doubtful) for one in without_structures(seen[:3])] == [2, 1, 1]


def test_what_is_painted_over_is_gone_and_the_rest_stays() -> None:
    rng = np.random.default_rng(3)
    image = channel_image(3, rng)[..., None]
    behind = np.round(empty_channel()).astype(np.uint8)[..., None]
    painted = painted_over(image, boxes_at(3)[1:2], behind)
    gone = outline_distance(boxes_at(3)[1], ELLIPSE, *_axes()) < 0
    assert np.abs(painted[gone].astype(int) - behind[gone]).max() < 30
    far = outline_distance(boxes_at(3)[1], ELLIPSE, *_axes()) > 20
    assert (painted[far] == image[far]).all()


def test_a_set_up_is_read_as_it_was_written(measured: Measured, tmp_path: Path) -> None:
    path = tmp_path / "set_up.npz"
    write_set_up(path, measured.set_up)
    again = read_set_up(path)
    assert (again.noise, again.dense) == (measured.set_up.noise, measured.set_up.dense)
    for one, other in zip(again.views, measured.set_up.views, strict=True):
        np.testing.assert_array_equal(one.background, other.background)
        np.testing.assert_array_equal(one.profile.levels, other.profile.levels)
        np.testing.assert_array_equal(one.profile.distances, other.profile.distances)
        assert one.profile.corners == other.profile.corners
        for boxes, same in zip(one.frames, other.frames, strict=True):
            np.testing.assert_array_equal(boxes, same)
    image, boxes = image_source(str(path))(np.random.default_rng(0))
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert len(boxes)


def test_a_file_that_is_no_set_up_is_named(tmp_path: Path) -> None:
    path = tmp_path / "set_up.npz"
    path.write_bytes(b"PK nothing")
    with pytest.raises(DroptrackError, match=r"set_up\.npz"):
        read_set_up(path)
    with pytest.raises(DroptrackError, match="no such file"):
        image_source(str(tmp_path / "absent.npz"))


def test_the_part_of_an_image_under_a_box_is_cut_at_the_edges() -> None:
    rows, columns, x, y = part_of(np.array([5.0, 50, 20, 10]), (100, 60), 2)
    assert (rows, columns) == (slice(43, 57), slice(0, 17))
    assert (x[0], x[-1], y[0], y[-1]) == (0.5, 16.5, 43.5, 56.5)


def test_images_are_learned_from_in_the_shape_that_the_network_is_shown() -> None:
    """100 x 60 px at half the scale: an input of 64 x 32 px shows 128 x 64 of the image's px."""
    canvas = Canvas.of(100, 60, 0.5)
    image = np.arange(100 * 60, dtype=np.uint32).reshape(60, 100, 1).astype(np.uint8)
    extended = _extended(image, canvas)
    assert (canvas.network, extended.shape) == ((64, 32), (64, 128, 1))
    np.testing.assert_array_equal(extended[:60, :100], image)
    assert (extended[:60, 100:] == image[:, -1:]).all()


def test_kinds_of_images_are_mixed_in_their_shares() -> None:
    kinds = _in_turn({"seen": 0.5, "drawn": 0.3, "known": 0.2}, 100)
    assert [kinds.count(kind) for kind in ("seen", "drawn", "known")] == [50, 30, 20]
    assert {kinds[:10].count(kind) for kind in ("seen", "drawn", "known")} == {5, 3, 2}


def test_droplets_too_small_or_large_for_a_network_are_not_taught() -> None:
    """At half the scale: 8 to 240 px of its input, and more than 6 px in the smaller direction."""
    sides = np.array([[14, 14], [17, 17], [40, 11], [40, 13], [470, 470], [490, 490.0]])
    boxes = np.column_stack([np.zeros((6, 2)), sides])
    assert taught(boxes, 0.5)[:, 2].tolist() == [17, 40, 470]
