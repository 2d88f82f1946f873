"""Exported networks, run by ONNX Runtime, against OpenCV's reading of Darknet's files."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

onnx = pytest.importorskip("onnx", reason="needs the extra [openvino]")
runtime = pytest.importorskip("onnxruntime", reason="needs the extra [dev]")

from bench.random_network import random_weights
from droptrack.__main__ import app
from droptrack.detection.decoding import decode_head
from droptrack.errors import DroptrackError
from droptrack.network.bundled import BUNDLED
from droptrack.network.darknet_cfg import (
    Cfg,
    cfg_text,
    parse_cfg,
    read_cfg,
    resized,
    with_options,
    yolo_heads,
)
from droptrack.network.darknet_weights import Weights, write_weights
from droptrack.network.onnx_export import onnx_model

Float32s = NDArray[np.float32]

CONVOLUTION = """[convolutional]
batch_normalize=1
filters={}
size={}
stride={}
pad=1
activation={}
"""


def convolution(filters: int, size: int = 3, stride: int = 1, activation: str = "leaky") -> str:
    return CONVOLUTION.format(filters, size, stride, activation)


def head(mask: str, more: str = "") -> str:
    return f"""[convolutional]
size=1
filters=21
activation=linear
[yolo]
mask={mask}
anchors=8,9, 14,12, 20,24, 31,30, 44,60, 60,52, 90,80, 70,120, 140,150
classes=2
num=9
{more}
"""


NET = "[net]\nwidth=96\nheight=64\nchannels=3\n"

# what yolov4-tiny has beyond yolov3: half a layer's channels, mish, and boxes beyond their cells
LIKE_YOLOV4_TINY = (
    NET
    + convolution(8, stride=2)
    + convolution(16, stride=2, activation="mish")
    + "[route]\nlayers=-1\ngroups=2\ngroup_id=1\n"
    + convolution(8)
    + convolution(8)
    + "[route]\nlayers=-1,-2\n"
    + convolution(16, 1)
    + "[route]\nlayers=-6,-1\n"
    + "[maxpool]\nsize=2\nstride=2\n"
    + convolution(16, stride=2)
    + head("3,4,5", "scale_x_y=1.05")
    + "[route]\nlayers=-3\n"
    + convolution(8, 1)
    + "[upsample]\nstride=2\n"
    + "[route]\nlayers=-1,8\n"
    + head("0,1,2", "scale_x_y=1.2")
)

# what yolov3-tiny_3l has beyond yolov3-tiny: a third grid, after another upsampling
LIKE_YOLOV3_TINY_3L = (
    NET
    + convolution(8, stride=2)
    + convolution(8, stride=2)
    + "[maxpool]\nsize=2\nstride=2\n"
    + convolution(16)
    + "[maxpool]\nsize=2\nstride=1\n"
    + convolution(16)
    + "[maxpool]\nsize=2\nstride=2\n"
    + convolution(16)
    + head("6,7,8")
    + "[route]\nlayers=-3\n"
    + "[upsample]\nstride=2\n"
    + "[route]\nlayers=-1,5\n"
    + head("3,4,5")
    + "[route]\nlayers=-3\n"
    + "[upsample]\nstride=2\n"
    + "[route]\nlayers=-1,1\n"
    + head("0,1,2")
)

CFGS = {
    "yolov3": read_cfg(BUNDLED / "yolov3.cfg"),
    "yolov3-tiny": read_cfg(BUNDLED / "yolov3-tiny.cfg"),
    "like yolov3-tiny_3l": parse_cfg(LIKE_YOLOV3_TINY_3L, Path("3l.cfg")),
    "like yolov4-tiny": parse_cfg(LIKE_YOLOV4_TINY, Path("4.cfg")),
}


def run(model: Any, images: NDArray[np.generic]) -> list[Float32s]:
    onnx.checker.check_model(model, full_check=True)
    session = runtime.InferenceSession(model.SerializeToString())
    return [np.asarray(output, np.float32) for output in session.run(None, {"images": images})]


def by_opencv(cfg: Cfg, weights: Weights, images: Float32s, folder: Path) -> Float32s:
    """Rows (N, 5 + C) of all heads as OpenCV reads Darknet's files."""
    write_weights(folder / "random.weights", weights)
    text = cfg_text(with_options(cfg, {}, {"thresh": "0.000001"}))
    (folder / "cfg").write_text(text)
    network = cv2.dnn.readNetFromDarknet(str(folder / "cfg"), str(folder / "random.weights"))
    network.setInput(images)
    outputs = network.forward(network.getUnconnectedOutLayersNames())
    return np.concatenate([np.asarray(output) for output in outputs])


def cell_by_cell(rows: Float32s, cfg: Cfg) -> Float32s:
    """Our rows, head by head and anchor by anchor, in OpenCV's order: anchors within cells."""
    parts, start = [], 0
    for yolo in yolo_heads(cfg):
        n_cells = cfg.width * cfg.height // yolo.stride**2
        end = start + len(yolo.mask) * n_cells
        parts.append(rows[start:end].reshape(len(yolo.mask), n_cells, -1).transpose(1, 0, 2))
        start = end
    return np.concatenate([part.reshape(-1, rows.shape[1]) for part in parts])


