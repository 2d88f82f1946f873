"""Cfg and Weights -> ONNX, with batch normalisation folded into the convolutions."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper

from droptrack.data.arrays import Float32s
from droptrack.data.files import replacing
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import (
    Cfg,
    Layer,
    YoloHead,
    layer_shapes,
    route_sources,
    yolo_heads,
)
from droptrack.network.darknet_weights import Weights, layer_values
from droptrack.network.onnx_graph import Graph
from droptrack.network.onnx_pools import ByteConvolution, pooled, pooled_layers, pooled_picture
from droptrack.version import __version__

Range = tuple[float, float]

OPSET = 13  # the first with a scale for each channel in DequantizeLinear
# the largest step of a quantised kernel. A CPU without VNNI adds two products of bytes in 16 bits,
# which overflow beyond 2 * 255 * 64
KERNEL_MAX, UNSATURATED_MAX = 127, 64
IR_VERSION = 8
BATCH_NORM_EPSILON = 1e-5  # as in Darknet's forks and OpenCV


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


def onnx_model(
    cfg: Cfg,
    weights: Weights,
    *,
    decode: bool = False,
    pixels: bool = False,
    grey: bool = False,
    ranges: Mapping[int, Range] | None = None,
    taps: Sequence[int] = (),
    pool_bytes: bool = False,
    kernel_max: int = KERNEL_MAX,
) -> onnx.ModelProto:
    """The network as an ONNX model for any batch B of pictures of the cfg's size.

    Its input `images` (B, 3, height, width) is RGB, float32 in [0, 1], or uint8 with `pixels`; with
    `grey`, the input has one channel, which stands for all three. Its outputs `head_0`, `head_1`,
    ... are the maps of the ``[yolo]`` layers (B, A * (5 + C), rows, columns) as Darknet's
    convolutions leave them. With `decode` there is one output `detections` (B, N, 5 + C): boxes
    [cx, cy, w, h] relative to the picture, objectness and class probabilities.

    `ranges`: the least and largest value of layers' outputs by index; with them, these layers and
    all kernels are quantised to 8 bits (QuantizeLinear, DequantizeLinear). `taps`: layers whose
    outputs are put out too, as `layer_0` and so on. `pool_bytes`: with `ranges`, compute the first
    pools as `onnx_pools` does, for OpenVINO. `kernel_max`: with `ranges`, the largest step of a
    kernel, KERNEL_MAX or UNSATURATED_MAX. Raises DroptrackError for layers that are not supported,
    with their line.
    """
    graph = Graph()
    kernels = folded_convolutions(cfg, weights)
    if grey:
        first = min(kernels)
        kernel, bias = kernels[first]
        kernels[first] = (kernel.sum(axis=1, keepdims=True), bias)
    heads = {head.layer: head for head in yolo_heads(cfg)}
    names: list[str] = []
    maps: list[str] = []
    quantised = ranges is not None
    together = pooled_layers(cfg) if quantised and pool_bytes else set()
    x = _input(graph, pixels=pixels, quantised=quantised)
    for index, layer in enumerate(cfg.layers):
        if index in together:
            assert ranges is not None
            both = _byte_convolution(*kernels[index], ranges[index], kernel_max)
            if index == 0 and grey and pixels:
                x = pooled_picture(graph, "images", both, cfg.height, cfg.width)
            else:
                x = pooled(graph, x, both)
        elif index - 1 in together:
            pass
        elif layer.kind == "convolutional":
            x = _convolution(graph, layer, x, *kernels[index], kernel_max if quantised else None)
            x = _activation(graph, layer, x, default="logistic")
        elif layer.kind == "yolo":
            maps.append(_decoded(graph, heads[index], x, cfg) if decode else x)
        else:
            x = _plain_layer(graph, layer, index, x, names, layer_shapes(cfg))
        if ranges is not None and index in ranges and index not in together:
            x = _quantised(graph, x, ranges[index])
        names.append(x)
    channels = 1 if grey else cfg.net.integer("channels", 3)
    image = helper.make_tensor_value_info(
        "images",
        TensorProto.UINT8 if pixels else TensorProto.FLOAT,
        ["batch", channels, cfg.height, cfg.width],
    )
    outputs = _outputs(graph, cfg, list(heads.values()), maps, decode=decode)
    for index in taps:
        name = graph.node("Identity", names[index], name=f"layer_{index}")
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, None))
    return helper.make_model(
        helper.make_graph(graph.nodes, cfg.path.stem, [image], outputs, graph.constants),
        producer_name="droptrack",
        producer_version=__version__,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )


def export_onnx(path: Path, cfg: Cfg, weights: Weights, *, decode: bool = False) -> list[str]:
    """Write a network as an ONNX model (`onnx_model`), checked; returns the names of its outputs.

    Raises DroptrackError for layers that are not supported, and if the file cannot be written.
    """
    model = onnx_model(cfg, weights, decode=decode)
    onnx.checker.check_model(model, full_check=True)
    try:
        with replacing(path) as partial:
            partial.write_bytes(model.SerializeToString())
    except OSError as error:
        raise DroptrackError(f"{path}: cannot be written: {error.strerror}") from None
    return [output.name for output in model.graph.output]


def _input(graph: Graph, *, pixels: bool, quantised: bool) -> str:
    """The picture in [0, 1], which 8 bits hold exactly."""
    if not quantised and not pixels:
        return "images"
    scale, zero = graph.constant(np.float32(1 / 255)), graph.constant(np.uint8(0))
    bytes_ = "images" if pixels else graph.node("QuantizeLinear", "images", scale, zero)
    return graph.node("DequantizeLinear", bytes_, scale, zero)


def _convolution(
    graph: Graph, layer: Layer, x: str, kernel: Float32s, bias: Float32s, kernel_max: int | None
) -> str:
    """A convolution, with its kernel in steps up to `kernel_max`, or as it is."""
    size = kernel.shape[2]
    stride = layer.integer("stride", 1)
    padding = size // 2 if layer.integer("pad", 0) else layer.integer("padding", 0)
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
        pads=[padding] * 4,
        group=layer.integer("groups", 1),
    )


def _kernel_steps(kernel: Float32s, kernel_max: int) -> tuple[NDArray[np.int8], Float32s]:
    """A kernel (out, in, h, w) in steps up to `kernel_max`, and their scale (out,)."""
    scale = np.maximum(np.abs(kernel).max(axis=(1, 2, 3)), 1e-12) / np.float32(kernel_max)
    return np.round(kernel / scale[:, None, None, None]).astype(np.int8), scale


def _byte_convolution(
    kernel: Float32s, bias: Float32s, limits: Range, kernel_max: int
) -> ByteConvolution:
    return ByteConvolution(*_kernel_steps(kernel, kernel_max), bias, *_byte_steps(limits))


def _activation(graph: Graph, layer: Layer, x: str, default: str) -> str:
    activation = layer.text("activation", default)
    if activation == "leaky":
        return graph.node("LeakyRelu", x, alpha=0.1)
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
        size, stride = layer.integer("size", 2), layer.integer("stride", 1)
        padding = layer.integer("padding", size - 1)
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
        (source,) = route_sources(layer, index, key="from")
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


def _decoded(graph: Graph, head: YoloHead, x: str, cfg: Cfg) -> str:
    """A head's map -> rows (B, N, 5 + C) (YOLOv3, section 2.1), as `detector.decode_head`."""
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
    bounded = graph.node("Min", part(2, 4), graph.floats(10))
    size = graph.node(
        "Mul", graph.node("Exp", bounded), graph.constant(prior[None].astype(np.float32))
    )
    return graph.node(
        "Concat", centre, size, graph.node("Sigmoid", part(4, 5 + head.classes)), axis=2
    )


def _outputs(
    graph: Graph, cfg: Cfg, heads: list[YoloHead], maps: list[str], *, decode: bool
) -> list[onnx.ValueInfoProto]:
    """Name the outputs and describe their shapes."""
    if decode:
        graph.node("Concat", *maps, name="detections", axis=1)
        n = sum(len(h.anchors) * cfg.height * cfg.width // h.stride**2 for h in heads)
        shapes: dict[str, list[str | int]] = {"detections": ["batch", n, 5 + heads[0].classes]}
    else:
        shapes = {}
        for number, (head, name) in enumerate(zip(heads, maps, strict=True)):
            channels = len(head.anchors) * (5 + head.classes)
            size = (cfg.height // head.stride, cfg.width // head.stride)
            shapes[graph.node("Identity", name, name=f"head_{number}")] = ["batch", channels, *size]
    return [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in shapes.items()
    ]
