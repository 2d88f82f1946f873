"""The layers of a network as nodes of an ONNX graph."""

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Float32s
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import (
    BATCH_NORM_EPSILON,
    LEAKY_SLOPE,
    MAX_LOG_SIZE,
    Cfg,
    Layer,
    YoloHead,
    convolution_padding,
    layer_shapes,
    pool_options,
    route_sources,
)
from droptrack.network.darknet_weights import Weights, layer_values
from droptrack.network.onnx_graph import Graph
from droptrack.network.onnx_pools import ByteConvolution, pooled, pooled_image, pooled_layers
from droptrack.network.quantisation import Quantisation, Range


def folded_convolutions(cfg: Cfg, weights: Weights) -> dict[int, tuple[Float32s, Float32s]]:
    """Kernel (out, in, h, w) and bias (out,) of each convolution by its layer's index.

    With batch normalisation: kernel * s and bias - mean * s, s = scale / sqrt(variance + epsilon)
    (Ioffe and Szegedy 2015, section 3.1, at inference).
    """
    found = {}
    for convolution, vectors, values in layer_values(cfg, weights):
        bias, *rest = vectors.astype(np.float64)
        factor = np.ones(convolution.outputs)
        if convolution.batch_normalize:
            scale, mean, variance = rest
            factor = scale / np.sqrt(variance + BATCH_NORM_EPSILON)
            bias = bias - mean * factor
        kernel = values * factor[:, None]
        shape = (convolution.outputs, convolution.inputs, convolution.size, convolution.size)
        found[convolution.layer] = (
            kernel.reshape(shape).astype(np.float32),
            bias.astype(np.float32),
        )
    return found


class Layers:
    """Adds the layers of a network to a graph, one after the other.

    `names` are the outputs of those that were added. `quantisation`, `pixels` and `grey` are those
    of `onnx_model`.
    """

    def __init__(
        self,
        graph: Graph,
        cfg: Cfg,
        weights: Weights,
        quantisation: Quantisation | None,
        *,
        pixels: bool,
        grey: bool,
    ) -> None:
        self.names: list[str] = []
        self._graph, self._cfg, self._quantisation = graph, cfg, quantisation
        self._grey_pixels = grey and pixels
        self._shapes = layer_shapes(cfg)
        self._kernels = folded_convolutions(cfg, weights)
        if grey:
            first = min(self._kernels)
            kernel, bias = self._kernels[first]
            self._kernels[first] = (kernel.sum(axis=1, keepdims=True), bias)
        pool_bytes = quantisation is not None and quantisation.pool_bytes
        self._with_pool = pooled_layers(cfg) if pool_bytes else set()
        self._x = _input(graph, pixels=pixels, quantised=quantisation is not None)

    def add(self, index: int) -> str:
        """Add the next layer; returns its output. Raises DroptrackError for an unknown one."""
        layer, graph, quantisation = self._cfg.layers[index], self._graph, self._quantisation
        x = self._x
        if quantisation is not None and index in self._with_pool:
            x = self._add_with_pool(index, quantisation)
        elif index - 1 in self._with_pool:
            pass
        elif layer.kind == "convolutional":
            kernel_max = None if quantisation is None else quantisation.kernel_max
            x = _convolution(graph, layer, x, *self._kernels[index], kernel_max)
            x = _activation(graph, layer, x, default="logistic")
        elif layer.kind != "yolo":
            x = _plain_layer(graph, layer, index, x, self.names, self._shapes)
        limits = None if quantisation is None else quantisation.ranges.get(index)
        if limits is not None and index not in self._with_pool:
            x = _quantised(graph, x, limits)
        self._x = x
        self.names.append(x)
        return x

    def _add_with_pool(self, index: int, quantisation: Quantisation) -> str:
        """A convolution and the pool after it, in bytes."""
        kernel, bias = self._kernels[index]
        steps, kernel_scale = _kernel_steps(kernel, quantisation.kernel_max)
        scale, zero = _byte_steps(quantisation.ranges[index])
        both = ByteConvolution(
            kernel=steps, kernel_scale=kernel_scale, bias=bias, scale=scale, zero=zero
        )
        if index == 0 and self._grey_pixels:
            return pooled_image(self._graph, "images", both, self._cfg.height, self._cfg.width)
        return pooled(self._graph, self._x, both)


def _input(graph: Graph, *, pixels: bool, quantised: bool) -> str:
    """The image in [0, 1], which 8 bits hold exactly."""
    if not quantised and not pixels:
        return "images"
    scale, zero = graph.constant(np.float32(1 / 255)), graph.constant(np.uint8(0))
    bytes_ = "images" if pixels else graph.node("QuantizeLinear", "images", scale, zero)
    return graph.node("DequantizeLinear", bytes_, scale, zero)


def _convolution(
    graph: Graph, layer: Layer, x: str, kernel: Float32s, bias: Float32s, kernel_max: int | None
) -> str:
    """A convolution, with its kernel in steps up to `kernel_max`, or as it is."""
    size, stride = kernel.shape[2], layer.integer("stride", 1)
    if kernel_max is not None:
        steps, scale = _kernel_steps(kernel, kernel_max)
        zeros = graph.constant(np.zeros(len(scale), np.int8))
        weight = graph.node(
            "DequantizeLinear", graph.constant(steps), graph.constant(scale), zeros, axis=0
        )
    else:
        weight = graph.constant(kernel)
    return graph.node(
        "Conv",
        x,
        weight,
        graph.constant(bias),
        kernel_shape=[size, size],
        strides=[stride, stride],
        pads=[convolution_padding(layer)] * 4,
        group=layer.integer("groups", 1),
    )


