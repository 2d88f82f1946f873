"""The PyTorch network: the maps of OpenCV's, and the bytes of a weights file."""

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra [train]")

from bench.random_network import random_weights
from droptrack.detection.decoding import decode_head
from droptrack.evaluation.network_scores import darknet_detector
from droptrack.network.darknet_cfg import cfg_text, read_cfg, with_options
from droptrack.network.darknet_weights import write_weights
from droptrack.network.torch_network import DarknetNetwork, dump_values, load_values

CFG_FOLDER = Path(__file__).parents[2] / "darknet_cfg"


@pytest.mark.parametrize(
    ("name", "size"),
    [("yolov3-tiny", (416, 416)), ("yolov3-tiny-droplets", (416, 224)), ("yolov3", (160, 96))],
)
def test_outputs_are_those_of_opencv(name: str, size: tuple[int, int], tmp_path: Path) -> None:
    """Every layer kind of the paper's networks, with the same weights and image in both."""
    options = {"width": str(size[0]), "height": str(size[1])}
    cfg = with_options(read_cfg(CFG_FOLDER / f"{name}.cfg"), options, {"thresh": "0.000001"})
    rng = np.random.default_rng(1)
    weights = random_weights(cfg, rng)
    path = tmp_path / "random.weights"
    write_weights(path, weights)
    theirs = cv2.dnn.readNetFromDarknet(
        np.frombuffer(cfg_text(cfg).encode(), np.uint8), np.frombuffer(path.read_bytes(), np.uint8)
    )
    image = rng.random((1, 3, size[1], size[0]), np.float32)
    theirs.setInput(image)
    outputs = theirs.forward(theirs.getUnconnectedOutLayersNames())

    network = DarknetNetwork(cfg)
    load_values(network, weights.values)
    network.eval()
    with torch.no_grad():
        maps = network(torch.from_numpy(image))
    for raw, head, expected in zip(maps, network.heads, outputs, strict=True):
        rows = decode_head(raw[0].numpy(), head, 1e-6)
        likely = np.asarray(expected)[np.asarray(expected)[:, 4] > 1e-6]
        # OpenCV counts cell by cell, then anchor by anchor
        order = np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))
        other = np.lexsort((likely[:, 2], likely[:, 1], likely[:, 0]))
        assert len(rows) == len(likely) >= 45
        np.testing.assert_allclose(rows[order, :5], likely[other, :5], rtol=2e-3, atol=1e-4)


def test_a_score_is_objectness_times_class_probability(tmp_path: Path) -> None:
    """Through OpenCV, against the network's own maps."""
    cfg = read_cfg(Path(__file__).parents[1] / "reference" / "mini.cfg")
    rng = np.random.default_rng(8)
    weights, path = random_weights(cfg, rng), tmp_path / "random.weights"
    write_weights(path, weights)
    image = rng.integers(0, 256, (cfg.height, cfg.width, 3), np.uint8)
    (found,) = darknet_detector(cfg, path).detect([image])

    network = DarknetNetwork(cfg)
    load_values(network, weights.values)
    network.eval()
    inputs = torch.from_numpy(image[..., ::-1].copy()).permute(2, 0, 1)[None] / 255
    with torch.no_grad():
        (raw,) = network(inputs)
    probabilities = raw[0].sigmoid()
    scores = (probabilities[:, 4] * probabilities[:, 5]).numpy().ravel()
    assert len(found) > 20
    nearest = np.abs(found.scores[:, None] - scores[None]).min(axis=1)
    assert nearest.max() < 1e-4
    assert found.scores.max() == pytest.approx(scores.max(), abs=1e-4)


def test_weights_loaded_and_dumped_are_the_same_bytes(tmp_path: Path) -> None:
    cfg = read_cfg(CFG_FOLDER / "yolov3-tiny.cfg")
    values = random_weights(cfg, np.random.default_rng(2)).values
    network = DarknetNetwork(cfg)
    load_values(network, values)
    assert dump_values(network).tobytes() == values.tobytes()
    with pytest.raises(ValueError, match="values, not"):
        load_values(network, np.append(values, np.float32(1)))
