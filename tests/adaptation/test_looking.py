"""What the network sees before it is adapted: at one scale, since it learns at one."""

from pathlib import Path

import cv2
import numpy as np

from droptrack.adaptation.looking import open_looks
from droptrack.network.bundled import FOOTAGE
from droptrack.pipeline.config import DetectorConfig
from tests.adaptation.drawn import shot_of


def test_droplets_that_tracking_sees_at_two_scales_are_learned_at_one() -> None:
    """72 dark rings of 30 px and 6 of 250: `open_detector` would take two."""
    image = np.full((1100, 1000), 150, np.uint8)
    for x in range(30, 1000, 80):
        for y in range(30, 400, 70):
            cv2.circle(image, (x, y), 14, 60, 2, cv2.LINE_AA)
    for x in (180, 500, 820):
        for y in (590, 910):
            cv2.circle(image, (x, y), 120, 60, 12, cv2.LINE_AA)
    said: list[str] = []
    looks = open_looks(DetectorConfig(weights=Path(FOOTAGE)), [shot_of(image)], said.append)
    assert any("many sizes" in one for one in said)
    assert not looks.opened.has_levels
    assert f"--scale {looks.scale:.2f}" in " ".join(said)
