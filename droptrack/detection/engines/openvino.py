"""Networks through OpenVINO on the CPU, in fp32, bf16 or int8."""

import functools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import cv2
import numpy as np
import openvino

from droptrack.data.arrays import Float32s, Pixels
from droptrack.data.frames import Frame, grey_planes
from droptrack.detection.decoding import decode_heads
from droptrack.detection.detector import Computed
from droptrack.detection.engines import compiled_networks
from droptrack.network.darknet_cfg import Cfg, cfg_text, yolo_heads
from droptrack.network.darknet_weights import Weights
from droptrack.network.quantisation import KERNEL_MAX, UNSATURATED_MAX, Quantisation, Range

# in int8, what is not quantised, such as the last maps, is computed in fp32
INFERENCE_PRECISION = {"fp32": "f32", "bf16": "bf16", "int8": "f32"}


class OpenVinoEngine:
    """A network in OpenVINO.

    `weights`: those of `cfg`, or what gives a cfg and its weights once they are to be compiled.
    `ranges` of the layers' outputs, for int8 (`quantisation.Calibration`). `streams`: how many
    images are computed at once, each by a part of the cores: one for the shortest time from image
    to boxes, two for more images a second. `told_by`: what tells weights and ranges from others,
    where compiled networks are to be kept from one run to the next. Grey frames take a network
    with one channel.
    """

    opencv_threads = 1

    def __init__(
        self,
        cfg: Cfg,
        weights: Weights | Callable[[], tuple[Cfg, Weights]],
        precision: str,
        threshold: float,
        ranges: Mapping[int, Range] | None = None,
        streams: int = 1,
        told_by: Mapping[str, str] | None = None,
    ) -> None:
        self.name = f"openvino {precision}"
        self.parallel = streams
        self._cfg, self._weights, self._ranges = cfg, weights, ranges
        self._told_by = told_by
        self._size = (cfg.width, cfg.height)
        self._heads, self._threshold = yolo_heads(cfg), threshold
        self._settings = {
            "INFERENCE_PRECISION_HINT": INFERENCE_PRECISION[precision],
            "PERFORMANCE_HINT": "LATENCY" if streams == 1 else "THROUGHPUT",
            "NUM_STREAMS": streams,
            "INFERENCE_NUM_THREADS": usable_cores(),
        }
        self._networks: dict[int, Compiled] = {}

    def prepare(self, frames: Sequence[Frame]) -> Pixels:
        """Images (B, 1 or 3, height, width) of bytes, grey or RGB, stretched to the size."""
        if (planes := grey_planes(frames)) is None:
            blob = cv2.dnn.blobFromImages(frames, 1, self._size, swapRB=True, ddepth=cv2.CV_8U)
            return np.asarray(blob, np.uint8)
        pixels = np.empty((len(frames), 1, self._size[1], self._size[0]), np.uint8)
        for plane, target in zip(planes, pixels, strict=True):
            cv2.resize(plane, self._size, dst=target[0])
        return pixels

    def start(self, prepared: Pixels) -> "Computing":
        """Compute images one by one, since together they take the same time."""
        return Computing(self._network(prepared.shape[1]), prepared)

    def rows(self, outputs: list[Float32s]) -> list[Float32s]:
        """Decoded rows (N, 5 + C) of each image."""
        return decode_heads(outputs, self._heads, self._threshold)

    def _network(self, channels: int) -> "Compiled":
        """The network for grey or RGB images, compiled when it is needed."""
        if channels not in self._networks:
            compiled = self._kept(channels) or self._compiled(channels)
            self._networks[channels] = Compiled(compiled, deque(maxlen=self.parallel))
        return self._networks[channels]

    def _kept(self, channels: int) -> openvino.CompiledModel | None:
        """The network as an earlier run compiled it; None where none is kept."""
        if self._told_by is None:
            return None
        network = compiled_networks.find(self._about(channels))
        try:
            return network and core().import_model(network, "CPU", self._settings)
        except RuntimeError:  # OpenVINO does not take it
            return None

    def _compiled(self, channels: int) -> openvino.CompiledModel:
        """The network, compiled, and kept for the next run."""
        from droptrack.network.onnx_export import onnx_model

        cfg, weights = (self._cfg, self._weights)
        if callable(weights):
            cfg, weights = weights()
        quantisation = None
        if self._ranges is not None:
            quantisation = Quantisation(self._ranges, kernel_max(), pool_bytes=True)
        model = onnx_model(cfg, weights, pixels=True, grey=channels == 1, quantisation=quantisation)
        network = core().read_model(model.SerializeToString())
        network.reshape([1, channels, *self._size[::-1]])
        compiled = core().compile_model(network, "CPU", self._settings)
        if self._told_by is not None:
            compiled_networks.keep(self._about(channels), compiled.export_model().getvalue())
        return compiled

    def _about(self, channels: int) -> dict[str, object]:
        """All that a compiled network depends on."""
        return {
            **(self._told_by or {}),
            "cfg": cfg_text(self._cfg),
            "channels": channels,
            "kernel_max": None if self._ranges is None else kernel_max(),
            "settings": self._settings,
            "openvino": openvino.__version__,
            "cpu": core().get_property("CPU", "FULL_DEVICE_NAME"),
            "computes": sorted(core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")),
        }


@dataclass
class Compiled:
    """A compiled network, its requests that are free, and when the last ones were done."""

    network: openvino.CompiledModel
    done: deque[float]  # as many as are computed at once, ``time.perf_counter``
    free: list[openvino.InferRequest] = field(default_factory=list)


class Computing:
    """Images (B, C, height, width) on their way through a network."""

    def __init__(self, compiled: Compiled, images: Pixels) -> None:
        self._compiled = compiled
        self._requests: list[openvino.InferRequest] = []
        self._started = perf_counter()
        for image in images:
            free = compiled.free
            request = free.pop() if free else compiled.network.create_infer_request()
            self._requests.append(request)
            request.start_async([image[None]], share_inputs=True)

    def result(self) -> Computed:
        """The maps of the heads (B, A * (5 + C), rows, columns)."""
        found = []
        for request in self._requests:
            request.wait()
            found.append([np.array(map_.data, np.float32) for map_ in request.output_tensors])
        done = self._compiled.done
        before = done[0] if len(done) == done.maxlen else 0.0
        done.append(self._started + self._requests[-1].latency / 1e3)
        self._compiled.free += self._requests
        maps = [np.concatenate(maps) for maps in zip(*found, strict=True)]
        return Computed(maps, done[-1] - max(self._started, before))


@functools.cache
def core() -> openvino.Core:
    """OpenVINO itself, kept until the process ends.

    It gives the thread that starts it a stack for signal handlers, and frees that with itself: the
    next Ctrl-C would end in a segmentation fault.
    """
    return openvino.Core()


def usable_cores() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def kernel_max() -> int:
    """The largest step of a kernel in int8 of which sums do not overflow on this CPU.

    With VNNI instructions a CPU adds products of bytes in 32 bits. Without (Intel's before Ice
    Lake, AMD's before Zen 4; or where nobody can tell), OpenVINO adds two products in 16 bits, and
    what overflows is cut off without a word.
    """
    try:
        from llvmlite.binding import get_host_cpu_features
    except ImportError:
        return UNSATURATED_MAX
    features = get_host_cpu_features()
    vnni = any(features.get(name, False) for name in ("avx512vnni", "avxvnni"))
    return KERNEL_MAX if vnni else UNSATURATED_MAX


def computes_faster_in(precision: str) -> bool:
    """Whether this CPU computes in bf16 or int8 faster than in fp32."""
    return precision.upper() in core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


def layer_outputs(
    cfg: Cfg, weights: Weights, layers: Sequence[int], frames: Iterable[Frame]
) -> Iterator[dict[int, Float32s]]:
    """For each frame what layers put out (1, C, H, W), in fp32, by layer."""
    from droptrack.network.onnx_export import onnx_model

    model = core().read_model(onnx_model(cfg, weights, taps=layers).SerializeToString())
    compiled = core().compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    for frame in frames:
        size = (cfg.width, cfg.height)
        outputs = compiled(cv2.dnn.blobFromImages([frame], 1 / 255, size, swapRB=True))
        yield {layer: outputs[f"layer_{layer}"] for layer in layers}


def output_ranges(
    cfg: Cfg, weights: Weights, layers: Sequence[int], frames: Iterable[Frame]
) -> dict[int, Range]:
    """The minimum and maximum that layers put out, in fp32, over frames, by layer."""
    ranges = dict.fromkeys(layers, (np.inf, -np.inf))
    for outputs in layer_outputs(cfg, weights, layers, frames):
        for layer, values in outputs.items():
            low, high = ranges[layer]
            ranges[layer] = min(low, float(values.min())), max(high, float(values.max()))
    return ranges
