"""A convolution and the 2 x 2 pool after it in bytes, in forms that OpenVINO computes faster.

OpenVINO's 8-bit pool costs nearly the same for 16 channels as for 64, so that the first pool of a
network costs more than the convolution before it. Here maxima are taken of whole maps, and of
pixels with very many channels. The results are the same to the last bit.

What OpenVINO makes of a graph hangs on details: each convolution needs constants of its own to take
in what follows it, and a view (a reshape between two transpositions) is free only where it has
bytes on both sides, and a model of a fixed batch.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from droptrack.network.darknet_cfg import LEAKY_SLOPE, Cfg, Layer, pool_options, route_sources
from droptrack.network.onnx_graph import Graph

MAX_CHANNELS = 32  # of a convolution; with more, the ordinary pool is as fast
COLUMNS = 4  # neighbouring columns that become channels


@dataclass(frozen=True, kw_only=True)
class ByteConvolution:
    """A 3 x 3 convolution with a border of zeros and leaky ReLU, on 8-bit steps.

    Its output is (byte - zero) * scale.
    """

    kernel: NDArray[np.int8]  # (outputs, inputs, 3, 3)
    kernel_scale: NDArray[np.float32]  # (outputs,)
    bias: NDArray[np.float32]  # (outputs,)
    scale: np.float32
    zero: np.uint8

    def bytes(
        self,
        graph: Graph,
        x: str,
        pads: tuple[int, int, int, int],
        stride: int,
        kernel: NDArray[np.int8] | None = None,
    ) -> str:
        """Its output in bytes, with other pads (top, left, bottom, right) and stride.

        With another `kernel`, of several times the outputs, these are copies.
        """
        steps = self.kernel if kernel is None else kernel
        copies = len(steps) // len(self.kernel)
        weight = graph.node(
            "DequantizeLinear",
            graph.constant(steps),
            graph.constant(np.tile(self.kernel_scale, copies)),
            graph.constant(np.zeros(len(steps), np.int8)),
            axis=0,
        )
        bias = graph.constant(np.tile(self.bias, copies))
        shape = list(steps.shape[2:])
        y = graph.node(
            "Conv", x, weight, bias, kernel_shape=shape, strides=[stride] * 2, pads=list(pads)
        )
        y = graph.node("LeakyRelu", y, alpha=LEAKY_SLOPE)
        return graph.node(
            "QuantizeLinear", y, graph.constant(self.scale), graph.constant(self.zero)
        )

    def values(self, graph: Graph, bytes_: str) -> str:
        """The values of bytes."""
        return graph.node(
            "DequantizeLinear", bytes_, graph.constant(self.scale), graph.constant(self.zero)
        )


def pooled_layers(cfg: Cfg) -> set[int]:
    """Convolutions that can be computed together with the pool after them, and should."""
    read = {
        source
        for index, layer in enumerate(cfg.layers)
        if layer.kind in ("route", "shortcut")
        for source in route_sources(layer, index)
    }
    return {
        index
        for index, (layer, following) in enumerate(pairwise(cfg.layers))
        if _is_plain(layer)
        and following.kind == "maxpool"
        and pool_options(following)[:2] == (2, 2)
        and index not in read
    }


def _is_plain(layer: Layer) -> bool:
    return (
        layer.kind == "convolutional"
        and layer.integer("size", 1) == 3
        and layer.integer("stride", 1) == layer.integer("pad", 0) == layer.integer("groups", 1) == 1
        and layer.text("activation", "logistic") == "leaky"
        and layer.integer("filters") <= MAX_CHANNELS
    )


def pooled(graph: Graph, x: str, convolution: ByteConvolution) -> str:
    """The convolution and the pool: the maximum of four convolutions with a stride of 2."""
    sides = ((1, 0), (0, 1))
    parts = [
        convolution.bytes(graph, x, (top, left, bottom, right), 2)
        for top, bottom in sides
        for left, right in sides
    ]
    return convolution.values(graph, graph.node("Max", *parts))


def pooled_image(
    graph: Graph, image: str, convolution: ByteConvolution, height: int, width: int
) -> str:
    """The same of a grey image of bytes (B, 1, height, width), which mean 0 to 1.

    COLUMNS neighbours become channels. One convolution then computes the even columns, another the
    odd ones; the larger of both is pooled along lines. Two lines are pooled as two pixels with all
    columns for channels.
    """
    n = len(convolution.kernel)
    x = graph.node(
        "DequantizeLinear", image, graph.floats(1 / 255), graph.constant(np.zeros(1, np.uint8))
    )
    x = _channels_first(graph, x, height, width // COLUMNS, COLUMNS)
    parts = []
    for first, start, (left, right) in ((0, -COLUMNS, (1, 0)), (1, 0, (0, 1))):
        # three lines of two blocks of columns, the first of which is `start`
        window = np.zeros((COLUMNS // 2, n, 3, 2 * COLUMNS), np.int8)
        for copy, column in enumerate(range(first, COLUMNS, 2)):
            at = column - 1 - start
            window[copy, :, :, at : at + 3] = convolution.kernel[:, 0]
        blocks = window.reshape(-1, 3, 2, COLUMNS).transpose(0, 3, 1, 2)
        parts.append(convolution.bytes(graph, x, (1, left, 1, right), 1, blocks))
    y = graph.node("Transpose", graph.node("Max", *parts), perm=[0, 2, 3, 1])
    y = _channels_first(graph, y, height, 1, width // 2 * n)
    y = graph.node("MaxPool", y, kernel_shape=[2, 1], strides=[2, 1])
    y = graph.node("Transpose", convolution.values(graph, y), perm=[0, 2, 3, 1])
    return _channels_first(graph, y, height // 2, width // 2, n)


def _channels_first(graph: Graph, x: str, height: int, width: int, channels: int) -> str:
    """Values in the order (B, height, width, channels) as a map (B, channels, height, width)."""
    shaped = graph.node("Reshape", x, graph.integers(-1, height, width, channels))
    return graph.node("Transpose", shaped, perm=[0, 3, 1, 2])
