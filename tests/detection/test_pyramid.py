"""Several scales, each for the sizes it is good for."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.data.stage_times import StageTimes
from droptrack.detection.pyramid import MARGIN, Pyramid, Sizes, levels_for
from droptrack.detection.scale import parse_diameter
from droptrack.errors import DroptrackError


class Sees:
    """Stands for a detector that always finds the same boxes, with the same scores."""

    max_iou = 0.3

    def __init__(self, boxes: Sequence[tuple[float, ...]], scores: Sequence[float]) -> None:
        self._found = Detections(
            np.array(boxes, float).reshape(-1, 4), np.array(scores), np.zeros(len(scores), int)
        )

    def start(self, frames: Sequence[Frame], _: StageTimes) -> Callable[[], list[Detections]]:
        return lambda: [self._found] * len(frames)


FRAME = np.zeros((100, 100, 3), np.uint8)


def pyramid(*levels: tuple[Sizes, Any]) -> Pyramid:
    return Pyramid(levels)


def test_each_level_counts_for_its_sizes_only() -> None:
    small = Sees([(20, 20, 10, 10), (60, 60, 50, 50)], [0.9, 0.9])
    large = Sees([(20, 20, 11, 11), (60, 60, 52, 52)], [0.95, 0.8])
    both = pyramid((Sizes(5, 20), small), (Sizes(20, 80), large))
    (found,) = both.detect([FRAME])
    assert sorted(found.boxes[:, 2].tolist()) == [10, 52]


def test_a_droplet_between_two_levels_is_seen_once() -> None:
    small = Sees([(50, 50, 21, 21)], [0.7])
    large = Sees([(50, 50, 19, 19)], [0.9])
    both = pyramid((Sizes(5, 20), small), (Sizes(20, 80), large))
    one, two = both.detect([FRAME, FRAME])
    assert one.scores.tolist() == two.scores.tolist() == [0.9]


def test_sizes_beyond_the_range_do_not_count() -> None:
    sees = Sees([(50, 50, 4, 4), (50, 50, 95, 95), (20, 20, 10, 40)], [0.9, 0.9, 0.9])
    (found,) = pyramid((Sizes(10, 60), sees)).detect([FRAME])
    assert found.boxes.tolist() == [[20, 20, 10, 40]]  # sqrt(w h) = 20


@pytest.mark.parametrize(("smallest", "largest", "n"), [(10, 60, 1), (10, 61, 2), (5, 1000, 3)])
def test_levels_cover_the_range_in_equal_ratios(smallest: float, largest: float, n: int) -> None:
    levels = levels_for(smallest, largest)
    assert len(levels) == n
    ratios = [level.largest / level.smallest for level in levels]
    assert np.prod(ratios) == pytest.approx(largest / smallest, rel=1e-4)
    assert max(ratios) == pytest.approx(min(ratios), rel=1e-4)
    # each level shows its sizes within a factor of sqrt(6) of 40 px
    for level in levels:
        assert level.smallest * level.scale >= 40 / 2.46
        assert level.largest * level.scale <= 40 * 2.46
    assert MARGIN > 1


@pytest.mark.parametrize("text", ["", "-", "40-", "40-20", "a-b", "0", "5-6-7", "nan", "inf"])
def test_what_is_no_diameter_is_refused(text: str) -> None:
    with pytest.raises(DroptrackError, match="--diameter"):
        parse_diameter(text)


def test_small_and_large_droplets_of_one_image(tmp_path: Path) -> None:
    """Discs of 9 and of 260 px by hand: none of them is missed, and there are no others."""
    canvas = Image.new("L", (900, 700))
    draw = ImageDraw.Draw(canvas)
    small = [(100.0 + 60 * k, 620.0) for k in range(12)]
    large = [(200.0, 250.0), (600.0, 300.0)]
    for (x, y), r in [(p, 4.5) for p in small] + [(p, 130.0) for p in large]:
        draw.ellipse([x - r, y - r, x + r, y + r], fill=255)
    canvas.save(tmp_path / "image.png")
    out = tmp_path / "out"
    arguments = ["detect", str(tmp_path / "image.png"), "--out", str(out), "--diameter", "8-280"]
    result = CliRunner().invoke(app, [*arguments, "--precision", "fp32"])
    assert result.exit_code == 0, result.output
    report = json.loads((out / "report.json").read_text())
    scales = [float(scale) for scale in report["settings"]["scale"]]
    assert scales == pytest.approx([2.07, 0.35], rel=0.1)
    table = np.genfromtxt(out / "detections.csv", delimiter=",", names=True, encoding="utf-8")
    places = np.column_stack([table["x"], table["y"]])
    assert len(places) == len(small) + len(large)
    away = np.hypot(*(places[:, None] - np.array(small + large)).transpose(2, 0, 1))
    assert away.min(axis=0).max() < 1
