"""Networks of the user's that describe the appearance of droplets."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from droptrack.errors import DroptrackError
from droptrack.tracking.appearance_network import NetworkAppearance

CFG = """[net]
width=16
height=8
channels=3

[convolutional]
filters=4
size=3
stride=1
pad=1
activation=leaky
"""


def darknet(folder: Path, rng: np.random.Generator) -> tuple[Path, Path, np.ndarray, np.ndarray]:
    """A network of one convolution, and its biases (4,) and weights (4, 3, 3, 3)."""
    cfg, weights = folder / "crop.cfg", folder / "crop.weights"
    cfg.write_text(CFG)
    biases = rng.normal(0, 1, 4).astype(np.float32)
    kernels = rng.normal(0, 1, (4, 3, 3, 3)).astype(np.float32)
    header = np.array([0, 2, 0, 0, 0], np.int32).tobytes()
    weights.write_bytes(header + biases.tobytes() + kernels.tobytes())
    return cfg, weights, biases, kernels


def test_a_darknet_network_gives_what_torch_computes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cfg, weights, biases, kernels = darknet(tmp_path, rng)
    frame = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    # crops of the input's size, so that nothing is resampled; more than one batch of them
    corners = rng.integers([0, 0], [64, 52], (100, 2))
    boxes = np.hstack([corners + np.array([8, 4]), np.tile([16, 8], (100, 1))]).astype(float)
    descriptors = NetworkAppearance(cfg, weights, (16, 8))(frame, boxes)
    crops = np.stack([frame[y : y + 8, x : x + 16, ::-1] for x, y in corners])
    inputs = torch.from_numpy(crops.transpose(0, 3, 1, 2).astype(np.float32) / 255)
    out = torch.nn.functional.conv2d(
        inputs, torch.from_numpy(kernels), torch.from_numpy(biases), padding=1
    )
    expected = torch.nn.functional.leaky_relu(out, 0.1).reshape(100, -1).numpy()
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(descriptors, expected, atol=1e-5)


def onnx_file(
    path: Path, kernels: NDArray[np.float32], biases: NDArray[np.float32], *, batched: bool
) -> Path:
    """A network of one convolution of stride 2, a ReLU and the mean of each channel.

    Not `batched`: the output has one row, whatever comes in.
    """
    onnx = pytest.importorskip("onnx")
    make, real = onnx.helper, onnx.TensorProto.FLOAT
    n, batch, first = len(kernels), "batch" if batched else 1, 0 if batched else 1
    graph = make.make_graph(
        [
            make.make_node(
                "Conv", ["x", "k", "b"], ["c"], kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4
            ),
            make.make_node("Relu", ["c"], ["r"]),
            make.make_node("GlobalAveragePool", ["r"], ["m"]),
            make.make_node("Reshape", ["m", "s"], ["y"]),
        ],
        "crop",
        [make.make_tensor_value_info("x", real, [batch, 3, 8, 16])],
        [make.make_tensor_value_info("y", real, [batch, n])],
        [
            onnx.numpy_helper.from_array(array, name)
            for name, array in (("k", kernels), ("b", biases), ("s", np.array([first, -1])))
        ],
    )
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path


@pytest.mark.parametrize(("batched", "n_runs"), [(True, 2), (False, 100)])
def test_an_onnx_network_gives_what_numpy_computes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batched: bool, n_runs: int
) -> None:
    """A hundred boxes, in batches of 64; a network for single images gets one after the other."""
    rng = np.random.default_rng(3)
    kernels = rng.normal(0, 1, (5, 3, 3, 3)).astype(np.float32)
    biases = rng.normal(0, 1, 5).astype(np.float32)
    describe = NetworkAppearance(
        onnx_file(tmp_path / "crop.onnx", kernels, biases, batched=batched), None, (16, 8)
    )
    frame = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    corners = rng.integers([0, 0], [64, 52], (100, 2))
    boxes = np.hstack([corners + np.array([8, 4]), np.tile([16, 8], (100, 1))]).astype(float)
    describe(frame, boxes[:2])  # by now it is known what the network takes at once
    counted = CountedRuns(describe._net)
    monkeypatch.setattr(describe, "_net", counted)
    descriptors = describe(frame, boxes)
    assert counted.n_runs == n_runs
    crops = np.stack([frame[y : y + 8, x : x + 16, ::-1] for x, y in corners]) / 255
    padded = np.pad(crops, ((0, 0), (1, 1), (1, 1), (0, 0)))
    windows = sliding_window_view(padded, (3, 3), axis=(1, 2))[:, ::2, ::2]  # (N, 4, 8, 3, 3, 3)
    out = np.einsum("nyxcij,kcij->nkyx", windows, kernels) + biases[:, None, None]
    expected = np.maximum(out, 0).mean(axis=(2, 3))
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert expected.std(axis=0).min() > 0.005  # the crops are not all alike
    np.testing.assert_allclose(descriptors, expected, atol=1e-5)


class CountedRuns:
    """A network of OpenCV's that counts how often it is run."""

    def __init__(self, net: Any) -> None:
        self.net, self.n_runs = net, 0
        self.setInput = net.setInput

    def forward(self) -> Any:
        self.n_runs += 1
        return self.net.forward()


def test_boxes_beyond_the_image_have_descriptors_and_no_boxes_have_none(tmp_path: Path) -> None:
    cfg, weights, _, _ = darknet(tmp_path, np.random.default_rng(1))
    describe = NetworkAppearance(cfg, weights, (16, 8))
    frame = np.full((40, 50, 3), 90, np.uint8)
    descriptors = describe(
        frame, np.array([[0.0, 0, 20, 20], [-90, 300, 5, 5], [25, 20, 200, 200]])
    )
    np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1)
    assert len(describe(frame, np.zeros((0, 4)))) == 0


def test_what_is_no_network_is_named(tmp_path: Path) -> None:
    cfg, _, _, _ = darknet(tmp_path, np.random.default_rng(2))
    with pytest.raises(DroptrackError, match=r"none\.onnx: no such network"):
        NetworkAppearance(tmp_path / "none.onnx", None, (64, 64))
    with pytest.raises(DroptrackError, match="--appearance-weights"):
        NetworkAppearance(cfg, None, (64, 64))
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    with pytest.raises(DroptrackError, match=r"broken\.onnx: OpenCV cannot read it"):
        NetworkAppearance(broken, None, (64, 64))
