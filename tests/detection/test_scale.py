"""The network's input fits the frame: never stretched, extended by its edge, boxes in its px."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.scenes.shapes import draw_ellipses
from droptrack.__main__ import app
from droptrack.data.detections import labels
from droptrack.data.frames import grey_frame
from droptrack.detection.engine_choice import Network, Precision, choose_detector
from droptrack.detection.scale import STRIDE, Canvas
from droptrack.network.bundled import find_network
from droptrack.network.darknet_cfg import resized


@pytest.mark.parametrize("size", [(1200, 600), (768, 768), (333, 517), (31, 2000)])
@pytest.mark.parametrize("scale", [0.25, 0.8, 1.7])
def test_a_canvas_holds_the_frame_and_has_the_inputs_shape(
    size: tuple[int, int], scale: float
) -> None:
    canvas = Canvas.of(*size, scale)
    assert all(side % STRIDE == 0 for side in canvas.network)
    for network, whole, frame in zip(canvas.network, canvas.size, size, strict=True):
        assert whole >= frame
        assert network == pytest.approx(whole * scale, abs=scale)  # within a px of the frame
        assert whole - frame < STRIDE / scale + 1


def test_a_frame_lies_at_the_canvas_corner_and_its_edge_goes_on() -> None:
    canvas = Canvas.of(40, 30, 1.0)
    frame = np.arange(40 * 30 * 3, dtype=np.uint8).reshape(30, 40, 3)
    extended = canvas.extended(frame)
    assert extended.shape == (32, 64, 3)
    np.testing.assert_array_equal(extended[:30, :40], frame)
    np.testing.assert_array_equal(extended[:30, 40:], np.repeat(frame[:, -1:], 24, axis=1))
    grey = canvas.extended(grey_frame(frame[..., 0]))
    np.testing.assert_array_equal(grey[..., 0], extended[..., 0])
    assert grey.strides[2] == 0
    found = canvas.within(labels([[39, 20, 8, 8], [44, 20, 8, 8]]))
    assert found.boxes[:, 0].tolist() == [39]


def test_discs_of_a_square_image_are_found_as_discs() -> None:
    """Their places and diameters, px, and boxes as wide as high."""
    discs = np.array([[100.0, 120, 30, 30, 0], [300, 250, 40, 40, 0], [420, 90, 25, 25, 0]])
    image = np.zeros((500, 500), np.uint8)
    draw_ellipses(image, discs, 255)
    cfg, weights = find_network()
    canvas = Canvas.like(500, 500, (cfg.width, cfg.height))
    network = Network(
        resized(cfg, *canvas.network), weights, threshold=0.4, max_iou=0.3, canvas=canvas
    )
    (found,) = choose_detector(network, precision=Precision.fp32).detect([grey_frame(image)])
    boxes = found.boxes[np.argsort(found.boxes[:, 0])]
    np.testing.assert_allclose(boxes[:, :2], discs[:, :2], atol=1.5)
    np.testing.assert_allclose(boxes[:, 2:], 2 * discs[:, 2:4], rtol=0.06)
    np.testing.assert_allclose(boxes[:, 2] / boxes[:, 3], 1, atol=0.05)


def test_the_scale_or_a_droplets_diameter_can_be_given(sine: Path, tmp_path: Path) -> None:
    def track(*options: str) -> "tuple[int, str]":
        arguments = ["track", str(sine / "video.avi"), "--out", str(tmp_path), "--no-video"]
        arguments += ["--overwrite"]
        result = CliRunner().invoke(app, [*arguments, "--max-frames", "2", *options])
        return result.exit_code, result.output

    assert track("--scale", "0.5")[0] == 0
    settings = json.loads((tmp_path / "report.json").read_text())["settings"]
    assert settings["network_size"] == [608, 320]
    assert settings["scale"] == pytest.approx(0.5, abs=0.01)
    assert track("--diameter", "50")[0] == 0
    assert json.loads((tmp_path / "report.json").read_text())["settings"]["scale"] == pytest.approx(
        0.8, abs=0.01
    )
    code, said = track("--scale", "0.5", "--diameter", "50")
    assert code == 1
    assert "--scale and --diameter" in said
    code, said = track("--scale", "20")
    assert code == 1
    assert "24000 x 12000" in said
