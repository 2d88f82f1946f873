"""What a network learns from: images changed at random, and the processes that prepare them."""

import subprocess
import sys
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from droptrack.data.darknet_dataset import DataSet
from droptrack.data.frames import grey_frame
from droptrack.network.darknet_cfg import read_cfg
from droptrack.training.pytorch.images import (
    Augmentation,
    Batches,
    TrainingImages,
    augment,
    share_by_files,
)

SMALL = Path(__file__).parents[1] / "reference/small-yolov3.cfg"


def test_a_worker_is_sent_little_however_many_images_there_are() -> None:
    """More than a pipe holds would have to wait for each worker's start, one after the other."""
    images = tuple(Path(f"/data/train/{n:06d}.jpg") for n in range(40_000))
    many = DataSet(Path("obj.data"), ("droplet",), images, ())
    share_by_files()
    how = Augmentation.of(read_cfg(SMALL), None, None)
    prepared = TrainingImages(many, how, None)
    sent = ForkingPickler.dumps(prepared)
    assert len(sent) < 8192 < len(ForkingPickler.dumps(many.train))
    assert list(prepared.paths) == list(many.train)
    assert len(prepared) == len(many.train)


KEPT = """
import os
from droptrack.training.pytorch.devices import leave_open_files_to_no_other

ends = os.pipe()
for end in ends:
    os.set_inheritable(end, True)
leave_open_files_to_no_other()
print(*[os.get_inheritable(end) for end in (1, *ends)])
"""


def test_what_a_worker_starts_inherits_no_file_of_it() -> None:
    """The pipe by which its end is seen would stay open: 5 s for each worker."""
    said = subprocess.run(
        [sys.executable, "-c", KEPT], capture_output=True, text=True, check=True, timeout=300
    ).stdout
    assert said == "True False False\n"


def test_every_image_is_used_once_before_any_is_used_again() -> None:
    batches = list(Batches(n=12, batch=4, start=0, stop=6, seed=1, random=(0.5, 2)))
    indices = [item[0] for batch in batches for item in batch]
    assert sorted(indices[:12]) == sorted(indices[12:]) == list(range(12))
    assert indices[:12] != indices[12:]
    later = list(Batches(n=12, batch=4, start=4, stop=6, seed=1, random=(0.5, 2)))
    assert later == batches[4:]
    factors = {batch[0][2] for batch in batches}
    assert len(factors) == 6
    assert all(0.5 <= factor <= 2 for factor in factors)


def test_only_droplets_of_the_sizes_wanted_have_labels_and_some_images_are_negatives() -> None:
    """By hand: at half of its size, an image's squares are 6, 15, 40 and 150 px, a plate 40 x 5."""
    how = Augmentation(
        size=(800, 400),
        window=(800, 400),
        jitter=0,
        random=(1, 1),
        saturation=1,
        exposure=1,
        hue=0,
        flip=False,
        droplets=(8, 100),
        negatives=0.3,
    )
    sides = np.array([[12, 12], [30, 30], [80, 80], [300, 300], [80, 10.0]])
    places = np.array([[100, 100], [300, 100], [600, 100], [600, 500], [200, 600.0]])
    boxes = np.hstack([places, sides]) / [1600, 800, 1600, 800]
    image = np.full((800, 1600, 3), 40, np.uint8)
    rng = np.random.default_rng(3)
    levels = []
    for _ in range(200):
        shown, truths = augment(rng, image, np.zeros(5, np.int64), boxes, how, 1.0)
        np.testing.assert_allclose(sorted(truths[:, 3] * 800), [15, 40], rtol=1e-5)
        levels.append(int(shown[0, 0, 0]))
    assert set(levels) == {40, 215}
    assert levels.count(215) == pytest.approx(60, abs=20)


def test_a_grey_image_is_changed_as_three_equal_channels_are() -> None:
    plane = np.random.default_rng(1).integers(0, 256, (90, 120), np.uint8)
    how = replace(Augmentation.of(read_cfg(SMALL), (64, 64), None), negatives=0.5)
    boxes = np.array([[0.5, 0.5, 0.2, 0.3]])
    for seed in range(4):
        one, other = (
            augment(np.random.default_rng(seed), image, np.zeros(1, np.int64), boxes, how, 1.0)
            for image in (grey_frame(plane), np.ascontiguousarray(grey_frame(plane)))
        )
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.parametrize("window", [(416, 224), (832, 416)])
def test_augmented_boxes_stay_on_their_droplets(window: tuple[int, int]) -> None:
    """Draw squares, change the image at random, and find them again where the boxes say."""
    rng = np.random.default_rng(7)
    image = np.zeros((600, 1200, 3), np.uint8)
    boxes = np.array([[200, 100, 80, 60], [640, 320, 60, 60], [1000, 480, 100, 40.0]])
    for x, y, w, h in boxes.astype(int):
        image[y - h // 2 : y + h // 2, x - w // 2 : x + w // 2] = 255
    how = Augmentation(
        size=(832, 416),
        window=window,
        jitter=0.2,
        random=(1, 1),
        saturation=1.5,
        exposure=1.5,
        hue=0.1,
        flip=True,
    )
    seen = 0
    for _ in range(30):
        augmented, truths = augment(
            rng, image, np.zeros(3, np.int64), boxes / [1200, 600, 1200, 600], how, 1.0
        )
        mask = (augmented[..., 0] > augmented.max() / 2).astype(np.uint8)
        _, _, stats, _ = cv2.connectedComponentsWithStats(mask)
        found = stats[1:, :4].astype(float)
        found[:, :2] += found[:, 2:] / 2
        wanted = truths[:, 1:] * [window[0], window[1], window[0], window[1]]
        for box in wanted:
            assert np.abs(found - box).max(axis=1).min() < 1.5
        seen += len(wanted)
    assert seen > 30
