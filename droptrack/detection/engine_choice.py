"""Which engine runs a network, and how precisely: the one named, or the fastest that works."""

import ctypes
import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.frames import grey_frame
from droptrack.data.normalisation import UNCHANGED, Normalisation
from droptrack.data.region import Region
from droptrack.detection.detector import Detector, Engine, first_line
from droptrack.detection.engines import opencv_dnn
from droptrack.detection.scale import Canvas
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, cfg_text
from droptrack.network.darknet_weights import Weights, read_weights
from droptrack.network.pruning import pruned
from droptrack.network.quantisation import find_calibration, sha256_of


class Backend(StrEnum):
    """What runs the network."""

    auto = "auto"
    opencv = "opencv"
    opencv_cuda = "opencv-cuda"
    openvino = "openvino"
    torch = "torch"
    torch_cuda = "torch-cuda"


class Precision(StrEnum):
    """What the network computes in."""

    auto = "auto"
    fp32 = "fp32"
    bf16 = "bf16"
    fp16 = "fp16"
    int8 = "int8"


# what each computes in; the first is what `auto` takes, but for OpenVINO the fastest of the CPU's
PRECISIONS = {
    Backend.torch_cuda: (Precision.fp16, Precision.bf16, Precision.fp32),
    Backend.opencv_cuda: (Precision.fp32, Precision.fp16),
    Backend.openvino: (Precision.fp32, Precision.bf16, Precision.int8),
    Backend.opencv: (Precision.fp32,),
    Backend.torch: (Precision.fp32, Precision.bf16),
}
ON_CPU = (Backend.openvino, Backend.opencv, Backend.torch)
EXTRAS = {"torch": "train", "openvino": "openvino", "onnx": "openvino"}


@dataclass(frozen=True)
class Network:
    """A network as its files have it, and what `Detector` needs besides."""

    cfg: Cfg
    weights_path: Path
    _: KW_ONLY
    threshold: float
    max_iou: float
    greedy: bool = False
    normalisation: Normalisation = UNCHANGED
    canvas: Canvas | None = None
    region: Region | None = None

    def weights(self) -> Weights:
        """The weights; raises DroptrackError for a file that does not fit the cfg."""
        return read_weights(self.weights_path, self.cfg)

    def key(self) -> tuple[object, ...]:
        """What an engine depends on; raises DroptrackError where there are no weights."""
        return cfg_text(self.cfg), sha256_of(self.weights_path), self.threshold

    def detector(self, engine: Engine) -> Detector:
        """A detector with this network on an engine."""
        return Detector(
            engine,
            self.threshold,
            self.max_iou,
            greedy=self.greedy,
            normalisation=self.normalisation,
            canvas=self.canvas,
            region=self.region,
        )


class Engines:
    """Engines that were made, so that the next video need not wait for its network again.

    Holds the `n_held` that were used last. One may be used by one video at a time.
    """

    def __init__(self, n_held: int = 4) -> None:
        self._made: dict[tuple[object, ...], Engine] = {}
        self._n_held = n_held

    def get(self, key: tuple[object, ...], make: Callable[[], Engine]) -> Engine:
        """The engine of a key, made where there is none."""
        engine = self._made.pop(key, None) or make()
        self._made[key] = engine  # the last one used is the last one here
        while len(self._made) > self._n_held:
            del self._made[next(iter(self._made))]
        return engine


def choose_detector(
    network: Network,
    backend: Backend = Backend.auto,
    precision: Precision = Precision.auto,
    *,
    live: bool = False,
    say: Callable[[str], object] = lambda _: None,
    engines: Engines | None = None,
) -> Detector:
    """A detector on the engine and with the precision wanted.

    `auto` takes the fastest that is installed and computes an image, and tells `say` which did
    not. On a CPU, the precision `auto` and int8 have the network pruned where a calibration says
    how. `live` asks for the shortest time a frame rather than the most frames a second. `engines`
    are used again where one of them is what is wanted. Raises DroptrackError when what was named is
    not to be had.
    """
    key = (*network.key(), backend, precision, live)
    make = partial(_choose_engine, network, backend, precision, live=live, say=say)
    return network.detector((engines or Engines()).get(key, make))


def _choose_engine(
    network: Network,
    backend: Backend,
    precision: Precision,
    *,
    live: bool,
    say: Callable[[str], object],
) -> Engine:
    """The engine for `choose_detector`."""
    weights = cache(network.weights)
    if backend is not Backend.auto:
        return _engine(network, weights, backend, precision, live=live)
    reasons = []
    for candidate in _candidates(precision):
        try:
            engine = _engine(network, weights, candidate, precision, live=live)
        except DroptrackError as error:
            weights()  # if it is they that are wrong, no engine takes them
            reasons.append(str(error))
            continue
        for reason in reasons:
            say(f"not used: {reason}")
        return engine
    cure = "" if precision is Precision.fp16 else "; pip install 'droptrack[openvino]'"
    raise DroptrackError(
        "; ".join(reasons) or f"--precision {precision}: no engine here has it{cure}"
    )


