"""Every engine finds what OpenCV finds with the same weights; int8 is calibrated and checked."""

import importlib.util
import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.random_network import random_weights
from data_gen.make_dataset import Recipe, make_dataset
from data_gen.scenes import SCENES
from droptrack import DroptrackError, quantisation
from droptrack.__main__ import app
from droptrack.darknet_files import parse_cfg, read_cfg, read_weights, resized
from droptrack.detections import Detections, iou_matrix, labels
from droptrack.detector import Detector, select
from droptrack.engine_choice import Backend, Network, Precision, choose_detector
from droptrack.engines.opencv_dnn import has_cuda
from droptrack.metrics import average_precision
from droptrack.network_choice import SHIPPED_WEIGHTS, find_cfg
from droptrack.pruning import NOTHING
from droptrack.quantisation import (
    Calibration,
    find_calibration,
    joined,
    quantised_layers,
    sha256_of,
    write_calibration,
)
from droptrack.stage_times import StageTimes
from droptrack.video import Frame, grey_frame

CFG = read_cfg(find_cfg(SHIPPED_WEIGHTS))


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
    network = Network(CFG, SHIPPED_WEIGHTS, threshold, 0.45)
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
def test_pictures_started_before_others_are_done_are_not_mixed_up(
    backend: str, precision: str
) -> None:
    own = detector(backend, precision)
    frames = [grey_frame(SCENES["c"](np.random.default_rng([3, seed])).image) for seed in range(5)]
    expected = [own.detect([frame])[0].boxes.tolist() for frame in frames]
    assert len({len(boxes) for boxes in expected}) > 1
    for parts in ([1, 1, 1, 1, 1], [2, 3]):
        ends = np.cumsum(parts)
        running = [
            own.start(frames[end - n : end], StageTimes())
            for n, end in zip(parts, ends, strict=True)
        ]
        found = [detections.boxes.tolist() for finish in running for detections in finish()]
        assert found == expected


def test_onnx_runtime_finds_what_opencv_finds() -> None:
    """The exported network in an engine that is not ours."""
    pytest.importorskip("onnx", reason="needs the extra [openvino]")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra [dev]")
    from droptrack.onnx_export import onnx_model

    opencv = detector("opencv")
    frame = grey_frame(SCENES["c"](np.random.default_rng([3, 2])).image)
    model = onnx_model(CFG, read_weights(SHIPPED_WEIGHTS, CFG), decode=True)
    session = runtime.InferenceSession(model.SerializeToString())
    (rows,) = session.run(None, {"images": opencv.engine.prepare([frame])})
    assert_same(select(rows[0], 1200, 600, 0.25, 0.45), opencv.detect([frame])[0])


@needs_torch
@pytest.mark.parametrize("precision", ["fp32", "bf16", "fp16"])
def test_all_of_the_network_goes_to_the_device(precision: str) -> None:
    """The device without memory takes no number of another, as a GPU takes none of the CPU's."""
    import torch

    from droptrack.engines.pytorch import DTYPES, FramesToRows

    network = FramesToRows(CFG, read_weights(SHIPPED_WEIGHTS, CFG), DTYPES[precision]).to("meta")
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
    """MAP@0.50 on pictures of scenes c and d."""
    engine = detector(backend, precision, 0.005)
    scenes = [SCENES["cd"[n % 2]](np.random.default_rng([4, n])) for n in range(16)]
    return average_precision(
        (engine.detect([grey_frame(scene.image)])[0], labels(scene.boxes)) for scene in scenes
    ).average_precision


@needs_torch
def test_resizing_on_the_device_is_that_of_opencv() -> None:
    """What a GPU does with whole frames, on the CPU."""
    import torch

    from droptrack.engines.pytorch import FramesToRows, TorchEngine

    cfg = resized(CFG, 416, 224)
    weights = read_weights(SHIPPED_WEIGHTS, cfg)
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
    monkeypatch.delitem(sys.modules, "droptrack.engines.openvino", raising=False)
    monkeypatch.setattr("droptrack.engine_choice._installed", lambda package: package != "torch")
    network = Network(resized(CFG, 96, 64), SHIPPED_WEIGHTS, 0.25, 0.45)
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
@pytest.mark.parametrize(
    ("faster", "calibrated", "other"),
    [({"int8", "bf16"}, "int8", "bf16"), ({"bf16"}, "bf16", "bf16"), (set(), "fp32", "fp32")],
)
def test_auto_takes_int8_where_it_is_calibrated_else_bf16(
    monkeypatch: pytest.MonkeyPatch, faster: set[str], calibrated: str, other: str
) -> None:
    monkeypatch.setattr("droptrack.engines.openvino.computes_faster_in", faster.__contains__)
    network = Network(CFG, SHIPPED_WEIGHTS, 0.25, 0.45)
    assert choose_detector(network).engine.name == f"openvino {calibrated}, pruned"
    network = Network(resized(CFG, 96, 64), SHIPPED_WEIGHTS, 0.25, 0.45)
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


