"""Every engine finds what OpenCV finds with the same weights; the one wanted is chosen."""

import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_gen.scenes.scene_kinds import SCENES
from droptrack.data.detections import Detections, iou_matrix, labels
from droptrack.data.frames import Frame, grey_frame
from droptrack.data.stage_times import StageTimes
from droptrack.detection import engine_choice
from droptrack.detection.decoding import select
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.detection.engines.opencv_dnn import has_cuda
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import average_precision
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import parse_cfg, read_cfg, resized
from droptrack.network.darknet_weights import Weights, read_weights

CFG = read_cfg(find_cfg(BUNDLED_WEIGHTS))


def installed(*packages: str) -> bool:
    return all(importlib.util.find_spec(package) for package in packages)


def has_torch_cuda() -> bool:
    if not installed("torch"):
        return False
    import torch

    return torch.cuda.is_available()


needs_openvino = pytest.mark.skipif(
    not installed("openvino", "onnx"), reason="needs the extra [openvino]"
)
needs_torch = pytest.mark.skipif(not installed("torch"), reason="needs the extra [train]")
needs_gpu = pytest.mark.skipif(not has_torch_cuda(), reason="needs a GPU with CUDA")
needs_opencv_cuda = pytest.mark.skipif(not has_cuda(), reason="needs OpenCV built with CUDA")

EXACT = [
    pytest.param("openvino", "fp32", marks=needs_openvino),
    pytest.param("torch", "fp32", marks=needs_torch),
    pytest.param("torch-cuda", "fp32", marks=needs_gpu),
    pytest.param("opencv-cuda", "fp32", marks=needs_opencv_cuda),
]
ROUNDED = [
    pytest.param("openvino", "bf16", marks=needs_openvino),
    pytest.param("openvino", "int8", marks=needs_openvino),
    ("opencv", "auto"),  # pruned
    pytest.param("torch", "bf16", marks=needs_torch),
    pytest.param("torch-cuda", "fp16", marks=needs_gpu),
    pytest.param("torch-cuda", "bf16", marks=needs_gpu),
]


def detector(backend: str, precision: str = "fp32", threshold: float = 0.25) -> Detector:
    network = Network(CFG, BUNDLED_WEIGHTS, threshold=threshold, max_iou=0.45)
    return choose_detector(network, Backend(backend), Precision(precision))


def assert_same(found: Detections, expected: Detections) -> None:
    """As many boxes, each within 0.5 px of another, scores within 0.005."""
    assert len(found) == len(expected)
    nearest = iou_matrix(expected.boxes, found.boxes).argmax(axis=1)
    assert np.unique(nearest).size == len(expected)
    assert np.abs(found.boxes[nearest] - expected.boxes).max() < 0.5
    assert np.abs(found.scores[nearest] - expected.scores).max() < 0.005


def coloured(frame: Frame) -> Frame:
    """Its channels differ, so that it takes another way than grey frames do."""
    tinted: Frame = np.ascontiguousarray(frame)
    tinted[..., 0] = tinted[..., 0] // 2 + 10
    return tinted


@pytest.mark.parametrize(("backend", "precision"), EXACT)
@pytest.mark.parametrize("scene", "acd")
@pytest.mark.parametrize("look", [grey_frame, lambda grey: coloured(grey_frame(grey))])
def test_an_engine_finds_what_opencv_finds(
    backend: str, precision: str, scene: str, look: Callable[[np.ndarray], Frame]
) -> None:
    frame = look(SCENES[scene](np.random.default_rng([3, 1])).image)
    (expected,) = detector("opencv").detect([frame])
    assert len(expected) > 5
    (found,) = detector(backend, precision).detect([frame])
    assert_same(found, expected)


@pytest.mark.parametrize(("backend", "precision"), [("opencv", "fp32"), *EXACT])
def test_grey_frames_are_their_three_planes(backend: str, precision: str) -> None:
    """A grey frame is one plane in memory, and prepared as such."""
    own = detector(backend, precision)
    frames = [grey_frame(SCENES["c"](np.random.default_rng([3, seed])).image) for seed in range(2)]
    for grey, copied in zip(
        own.detect(frames), own.detect([frame.copy() for frame in frames]), strict=True
    ):
        assert len(grey) > 5
        assert_same(grey, copied)