def _candidates(precision: Precision) -> Iterator[Backend]:
    """Engines that are installed, the fastest first.

    Importing PyTorch takes seconds, so it is not asked for a GPU where there is no driver; on CPUs
    it is the slowest.
    """
    driver = _has_driver()
    here = {
        Backend.torch_cuda: driver and _installed("torch"),
        Backend.opencv_cuda: opencv_dnn.has_cuda(),
        Backend.openvino: _installed("openvino") and _installed("onnx"),
        Backend.opencv: True,
        Backend.torch: _installed("torch")
        and (precision is Precision.bf16 or not opencv_dnn.reads_darknet()),
    }
    for backend, precisions in PRECISIONS.items():
        if here[backend] and (precision is Precision.auto or precision in precisions):
            yield backend


@cache
def _has_driver() -> bool:
    """Whether there is a driver of NVIDIA's GPUs, by its library on Linux and on Windows."""
    for name in ("libcuda.so.1", "nvcuda"):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


def _installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


def _engine(
    network: Network,
    weights: Callable[[], Weights],
    backend: Backend,
    precision: Precision,
    *,
    live: bool,
) -> Engine:
    """An engine that has computed an image; raises DroptrackError with the reason if it cannot."""
    if precision is not Precision.auto and precision not in PRECISIONS[backend]:
        has = ", ".join(PRECISIONS[backend])
        raise DroptrackError(f"--precision {precision}: {backend} computes in {has}")
    try:
        engine = _make(network, weights, backend, precision, live=live)
        black = grey_frame(np.zeros((network.cfg.height, network.cfg.width), np.uint8))
        engine.rows(engine.start(engine.prepare([black])).result().outputs)
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        extra = EXTRAS.get(package)
        cure = f"pip install 'droptrack[{extra}]'" if extra else f"it lacks {error.name}"
        raise DroptrackError(f"--backend {backend}: is not installed; {cure}") from None
    except (RuntimeError, cv2.error, OSError) as error:
        reason = first_line(error)
        raise DroptrackError(f"--backend {backend}: does not work here: {reason}") from error
    return engine


def _make(
    network: Network,
    weights: Callable[[], Weights],
    backend: Backend,
    precision: Precision,
    *,
    live: bool,
) -> Engine:
    cfg, path, threshold = network.cfg, network.weights_path, network.threshold
    automatic = precision is Precision.auto
    calibration = None
    if precision is Precision.int8 or (automatic and backend in ON_CPU):
        calibration = find_calibration(path, cfg)
    if precision is Precision.int8 and calibration is None:
        raise DroptrackError(
            f"--precision int8: {path} is not calibrated for {cfg.width} x {cfg.height} px: "
            f"python -m droptrack.calibrate --weights {path} --size {cfg.width}x{cfg.height} "
            "--data DIR/obj.data"
        )

    def smaller() -> tuple[Cfg, Weights]:
        """The network, pruned where a calibration says how."""
        if calibration is None:
            return cfg, weights()
        return pruned(cfg, weights(), calibration.pruning)

    if automatic:
        precision = _fastest(backend, calibrated=calibration is not None)
    engine: Engine
    if backend in (Backend.opencv, Backend.opencv_cuda):
        engine = opencv_dnn.OpenCvEngine(*smaller(), backend, precision, threshold)
    elif backend is Backend.openvino:
        from droptrack.detection.engines.openvino import OpenVinoEngine, usable_cores

        ranges = calibration.ranges if calibration and precision is Precision.int8 else None
        streams = 1 if live else min(2, usable_cores())
        told_by = {
            "weights": sha256_of(path),
            "calibration": "" if calibration is None else calibration.digest(),
        }
        engine = OpenVinoEngine(cfg, smaller, precision, threshold, ranges, streams, told_by)
    else:
        from droptrack.detection.engines.pytorch import TorchCudaEngine, TorchEngine

        kind = TorchCudaEngine if backend is Backend.torch_cuda else TorchEngine
        engine = kind(*smaller(), precision, threshold)
    if calibration is not None and calibration.pruning.kept:
        engine.name += ", pruned"
    return engine


def _fastest(backend: Backend, *, calibrated: bool) -> Precision:
    """The precision that `auto` stands for."""
    if backend is Backend.openvino:
        from droptrack.detection.engines.openvino import computes_faster_in

        if calibrated and computes_faster_in("int8"):
            return Precision.int8
        if computes_faster_in("bf16"):
            return Precision.bf16
    return PRECISIONS[backend][0]
