"""What the network sees before it is adapted: at one scale, since it learns at one."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from droptrack.adaptation.looking import open_looks
from droptrack.detection.scale import STRIDE
from droptrack.network.bundled import FOOTAGE
from droptrack.pipeline.config import DetectorConfig
from droptrack.pipeline.open_detector import open_detector
from tests.adaptation.drawn import shot_of


def test_droplets_that_tracking_sees_at_two_scales_are_learned_at_one() -> None:
    """66 dark rings of 14 px and 4 of 400: `open_detector` would take two."""
    image = np.full((1200, 1000), 150, np.uint8)
    for x in range(30, 1000, 44):
        for y in (30, 90, 150):
            cv2.circle(image, (x, y), 7, 60, 1, cv2.LINE_AA)
    for x in (250, 720):
        for y in (430, 880):
            cv2.circle(image, (x, y), 195, 60, 12, cv2.LINE_AA)
    said: list[str] = []
    config = DetectorConfig(weights=Path(FOOTAGE))
    looks = open_looks(config, [shot_of(image)], said.append)
    assert any("many sizes" in one for one in said)
    assert looks.opened.alone is None
    assert f"--scale {looks.scale:.2f}" in " ".join(said)
    frames = [shot_of(image).frame]
    two = open_detector(config, (1000, 1200), lambda: frames, live=False, say=said.append)
    assert two.alone is not None
    assert two.alone == pytest.approx(looks.scale, rel=0.01)
    assert 0 <= two.cfg.width - 1000 * two.scale < STRIDE  # both are of the finer one
    assert two.scale > two.alone