@pytest.mark.parametrize(("backend", "precision"), EXACT)
def test_images_started_before_others_are_done_are_not_mixed_up(
    backend: str, precision: str
) -> None:
    own = detector(backend, precision)
    frames = [grey_frame(SCENES["c"](np.random.default_rng([3, seed])).image) for seed in range(5)]
    expected = [own.detect([frame])[0].boxes for frame in frames]
    assert len({len(boxes) for boxes in expected}) > 1
    # on a GPU, two images are computed in another order than one
    atol = 0.01 if backend == "torch-cuda" else 0.0
    for parts in ([1, 1, 1, 1, 1], [2, 3]):
        ends = np.cumsum(parts)
        running = [
            own.start(frames[end - n : end], StageTimes())
            for n, end in zip(parts, ends, strict=True)
        ]
        found = [detections.boxes for finish in running for detections in finish()]
        for boxes, alone in zip(found, expected, strict=True):
            np.testing.assert_allclose(boxes, alone, rtol=0, atol=atol)


def test_onnx_runtime_finds_what_opencv_finds() -> None:
    """The exported network in an engine that is not ours."""
    pytest.importorskip("onnx", reason="needs the extra [openvino]")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra [dev]")
    from droptrack.network.onnx_export import onnx_model

    opencv = detector("opencv")
    frame = grey_frame(SCENES["c"](np.random.default_rng([3, 2])).image)
    model = onnx_model(CFG, read_weights(BUNDLED_WEIGHTS, CFG), decode=True)
    session = runtime.InferenceSession(model.SerializeToString())
    (rows,) = session.run(None, {"images": opencv.engine.prepare([frame])})
    assert_same(select(rows[0], 1200, 600, 0.25, 0.45), opencv.detect([frame])[0])