def _kernel_steps(kernel: Float32s, kernel_max: int) -> tuple[NDArray[np.int8], Float32s]:
    """A kernel (out, in, h, w) in steps up to `kernel_max`, and their scale (out,)."""
    scale = np.maximum(np.abs(kernel).max(axis=(1, 2, 3)), 1e-12) / np.float32(kernel_max)
    return np.round(kernel / scale[:, None, None, None]).astype(np.int8), scale


def _activation(graph: Graph, layer: Layer, x: str, default: str) -> str:
    activation = layer.text("activation", default)
    if activation == "leaky":
        return graph.node("LeakyRelu", x, alpha=LEAKY_SLOPE)
    if activation == "mish":
        return graph.node("Mul", x, graph.node("Tanh", graph.node("Softplus", x)))
    if activation != "linear":
        raise DroptrackError(f"line {layer.line}: activation={activation} is not supported")
    return x


def _plain_layer(
    graph: Graph,
    layer: Layer,
    index: int,
    x: str,
    names: list[str],
    shapes: list[tuple[int, int]],
) -> str:
    """A layer without values; `names` are the outputs of those before it."""
    if layer.kind == "maxpool":
        size, stride, padding = pool_options(layer)
        before, after = padding // 2, padding - padding // 2  # ONNX ignores what is padded
        if stride == size:
            after = before = 0  # sizes are multiples of 32: there is no rest to pad
        return graph.node(
            "MaxPool",
            x,
            kernel_shape=[size, size],
            strides=[stride, stride],
            pads=[before, before, after, after],
        )
    if layer.kind == "upsample":
        factor = float(layer.integer("stride", 2))
        return graph.node(
            "Resize",
            x,
            graph.floats(),  # no region of interest
            graph.floats(1, 1, factor, factor),
            mode="nearest",
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
        )
    if layer.kind == "shortcut":
        (source,) = route_sources(layer, index)
        return _activation(graph, layer, graph.node("Add", x, names[source]), default="linear")
    if layer.kind == "route":
        groups, group = layer.integer("groups", 1), layer.integer("group_id", 0)
        parts = []
        for source in route_sources(layer, index):
            name, n = names[source], shapes[source][0] // groups
            if groups > 1:
                span = (graph.integers(group * n), graph.integers((group + 1) * n))
                name = graph.node("Slice", name, *span, graph.integers(1))
            parts.append(name)
        return graph.node("Concat", *parts, axis=1) if len(parts) > 1 else parts[0]
    raise DroptrackError(f"line {layer.line}: layer [{layer.kind}] is not supported")


def _byte_steps(limits: Range) -> tuple[np.float32, np.uint8]:
    """Scale of 256 steps between two limits, and which of them is zero."""
    low, high = min(limits[0], 0.0), max(limits[1], 1e-6)
    scale = np.float32((high - low) / 255)
    return scale, np.uint8(np.clip(round(-low / float(scale)), 0, 255))


def _quantised(graph: Graph, x: str, limits: Range) -> str:
    """`x` on the 256 steps between its limits, zero being one of them."""
    step, zero = (graph.constant(value) for value in _byte_steps(limits))
    return graph.node("DequantizeLinear", graph.node("QuantizeLinear", x, step, zero), step, zero)


def decoded_map(graph: Graph, head: YoloHead, x: str, cfg: Cfg) -> str:
    """A head's map -> rows (B, N, 5 + C) (YOLOv3, section 2.1), as `decoding.decode_head`."""
    rows, columns, anchors = cfg.height // head.stride, cfg.width // head.stride, len(head.anchors)
    apart = graph.node("Reshape", x, graph.integers(-1, anchors, 5 + head.classes, rows * columns))
    last = graph.node("Transpose", apart, perm=[0, 1, 3, 2])
    flat = graph.node(
        "Reshape", last, graph.integers(-1, anchors * rows * columns, 5 + head.classes)
    )

    def part(start: int, end: int) -> str:
        return graph.node(
            "Slice", flat, graph.integers(start), graph.integers(end), graph.integers(2)
        )

    row, column = np.mgrid[:rows, :columns].reshape(2, -1)
    corner = np.tile(np.column_stack([column, row]), (anchors, 1)) - (head.scale_x_y - 1) / 2
    in_cell = graph.node("Mul", graph.node("Sigmoid", part(0, 2)), graph.floats(head.scale_x_y))
    centre = graph.node("Add", in_cell, graph.constant(corner[None].astype(np.float32)))
    centre = graph.node("Mul", centre, graph.floats(1 / columns, 1 / rows))
    prior = np.repeat(head.anchors, rows * columns, axis=0) / [cfg.width, cfg.height]
    bounded = graph.node("Min", part(2, 4), graph.floats(MAX_LOG_SIZE))
    size = graph.node(
        "Mul", graph.node("Exp", bounded), graph.constant(prior[None].astype(np.float32))
    )
    return graph.node(
        "Concat", centre, size, graph.node("Sigmoid", part(4, 5 + head.classes)), axis=2
    )
