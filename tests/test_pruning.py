"""Channels that others can stand in for are left out, and what reads them computes the same."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from bench.random_network import random_weights
from droptrack.darknet_files import Weights, parse_cfg, read_cfg
from droptrack.engines.opencv_dnn import OpenCvEngine
from droptrack.network_choice import SHIPPED
from droptrack.pruning import STEP, Moments, fit, prunable_layers, pruned, reductions

needs_openvino = pytest.mark.skipif(find_spec("openvino") is None, reason="needs openvino")

N = 2 * STEP
TWO_TO_PRUNE = f"""
[net]
width=96
height=64
channels=3
[convolutional]
batch_normalize=1
filters={N}
size=3
pad=1
activation=leaky
[convolutional]
batch_normalize=1
filters=16
size=1
activation=leaky
[convolutional]
filters={N}
size=3
pad=1
activation=leaky
[convolutional]
filters=18
size=1
activation=linear
[yolo]
mask=0,1,2
anchors=6,6, 10,10, 16,16
classes=1
num=3
"""


def test_what_can_be_pruned_is_read_by_a_1_x_1_convolution_only() -> None:
    """By hand: tiny's layer 13 is routed, 18 is upsampled; in YOLOv3 blocks end in shortcuts."""
    assert prunable_layers(read_cfg(SHIPPED / "yolov3-tiny-droplets.cfg")) == [12, 14, 21]
    full = prunable_layers(read_cfg(SHIPPED / "yolov3.cfg"))
    assert full == [76, 78, 80, 88, 90, 92, 100, 102, 104]


def test_the_fit_is_the_least_squares_solution() -> None:
    """Against numpy.linalg.lstsq on the samples themselves."""
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(4000, 96)) @ rng.normal(size=(96, 96)) * np.geomspace(1, 0.01, 96)
    kernel = rng.normal(size=(5, 96))
    centred = samples - samples.mean(axis=0)
    wanted = centred @ kernel.T
    kept, fitted = fit(np.cov(samples.T, bias=True), kernel, 0.01)
    assert len(kept) % STEP == 0
    assert len(kept) < 96
    best, *_ = np.linalg.lstsq(centred[:, kept], wanted)
    np.testing.assert_allclose(fitted, best.T, rtol=2e-3, atol=2e-3)
    error = ((centred[:, kept] @ fitted.T - wanted) ** 2).sum() / (wanted**2).sum()
    assert error < 0.01


def test_channels_that_nobody_reads_go_first() -> None:
    rng = np.random.default_rng(1)
    kernel = np.zeros((4, 80))
    read = np.sort(rng.permutation(80)[:STEP])
    kernel[:, read] = rng.normal(size=(4, STEP))
    kept, fitted = fit(np.eye(80), kernel, 1e-9)
    assert kept.tolist() == read.tolist()
    np.testing.assert_allclose(fitted, kernel[:, read], rtol=1e-5)


@needs_openvino
def test_twins_are_left_out_and_the_maps_stay() -> None:
    """Half of the channels of both layers are copies: OpenCV finds the same maps without them."""
    from droptrack.engines.openvino import layer_outputs

    cfg = parse_cfg(TWO_TO_PRUNE, Path("two.cfg"))
    rng = np.random.default_rng(2)
    values = random_weights(cfg, rng).values
    sizes = [4 * N + N * 27, 4 * 16 + 16 * N, N + N * 16 * 9, 18 + 18 * N]
    first, second, third, fourth = np.split(values, np.cumsum(sizes)[:-1])
    first[: 4 * N].reshape(4, 2, STEP)[:, 1] = first[: 4 * N].reshape(4, 2, STEP)[:, 0]
    first[4 * N :].reshape(2, STEP, 27)[1] = first[4 * N :].reshape(2, STEP, 27)[0]
    third[:N].reshape(2, STEP)[1] = third[:N].reshape(2, STEP)[0]
    third[N:].reshape(2, STEP, -1)[1] = third[N:].reshape(2, STEP, -1)[0]
    weights = Weights((0, 2, 5), 0, np.concatenate([first, second, third, fourth]))
    frames = [rng.integers(0, 256, (64, 96, 3)).astype(np.uint8) for _ in range(4)]
    assert prunable_layers(cfg) == [0, 2]
    moments = {0: Moments(), 2: Moments()}
    for outputs in layer_outputs(cfg, weights, [0, 2], frames[:3]):
        for layer, moment in moments.items():
            moment.add(outputs[layer])
    changes = reductions(cfg, weights, moments, 1e-6)
    assert [(change.layer, len(change.kept)) for change in changes] == [(0, STEP), (2, STEP)]
    maps = []
    for network, own in ((cfg, weights), pruned(cfg, weights, changes)):
        engine = OpenCvEngine(network, own, "opencv", "fp32", 0.0)
        maps.append(engine.rows(engine.run(engine.prepare(frames[3:])))[0])
    assert len(maps[0]) > 0
    np.testing.assert_allclose(maps[1], maps[0], atol=1e-3)


@needs_openvino
def test_nothing_is_left_out_of_a_network_by_chance() -> None:
    from droptrack.engines.openvino import layer_outputs

    cfg = parse_cfg(TWO_TO_PRUNE, Path("two.cfg"))
    rng = np.random.default_rng(3)
    weights = random_weights(cfg, rng)
    frames = [rng.integers(0, 256, (64, 96, 3)).astype(np.uint8) for _ in range(3)]
    moments = {2: Moments()}
    for outputs in layer_outputs(cfg, weights, [2], frames):
        moments[2].add(outputs[2])
    assert reductions(cfg, weights, moments, 1e-6) == []
