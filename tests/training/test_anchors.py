"""Anchors for sizes whose clusters are known."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.anchors import app
from droptrack.data.darknet_dataset import read_data_file, write_data_file
from droptrack.network.darknet_cfg import read_cfg, yolo_heads
from droptrack.training.anchors import box_sizes, find_anchors, mean_best_iou, shape_iou

MINI = Path(__file__).parents[1] / "reference" / "mini.cfg"


def test_ious_counted_by_hand() -> None:
    """4 x 2 within 4 x 4: 8/16; 2 x 8 and 4 x 4 share 2 x 4: 8 / (16 + 16 - 8)."""
    sizes = np.array([[4.0, 2], [2, 8], [4, 4]])
    assert shape_iou(sizes, np.array([[4.0, 4]]))[:, 0] == pytest.approx([1 / 2, 1 / 3, 1])
    assert mean_best_iou(sizes, sizes) == 1


def test_clusters_are_found_again() -> None:
    rng = np.random.default_rng(4)
    centres = np.array([[8.0, 8], [20, 40], [40, 20], [90, 80]])
    spread = rng.normal(1, 0.03, (4, 200, 2))
    sizes = (centres[:, None] * spread).reshape(-1, 2)
    found = find_anchors(sizes, 4, rng)
    assert np.diff(found.prod(axis=1)).min() >= -25  # 20 x 40 and 40 x 20 are equally large
    ious = shape_iou(centres, found)
    assert (ious.max(axis=1) > 0.98).all()
    assert sorted(ious.argmax(axis=1)) == [0, 1, 2, 3]
    with pytest.raises(ValueError, match="as many different"):
        find_anchors(np.ones((5, 2)), 2, rng)


def test_the_command_writes_them_into_a_copy(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    for i, (w, h) in enumerate([(0.05, 0.1), (0.1, 0.2), (0.25, 0.3)]):
        (tmp_path / "train" / f"{i:06d}.jpg").touch()
        (tmp_path / "train" / f"{i:06d}.txt").write_text(f"0 0.5 0.5 {w} {h}\n" * 3)
    data = write_data_file(tmp_path, ("droplet",), {"train": 3, "valid": 1})
    sizes = box_sizes(read_data_file(data), 160, 96)
    assert sizes[0] == pytest.approx([8, 9.6])
    copy, figure = tmp_path / "copy.cfg", tmp_path / "anchors.png"
    arguments = ["--data", str(data), "--cfg", str(MINI)]
    result = CliRunner().invoke(app, [*arguments, "--write", str(copy), "--figure", str(figure)])
    assert result.exit_code == 0, result.output
    assert "found: mean IoU 1.0000" in result.output
    (head,) = yolo_heads(read_cfg(copy))
    np.testing.assert_allclose(head.all_anchors, [[8, 9.6], [16, 19.2], [40, 28.8]])
    assert figure.stat().st_size > 5000
    again = CliRunner().invoke(app, [*arguments, "--write", str(copy)])
    assert "copy.cfg: is there already" in again.output