@pytest.mark.parametrize("name", CFGS)
def test_the_decoded_boxes_are_those_of_opencv(name: str, tmp_path: Path) -> None:
    cfg = resized(CFGS[name], 96, 64)
    rng = np.random.default_rng(1)
    weights = random_weights(cfg, rng)
    images = rng.random((1, 3, 64, 96), np.float32)
    expected = by_opencv(cfg, weights, images, tmp_path)
    (found,) = run(onnx_model(cfg, weights, decode=True), images)
    rows = cell_by_cell(found[0], cfg)
    rows[:, 5:] *= rows[:, 4:5]  # OpenCV's probabilities are multiplied by the objectness
    np.testing.assert_allclose(rows, expected, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["yolov3-tiny", "like yolov3-tiny_3l", "like yolov4-tiny"])
def test_raw_maps_decode_to_what_is_decoded_in_the_graph(name: str) -> None:
    cfg = resized(CFGS[name], 96, 64)
    rng = np.random.default_rng(2)
    weights = random_weights(cfg, rng)
    images = rng.random((2, 3, 64, 96), np.float32)
    maps = run(onnx_model(cfg, weights), images)
    (decoded,) = run(onnx_model(cfg, weights, decode=True), images)
    for image in range(2):
        rows = []
        for raw, yolo in zip(maps, yolo_heads(cfg), strict=True):
            apart = raw[image].reshape(len(yolo.mask), -1, *raw.shape[2:])
            rows.append(decode_head(apart, yolo, 1e-9))
        np.testing.assert_allclose(np.concatenate(rows), decoded[image], rtol=1e-5, atol=1e-6)


def test_any_batch_gives_what_single_images_give() -> None:
    cfg = CFGS["like yolov4-tiny"]
    rng = np.random.default_rng(3)
    model = onnx_model(cfg, random_weights(cfg, rng))
    images = rng.random((3, 3, 64, 96), np.float32)
    for number, together in enumerate(run(model, images)):
        for image in range(3):
            alone = run(model, images[image : image + 1])[number]
            np.testing.assert_allclose(together[image], alone[0], atol=1e-5)


def test_a_grey_image_of_bytes_gives_what_its_three_channels_give() -> None:
    cfg = CFGS["like yolov4-tiny"]
    rng = np.random.default_rng(4)
    weights = random_weights(cfg, rng)
    grey = rng.integers(0, 256, (1, 1, 64, 96)).astype(np.uint8)
    colour = np.repeat(grey, 3, axis=1).astype(np.float32) / np.float32(255)
    expected = run(onnx_model(cfg, weights), colour)
    for found, wanted in zip(
        run(onnx_model(cfg, weights, pixels=True, grey=True), grey), expected, strict=True
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-4)


@pytest.mark.parametrize("name", ["yolov3-tiny", "like yolov3-tiny_3l", "like yolov4-tiny"])
def test_opencv_reads_the_exported_network(name: str) -> None:
    """OpenCV 5 has no other way to a Darknet network."""
    cfg = resized(CFGS[name], 96, 64)
    rng = np.random.default_rng(5)
    model = onnx_model(cfg, random_weights(cfg, rng))
    images = rng.random((2, 3, 64, 96), np.float32)
    network = cv2.dnn.readNetFromONNX(np.frombuffer(model.SerializeToString(), np.uint8))
    network.setInput(images)
    outputs = network.forward([f"head_{number}" for number in range(len(yolo_heads(cfg)))])
    for found, expected in zip(outputs, run(model, images), strict=True):
        np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("[reorg]\nstride=2\n", r"line 5: layer \[reorg\] is not supported"),
        (convolution(8, activation="swish"), "line 5: activation=swish is not supported"),
        (head("0,1,2", "new_coords=1"), r"line 9: \[yolo\] new_coords=1 is not supported"),
    ],
)
def test_what_is_not_supported_is_named_with_its_line(section: str, message: str) -> None:
    def export() -> None:
        cfg = parse_cfg(NET + section + head("0,1,2"), Path("other.cfg"))
        onnx_model(cfg, random_weights(cfg, np.random.default_rng(0)))

    with pytest.raises(DroptrackError, match=message):
        export()


def test_the_command_exports_the_bundled_model(tmp_path: Path) -> None:
    out = tmp_path / "droplets.onnx"
    arguments = ["export", "--out", str(out), "--size", "96x64", "--decode"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "images (batch, 3, 64, 96) -> detections" in result.output
    session = runtime.InferenceSession(out)
    (rows,) = session.run(None, {"images": np.zeros((2, 3, 64, 96), np.float32)})
    assert rows.shape == (2, 3 * (3 * 2 + 6 * 4), 6)
    for size, message in (("96", "such as 960x480"), ("100x64", "nearest is 96")):
        arguments[-2] = size
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 1
        assert message in result.output
