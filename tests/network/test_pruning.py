"""Channels that follow from others are pruned, and what reads them computes the same."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from bench.random_network import random_weights
from droptrack.data.frames import Frame
from droptrack.detection.engines.opencv_dnn import OpenCvEngine
from droptrack.network.bundled import BUNDLED
from droptrack.network.darknet_cfg import Cfg, parse_cfg, read_cfg
from droptrack.network.darknet_weights import Weights, layer_values
from droptrack.network.pruning import (
    STEP,
    Moments,
    Pruning,
    choose_pruning,
    fit,
    prunable_layers,
    pruned,
    readers,
)
from droptrack.training.calibration import measure_moments

needs_openvino = pytest.mark.skipif(find_spec("openvino") is None, reason="needs openvino")

N = 2 * STEP
CONVOLUTION = f"[convolutional]\nbatch_normalize=1\nfilters={N}\nsize=3\npad=1\nactivation=leaky\n"
THIN = CONVOLUTION.replace("size=3\npad=1", "size=1")
MAXPOOL = "[maxpool]\nsize=2\nstride=2\n"
HEAD = """[convolutional]
filters=18
size=1
activation=linear
[yolo]
mask=0,1,2
anchors=6,6, 10,10, 16,16
classes=1
num=3
"""
# layers 0 to 13: 4 is read by a head and by 8, 11 reads 8, upsampled, beside 2
TWO_HEADS = f"""[net]
width=96
height=64
channels=3
{CONVOLUTION}{MAXPOOL}{CONVOLUTION}{MAXPOOL}{CONVOLUTION}{HEAD}
[route]
layers=4
{THIN}
[upsample]
stride=2
[route]
layers=-1,2
{CONVOLUTION}{HEAD}"""


def chosen(cfg: Cfg, weights: Weights, frames: list[Frame], error: float) -> Pruning:
    """The pruning that is chosen by what the network computes of frames."""
    from droptrack.network.onnx_layers import folded_convolutions

    kernels = {i: kernel for i, (kernel, _) in folded_convolutions(cfg, weights).items()}
    moments = measure_moments(cfg, weights, kernels, frames)
    return choose_pruning(cfg, kernels, moments, error)


def some_frames(n: int) -> list[Frame]:
    rng = np.random.default_rng(2)
    return [rng.integers(0, 256, (64, 96, 3)).astype(np.uint8) for _ in range(n)]


def test_what_only_convolutions_read_can_be_pruned() -> None:
    """By hand: in tiny all but the heads; in YOLOv3 what no [shortcut] adds."""
    tiny = read_cfg(BUNDLED / "yolov3-tiny-droplets.cfg")
    assert prunable_layers(tiny) == [0, 2, 4, 6, 8, 10, 12, 13, 14, 18, 21]
    assert readers(tiny)[21] == [18, 8]
    full = read_cfg(BUNDLED / "yolov3.cfg")
    in_blocks = [2, 6, 9, *range(13, 37, 3), *range(38, 62, 3), *range(63, 75, 3)]
    heads = [*range(75, 81), 84, *range(87, 93), 96, *range(99, 105)]
    assert prunable_layers(full) == [0, *in_blocks, *heads]
    assert readers(full)[87] == [84, 61]


def test_layers_of_which_parts_are_read_are_left_alone() -> None:
    """As in YOLOv4-tiny, half of layer 1 is read by 3, and [shortcut] adds 3 to 4."""
    halves = "[route]\nlayers=-1\ngroups=2\ngroup_id=1\n"
    network = f"[net]\nwidth=64\nheight=64\nchannels=3\n{CONVOLUTION * 2}{halves}"
    network += f"{CONVOLUTION * 2}[shortcut]\nfrom=-2\nactivation=linear\n{CONVOLUTION}{HEAD}"
    assert prunable_layers(parse_cfg(network, Path("halves.cfg"))) == [0, 6]


@pytest.mark.parametrize("centred", [False, True])
def test_the_fit_is_the_least_squares_solution(centred: bool) -> None:
    """Against numpy.linalg.lstsq on the samples themselves, with a constant where centred."""
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(4000, 24)) @ rng.normal(size=(24, 24)) + rng.normal(size=24)
    moments = Moments(centred=centred)
    for part in np.split(samples.astype(np.float32), 4):
        moments.add(part.reshape(1, 20, 50, 24).transpose(0, 3, 1, 2))
    kept = np.arange(24) < 18
    found = fit(moments, kept)
    known = np.column_stack([samples[:, kept], np.ones(4000)] if centred else [samples[:, kept]])
    best, *_ = np.linalg.lstsq(known, samples[:, ~kept])
    np.testing.assert_allclose(found.mix, best[:18], rtol=5e-3, atol=5e-3)
    np.testing.assert_allclose(found.offset, best[18] if centred else 0, rtol=2e-2, atol=1e-2)


@needs_openvino
def test_channels_that_nobody_reads_go_first() -> None:
    cfg = parse_cfg(TWO_HEADS, Path("two.cfg"))
    rng = np.random.default_rng(1)
    weights = random_weights(cfg, rng)
    read = np.sort(rng.permutation(N)[:STEP])
    kernels = {convolution.layer: kernel for convolution, _, kernel in layer_values(cfg, weights)}
    kernels[2].reshape(N, N, 9)[:, ~np.isin(np.arange(N), read)] = 0  # what layer 2 reads of 0
    found = chosen(cfg, weights, some_frames(2), 1e-9)
    assert found.kept[0].tolist() == read.tolist()


@needs_openvino
def test_twins_are_pruned_and_the_maps_stay() -> None:
    """Half of the channels of all layers are copies: OpenCV finds the same maps without them."""
    cfg = parse_cfg(TWO_HEADS, Path("two.cfg"))
    weights = random_weights(cfg, np.random.default_rng(2))
    for convolution, vectors, kernel in layer_values(cfg, weights):
        if convolution.outputs == N:
            vectors[:, STEP:], kernel[STEP:] = vectors[:, :STEP], kernel[:STEP]
    frames = some_frames(4)
    pruning = chosen(cfg, weights, frames[:3], 1e-7)
    assert {layer: len(rows) for layer, rows in pruning.kept.items()} == dict.fromkeys(
        (0, 2, 4, 8, 11), STEP
    )
    assert sorted(pruning.reconstructions) == [2, 4, 5, 8, 11, 12]
    maps = []
    for network, own in ((cfg, weights), pruned(cfg, weights, pruning)):
        engine = OpenCvEngine(network, own, "opencv", "fp32", 0.0)
        maps.append(engine.rows(engine.run(engine.prepare(frames[3:])))[0])
    assert len(maps[0]) > 0
    np.testing.assert_allclose(maps[1], maps[0], rtol=1e-3, atol=1e-4)


@needs_openvino
def test_nothing_is_pruned_from_a_random_network() -> None:
    cfg = parse_cfg(TWO_HEADS, Path("two.cfg"))
    weights = random_weights(cfg, np.random.default_rng(3))
    assert chosen(cfg, weights, some_frames(3), 1e-9).kept == {}