BRANCHES = """
[net]
width=64
height=64
channels=3
[convolutional]
filters=4
size=3
stride=2
pad=1
activation=leaky
[maxpool]
size=2
stride=2
[convolutional]
filters=4
size=3
pad=1
activation=leaky
[upsample]
stride=2
[route]
layers=-1,0
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


def test_layers_that_a_route_joins_share_one_range() -> None:
    cfg = parse_cfg(BRANCHES, Path("branches.cfg"))
    assert quantised_layers(cfg) == [0, 2]
    assert joined(cfg, {0: (-1.0, 2.0), 2: (-0.5, 7.0)}) == {0: (-1.0, 7.0), 2: (-1.0, 7.0)}


@needs_openvino
def test_ranges_are_those_of_the_layers_outputs_and_eight_bits_stay_close() -> None:
    """Against ONNX Runtime: the extremes of a layer, and the quantised network's maps."""
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra [dev]")
    from droptrack.engines.openvino import OpenVinoEngine, output_ranges
    from droptrack.onnx_export import onnx_model

    cfg = parse_cfg(BRANCHES, Path("branches.cfg"))
    rng = np.random.default_rng(5)
    weights = random_weights(cfg, rng)
    frame = rng.integers(0, 256, (64, 64, 3)).astype(np.uint8)
    ranges = output_ranges(cfg, weights, [0, 2], [frame])
    model = onnx_model(cfg, weights, taps=[0, 2])
    session = runtime.InferenceSession(model.SerializeToString())
    image = frame[None, ..., ::-1].transpose(0, 3, 1, 2).astype(np.float32) / np.float32(255)
    exact_map, first, second = session.run(None, {"images": image})
    assert ranges[0] == pytest.approx((first.min(), first.max()), abs=1e-5)
    assert ranges[2] == pytest.approx((second.min(), second.max()), abs=1e-5)
    quantised = onnx_model(cfg, weights, ranges=joined(cfg, ranges))
    session = runtime.InferenceSession(quantised.SerializeToString())
    (theirs,) = session.run(None, {"images": image})
    engine = OpenVinoEngine(cfg, weights, "int8", 0.25, joined(cfg, ranges))
    (ours,) = engine.start(engine.prepare([frame])).result().outputs
    spread = float(np.ptp(exact_map))
    assert 0 < np.abs(ours - exact_map).max() < 0.03 * spread
    assert np.abs(ours - theirs).max() < 0.02 * spread


def calibration(weights: Path, fallen: tuple[float, float] = (0.989, 0.892)) -> Calibration:
    ranges = dict.fromkeys(quantised_layers(CFG), (-1.0, 10.0))
    return Calibration(sha256_of(weights), 960, 480, ranges, 8, 9, (0.99, 0.9), fallen, NOTHING)


def test_a_calibration_is_kept_beside_the_weights_and_holds_for_them_only(tmp_path: Path) -> None:
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    kept = calibration(weights)
    path = write_calibration(weights, CFG, kept)
    assert path == tmp_path / "mine-int8-960x480.npz"
    assert find_calibration(weights, CFG) == kept
    assert find_calibration(weights, resized(CFG, 416, 224)) is None
    weights.write_bytes(b"two")
    assert find_calibration(weights, CFG) is None
    for damage in (b"{}", path.read_bytes()[:200]):
        path.write_bytes(damage)
        with pytest.raises(DroptrackError, match=r"npz: is no calibration"):
            find_calibration(weights, CFG)


def test_a_calibration_goes_to_the_cache_where_the_weights_cannot_have_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    (tmp_path / "mine-int8-960x480.npz.partial").mkdir()  # so that it cannot be written
    kept = calibration(weights)
    path = write_calibration(weights, CFG, kept)
    assert path.parent == tmp_path / "cache" / "droptrack"
    assert find_calibration(weights, CFG) == kept


@pytest.mark.parametrize("fallen", [(0.9879, 0.9), (float("nan"), 0.9)])
def test_eight_bits_that_cost_too_much_are_refused(
    tmp_path: Path, fallen: tuple[float, float]
) -> None:
    weights = tmp_path / "mine.weights"
    weights.write_bytes(b"one")
    with pytest.raises(DroptrackError, match=r"int8 is refused: mAP falls from 0\.9900"):
        write_calibration(weights, CFG, calibration(weights, fallen))
    assert find_calibration(weights, CFG) is None


@needs_openvino
@pytest.mark.parametrize(("error", "pruned"), [("0.0002", True), ("1", False)])
def test_the_command_calibrates_on_a_data_set(tmp_path: Path, error: str, pruned: bool) -> None:
    """An error that costs too much is made smaller, down to none."""
    data = tmp_path / "data"
    for _ in make_dataset(data, Recipe("b", 12, 12, 1), workers=1):
        pass
    weights = tmp_path / "mine.weights"
    shutil.copy(SHIPPED_WEIGHTS, weights)
    arguments = ["calibrate", "--weights", str(weights), "--cfg", str(CFG.path)]
    arguments += ["--data", str(data / "obj.data"), "--size", "480x256", "--prune", error]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    cfg = resized(CFG, 480, 256)
    kept = find_calibration(weights, cfg)
    assert kept is not None
    assert (kept.n_calibrated, kept.n_checked) == (12, 12)
    assert kept.map_fp32[0] > 0.9
    assert kept.losses[0] <= quantisation.MAX_LOSS
    assert kept.pruning.kept.keys() >= ({8, 10, 12, 14, 21} if pruned else set())
    assert bool(kept.pruning.stand_ins) == pruned
    engine = choose_detector(Network(cfg, weights, 0.25, 0.45), precision=Precision.int8).engine
    assert engine.name == "openvino int8" + pruned * ", pruned"
