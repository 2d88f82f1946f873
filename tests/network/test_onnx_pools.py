"""Pools computed with the convolution before them give the same bytes."""

import numpy as np
import pytest

pytest.importorskip("openvino")
pytest.importorskip("onnx")

from bench.random_network import random_weights
from droptrack.data.frames import Frame, grey_frame
from droptrack.detection.engines.openvino import OpenVinoEngine, core, kernel_max, output_ranges
from droptrack.network.bundled import BUNDLED
from droptrack.network.darknet_cfg import parse_cfg, read_cfg, resized
from droptrack.network.onnx_export import onnx_model
from droptrack.network.onnx_pools import pooled_layers
from droptrack.network.quantisation import Quantisation, merge_ranges, quantised_layers

TINY = resized(read_cfg(BUNDLED / "yolov3-tiny.cfg"), 160, 96)


def images(colour: bool) -> list[Frame]:
    rng = np.random.default_rng(4)
    if colour:
        return list(rng.integers(0, 256, (2, 96, 160, 3)).astype(np.uint8))
    return [grey_frame(plane) for plane in rng.integers(0, 256, (2, 96, 160)).astype(np.uint8)]


def test_which_layers_are_pooled_early() -> None:
    """By hand: tiny's first two convolutions have 16 and 32 channels; YOLOv3 has no pools."""
    assert pooled_layers(TINY) == {0, 2}
    assert pooled_layers(read_cfg(BUNDLED / "yolov3.cfg")) == set()


def test_layers_that_others_read_keep_their_pool() -> None:
    head = "[convolutional]\nfilters=18\nsize=1\nactivation=linear\n[yolo]\nmask=0,1,2\n"
    head += "anchors=6,6, 10,10, 16,16\nclasses=1\nnum=3\n"
    first = "[convolutional]\nfilters=16\nsize=3\npad=1\nactivation=leaky\n"
    pool = "[maxpool]\nsize=2\nstride=2\n"
    net = "[net]\nwidth=64\nheight=64\nchannels=3\n"
    cfg = parse_cfg(f"{net}{first}{pool}{head}[route]\nlayers=0\n{first}{head}", BUNDLED / "x.cfg")
    assert pooled_layers(cfg) == set()


@pytest.mark.parametrize("colour", [False, True])
def test_the_maps_are_the_same_to_the_last_bit(colour: bool) -> None:
    weights = random_weights(TINY, np.random.default_rng(3))
    frames = images(colour)
    ranges = merge_ranges(TINY, output_ranges(TINY, weights, quantised_layers(TINY), frames))
    quantisation = Quantisation(ranges, kernel_max())
    model = onnx_model(TINY, weights, pixels=True, grey=not colour, quantisation=quantisation)
    ordinary = core().compile_model(
        core().read_model(model.SerializeToString()), "CPU", {"INFERENCE_PRECISION_HINT": "f32"}
    )
    engine = OpenVinoEngine(TINY, weights, "int8", 0.4, ranges)
    prepared = engine.prepare(frames)
    assert prepared.shape == (2, 3 if colour else 1, 96, 160)
    expected = ordinary(prepared)
    for number, own in enumerate(engine.start(prepared).result().outputs):
        assert np.ptp(own) > 1
        np.testing.assert_array_equal(own, expected[number])
