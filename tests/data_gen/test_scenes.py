import cv2
import numpy as np
import pytest

from data_gen.scenes.scene_kinds import HEIGHT, SCENES, WIDTH, Scene, _bending
from droptrack.data.detections import iou_matrix

MANY = range(25)


def scenes(kind: str) -> list[Scene]:
    return [SCENES[kind](np.random.default_rng([5, number])) for number in MANY]


@pytest.mark.parametrize("kind", SCENES)
def test_images_are_1200_x_600_and_hold_every_droplet_whole(kind: str) -> None:
    for scene in scenes(kind):
        assert scene.image.shape == (HEIGHT, WIDTH) == (600, 1200)
        half = scene.boxes[:, 2:] / 2
        assert (scene.boxes[:, :2] - half >= 0).all()
        assert (scene.boxes[:, :2] + half <= [WIDTH, HEIGHT]).all()


@pytest.mark.parametrize("kind", "abc")
def test_white_regions_are_where_the_labels_say(kind: str) -> None:
    """Connected regions, found by OpenCV, against the labels."""
    compared = total = 0
    for scene in scenes(kind):
        n, _, stats, centres = cv2.connectedComponentsWithStats(
            (scene.image > 128).astype(np.uint8)
        )
        regions = range(1, n)
        if kind == "b":  # the white around the shell is no droplet
            regions = range(2, n)
            assert n - 2 == len(scene.boxes) == 2
        total += len(scene.boxes)
        for region in regions:
            inside = (
                np.abs(scene.boxes[:, :2] - centres[region] - 0.5) < scene.boxes[:, 2:] / 2
            ).all(1)
            if (
                inside.sum() != 1
                or stats[region][2:4].max() > 1.5 * scene.boxes[inside][0, 2:].max()
            ):
                continue  # touching droplets
            box = scene.boxes[inside][0]
            x, y, w, h, _ = stats[region]
            found = np.array([x + w / 2, y + h / 2, w, h])
            assert np.abs(found - box).max() < 1.2
            compared += 1
    assert compared > (0.5 if kind == "c" else 0.95) * total


def test_scattered_droplets_are_both_discs_and_ellipses_and_do_not_overlap() -> None:
    boxes = [scene.boxes for scene in scenes("a")]
    aspects = np.concatenate([b[:, 2] / b[:, 3] for b in boxes])
    assert 0.3 < (np.abs(aspects - 1) < 1e-9).mean() < 0.7
    for b in boxes:
        iou = iou_matrix(b, b) - np.eye(len(b))
        assert iou.max() < 0.2  # boxes may overlap, droplets may not


def test_double_emulsion_has_two_white_cores_in_black_on_white() -> None:
    for scene in scenes("b"):
        assert scene.image[0, 0] == scene.image[-1, -1] == 255
        assert len(scene.boxes) == 2
        for cx, cy, w, _ in scene.boxes:
            assert scene.image[int(cy), int(cx)] == 255
            assert scene.image[int(cy), int(cx + w / 2 + 2)] < 128


def test_dense_clusters_nearly_touch_and_never_overlap() -> None:
    gaps = []
    for scene in scenes("c"):
        centres, radii = scene.boxes[:, :2], scene.boxes[:, 2] / 2
        if len(radii) < 2:
            continue
        distance = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
        np.fill_diagonal(distance, np.inf)
        gap = distance - radii[:, None] - radii[None]
        assert gap.min() > -1e-9
        gaps.append(np.median(gap.min(axis=1)))
    assert np.median(gaps) < 6


def test_bending_keeps_the_area_of_a_droplet() -> None:
    t = np.arange(2000) * 2 * np.pi / 2000
    disc = 300 + 20 * np.column_stack([np.cos(t), np.sin(t)])
    for seed in range(20):
        x, y = _bending(np.random.default_rng(seed), 20.0)(disc).T
        area = abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2
        assert area == pytest.approx(np.pi * 20**2, rel=1e-3)


@pytest.mark.parametrize("kind", SCENES)
def test_same_seed_gives_the_same_image(kind: str) -> None:
    first, second = (SCENES[kind](np.random.default_rng(9)) for _ in range(2))
    assert (first.image == second.image).all()
    assert (first.boxes == second.boxes).all()
