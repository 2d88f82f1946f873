"""Networks through PyTorch, on the CPU or, all of it, on a GPU with CUDA."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from droptrack.data.arrays import Float32s
from droptrack.data.frames import Frame, grey_planes
from droptrack.detection.engines.in_thread import InThread
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg
from droptrack.network.darknet_weights import Weights
from droptrack.network.torch_network import (
    DarknetNetwork,
    Grid,
    decode_boxes,
    head_grid,
    load_values,
)

DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}


class FramesToRows(nn.Module):
    """Resizing, network and decoding in one module, so that a GPU need not wait for the CPU."""

    def __init__(self, cfg: Cfg, weights: Weights, dtype: torch.dtype) -> None:
        super().__init__()
        network = DarknetNetwork(cfg)
        load_values(network, weights.values)
        network.eval()
        for layer in network.layers:
            match layer, list(layer.children()):
                case nn.Sequential(), [nn.Conv2d() as convolution, nn.BatchNorm2d() as norm, *_]:
                    layer[0], layer[1] = fuse_conv_bn_eval(convolution, norm), nn.Identity()
        self.network = network.to(dtype, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.size, self.dtype = (cfg.height, cfg.width), dtype
        for number, head in enumerate(network.heads):
            grid = head_grid(head, cfg.height // head.stride, cfg.width // head.stride)
            for name, values in grid._asdict().items():
                self.register_buffer(f"{name}_{number}", values)

    def forward(self, frames: Tensor) -> Tensor:
        """Frames (B, H, W, 3 or 1) uint8, BGR or grey -> rows (B, N, 5 + C) as of `decode_head`."""
        x = frames.permute(0, 3, 1, 2).flip(1).float() / 255
        if x.shape[2:] != self.size:
            x = functional.interpolate(x, self.size, mode="bilinear", align_corners=False)
        x = x.expand(-1, 3, -1, -1).to(dtype=self.dtype, memory_format=torch.channels_last)
        parts = []
        for number, (raw, head) in enumerate(zip(self.network(x), self.network.heads, strict=True)):
            logits = raw.float().permute(0, 1, 3, 4, 2)  # (B, A, rows, columns, 5 + C)
            grid = Grid(*(self.get_buffer(f"{name}_{number}") for name in Grid._fields))
            centre, size = decode_boxes(logits, grid, head.scale_x_y)
            decoded = torch.cat([centre, size, logits[..., 4:].sigmoid()], dim=4)
            parts.append(decoded.flatten(1, 3))
        return torch.cat(parts, dim=1)


class TorchEngine(InThread):
    """A network in PyTorch on the CPU."""

    opencv_threads = 1
    device = "cpu"

    def __init__(self, cfg: Cfg, weights: Weights, precision: str, threshold: float) -> None:
        self.name = f"torch {precision}"
        self._size, self._threshold = (cfg.width, cfg.height), threshold
        self._network = FramesToRows(cfg, weights, DTYPES[precision]).to(self.device)

    def prepare(self, frames: Sequence[Frame]) -> Tensor:
        """Images (B, height, width, 3 or 1) of bytes, stretched to the network's size."""
        images = np.stack([cv2.resize(image, self._size) for image in _images(frames)])
        return torch.from_numpy(images.reshape(len(frames), *self._size[::-1], -1))

    def run(self, prepared: Tensor) -> Tensor:
        """Rows (B, N, 5 + C)."""
        with torch.inference_mode():
            rows: Tensor = self._network(prepared)
        return rows

    def rows(self, outputs: Tensor) -> list[Float32s]:
        """The rows (N, 5 + C) of each image with an objectness above the threshold."""
        every = outputs.numpy()
        return [rows[rows[:, 4] > self._threshold] for rows in every]


def _images(frames: Sequence[Frame]) -> Sequence[Frame]:
    """Frames (H, W, 3) as they are, grey ones (H, W, 1)."""
    planes = grey_planes(frames)
    return frames if planes is None else [plane[..., None] for plane in planes]


@dataclass(frozen=True)
class Recording:
    """A pass recorded on the GPU, with the memory that it reads and writes."""

    graph: torch.cuda.CUDAGraph
    frames: Tensor
    rows: Tensor


class TorchCudaEngine(TorchEngine):
    """A network in PyTorch on a GPU, which gets frames as they are and gives back boxes.

    Each size of batch is recorded once as a CUDA graph, which is then replayed as a whole. Raises
    DroptrackError without a GPU.
    """

    device = "cuda"

    def __init__(self, cfg: Cfg, weights: Weights, precision: str, threshold: float) -> None:
        if not torch.cuda.is_available():
            raise DroptrackError(
                "--backend torch-cuda: PyTorch finds no GPU with CUDA; is this its build for CPUs?"
            )
        if precision == "fp32":
            torch.backends.cudnn.allow_tf32 = False  # it has the precision of fp16
        super().__init__(cfg, weights, precision, threshold)
        self.name = f"torch-cuda {precision} ({torch.cuda.get_device_name()})"
        self._recordings: dict[torch.Size, Recording] = {}

    def prepare(self, frames: Sequence[Frame]) -> Tensor:
        """Frames (B, H, W, 3 or 1) of bytes in memory that the GPU reads by itself."""
        return torch.from_numpy(np.stack(_images(frames))).pin_memory()

    def run(self, prepared: Tensor) -> Tensor:
        """Rows (B, N, 5 + C), on the CPU."""
        with torch.inference_mode():
            if prepared.shape not in self._recordings:
                self._recordings[prepared.shape] = self._record(prepared)
            recording = self._recordings[prepared.shape]
            recording.frames.copy_(prepared, non_blocking=True)
            recording.graph.replay()
            return recording.rows.cpu()

    def _record(self, prepared: Tensor) -> Recording:
        frames = prepared.to(self.device)
        aside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):  # first passes choose algorithms, which cannot be recorded
            for _ in range(3):
                self._network(frames)
        torch.cuda.current_stream().wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        # another thread prepares the next frames meanwhile, with CUDA's memory
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            rows = self._network(frames)
        return Recording(graph, frames, rows)