@needs_torch
@pytest.mark.parametrize("precision", ["fp32", "bf16", "fp16"])
def test_all_of_the_network_goes_to_the_device(precision: str) -> None:
    """The device without memory takes no number of another, as a GPU takes none of the CPU's."""
    import torch

    from droptrack.detection.engines.pytorch import DTYPES, FramesToRows

    network = FramesToRows(CFG, read_weights(BUNDLED_WEIGHTS, CFG), DTYPES[precision]).to("meta")
    cells = sum((CFG.width // stride) * (CFG.height // stride) for stride in (16, 32))
    for channels in (1, 3):
        frames = torch.empty((2, 600, 1200, channels), dtype=torch.uint8, device="meta")
        rows = network(frames)
        assert rows.shape == (2, 3 * cells, 6)
        assert rows.is_meta


@pytest.mark.parametrize(("backend", "precision"), ROUNDED)
def test_a_rounded_engine_loses_at_most_two_thousandths_of_precision(
    backend: str, precision: str
) -> None:
    exact = "openvino" if installed("openvino", "onnx") else "opencv"
    assert precision_of(backend, precision) >= precision_of(exact, "fp32") - 0.002


@cache
def precision_of(backend: str, precision: str) -> float:
    """MAP@0.50 on images of scenes c and d."""
    engine = detector(backend, precision, 0.005)
    scenes = [SCENES["cd"[n % 2]](np.random.default_rng([4, n])) for n in range(16)]
    return average_precision(
        (engine.detect([grey_frame(scene.image)])[0], labels(scene.boxes)) for scene in scenes
    ).average_precision


@needs_torch
def test_resizing_on_the_device_is_that_of_opencv() -> None:
    """What a GPU does with whole frames, on the CPU."""
    import torch

    from droptrack.detection.engines.pytorch import FramesToRows, TorchEngine

    cfg = resized(CFG, 416, 224)
    weights = read_weights(BUNDLED_WEIGHTS, cfg)
    frame = coloured(grey_frame(SCENES["a"](np.random.default_rng([3, 3])).image))
    engine = TorchEngine(cfg, weights, "fp32", 0.25)
    expected = Detector(engine, 0.25, 0.45).detect([frame])[0]
    network = FramesToRows(cfg, weights, torch.float32)
    with torch.inference_mode():
        rows = network(torch.from_numpy(frame[None]))
    (chosen,) = engine.rows(rows)
    found = select(chosen, 1200, 600, 0.25, 0.45)
    assert len(expected) > 3
    assert_same(found, expected)


def test_an_engine_that_fails_is_passed_over_by_auto_and_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    monkeypatch.delitem(sys.modules, "droptrack.detection.engines.openvino", raising=False)
    monkeypatch.setattr(
        "droptrack.detection.engine_choice._installed", lambda package: package != "torch"
    )
    network = Network(resized(CFG, 96, 64), BUNDLED_WEIGHTS, threshold=0.25, max_iou=0.45)
    said: list[str] = []
    chosen = choose_detector(network, say=said.append)
    assert chosen.engine.name == "opencv fp32"
    assert said == [
        "not used: --backend openvino: is not installed; pip install 'droptrack[openvino]'"
    ]
    with pytest.raises(DroptrackError, match=r"droptrack\[openvino\]"):
        choose_detector(network, Backend.openvino)


def test_auto_has_the_network_pruned_and_a_named_precision_has_all_of_it() -> None:
    assert detector("opencv", "auto").engine.name == "opencv fp32, pruned"
    assert detector("opencv", "fp32").engine.name == "opencv fp32"


@needs_openvino
@pytest.mark.skipif(has_cuda() or has_torch_cuda(), reason="there is a GPU, which is faster")
@pytest.mark.parametrize(
    ("faster", "calibrated", "other"),
    [({"int8", "bf16"}, "int8", "bf16"), ({"bf16"}, "bf16", "bf16"), (set(), "fp32", "fp32")],
)
def test_auto_takes_int8_where_it_is_calibrated_else_bf16(
    monkeypatch: pytest.MonkeyPatch, faster: set[str], calibrated: str, other: str
) -> None:
    monkeypatch.setattr(
        "droptrack.detection.engines.openvino.computes_faster_in", faster.__contains__
    )
    network = Network(CFG, BUNDLED_WEIGHTS, threshold=0.25, max_iou=0.45)
    assert choose_detector(network).engine.name == f"openvino {calibrated}, pruned"
    network = Network(resized(CFG, 96, 64), BUNDLED_WEIGHTS, threshold=0.25, max_iou=0.45)
    assert choose_detector(network).engine.name == f"openvino {other}"
    with pytest.raises(DroptrackError, match=r"calibrate --weights .* --size 96x64"):
        choose_detector(network, Backend.openvino, Precision.int8)


@pytest.mark.parametrize(
    ("backend", "precision", "message"),
    [
        ("opencv", "int8", "opencv computes in fp32"),
        ("auto", "fp16", "no engine here has it"),
        pytest.param(
            "torch-cuda",
            "auto",
            "finds no GPU",
            marks=[needs_torch, pytest.mark.skipif(has_torch_cuda(), reason="there is a GPU")],
        ),
    ],
)
def test_what_cannot_be_had_is_said(backend: str, precision: str, message: str) -> None:
    if precision == "fp16" and (has_cuda() or has_torch_cuda()):
        pytest.skip("there is a GPU")
    with pytest.raises(DroptrackError, match=message):
        detector(backend, precision)


SUMS = """
[net]
width=32
height=32
channels=3
[convolutional]
filters=8
size=3
stride=1
pad=1
activation=linear
[convolutional]
filters=6
size=1
stride=1
pad=1
activation=linear
[yolo]
mask=0
anchors=10,10
classes=1
num=1
"""


@needs_openvino
def test_sums_of_the_largest_bytes_do_not_overflow_in_int8() -> None:
    """A white image and kernels of ones: 27 in each channel, then 8 times that."""
    from droptrack.detection.engines.openvino import OpenVinoEngine

    cfg = parse_cfg(SUMS, Path("sums.cfg"))
    first, second = np.ones((8, 3, 3, 3)), np.ones((6, 8))
    values = np.concatenate([np.zeros(8), first.ravel(), np.zeros(6), second.ravel()])
    weights = Weights((0, 2, 5), 0, values.astype(np.float32))
    engine = OpenVinoEngine(cfg, weights, "int8", 0.5, {0: (0.0, 27.0)})
    white = np.full((32, 32, 3), 255, np.uint8)
    for frame in (white, grey_frame(white[..., 0])):
        (raw,) = engine.start(engine.prepare([frame])).result().outputs
        np.testing.assert_allclose(raw[0, :, 16, 16], 8 * 27, rtol=0.01)


def test_an_opencv_without_darknet_is_named_and_gone_around(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As OpenCV 5 is, which other packages put over version 4."""
    monkeypatch.delattr(cv2.dnn, "readNetFromDarknet")
    network = Network(
        read_cfg(find_cfg(BUNDLED_WEIGHTS)), BUNDLED_WEIGHTS, threshold=0.4, max_iou=0.3
    )
    with pytest.raises(
        DroptrackError, match=r"cannot read Darknet's .* 'opencv-python-headless<5'"
    ):
        choose_detector(network, Backend.opencv)
    installed = {"torch"}
    monkeypatch.setattr(engine_choice, "_installed", lambda package: package in installed)
    if importlib.util.find_spec("torch") is not None:
        said: list[str] = []
        detector = choose_detector(network, say=said.append)
        assert detector.engine.name.startswith("torch")
        if not has_torch_cuda():  # which comes before OpenCV
            assert any("cannot read Darknet's networks" in line for line in said)
    installed.clear()
    with pytest.raises(DroptrackError, match="cannot read Darknet's networks"):
        choose_detector(network)
