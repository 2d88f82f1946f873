"""Cfg and Weights -> ONNX, with batch normalisation folded into the convolutions."""

from collections.abc import Sequence
from pathlib import Path

import onnx
from onnx import TensorProto, helper

from droptrack.data.files import replacing
from droptrack.network.darknet_cfg import Cfg, YoloHead, yolo_heads
from droptrack.network.darknet_weights import Weights
from droptrack.network.onnx_graph import Graph
from droptrack.network.onnx_layers import Layers, decoded_map
from droptrack.network.quantisation import Quantisation
from droptrack.version import __version__

OPSET = 13  # the first with a scale for each channel in DequantizeLinear
IR_VERSION = 8


def onnx_model(
    cfg: Cfg,
    weights: Weights,
    *,
    decode: bool = False,
    pixels: bool = False,
    grey: bool = False,
    quantisation: Quantisation | None = None,
    taps: Sequence[int] = (),
) -> onnx.ModelProto:
    """The network as an ONNX model for any batch B of images of the cfg's size.

    Its input `images` (B, 3, height, width) is RGB, float32 in [0, 1], or uint8 with `pixels`; with
    `grey`, the input has one channel, which is used for all three. Its outputs `head_0`, `head_1`,
    ... are the maps of the ``[yolo]`` layers (B, A * (5 + C), rows, columns) as Darknet's
    convolutions leave them. With `decode` there is one output `detections` (B, N, 5 + C): boxes
    [cx, cy, w, h] relative to the image, objectness and class probabilities.

    With `quantisation`, layers and kernels are quantised to 8 bits (QuantizeLinear,
    DequantizeLinear). `taps`: layers that are further outputs, named `layer_0` and so on. Raises
    DroptrackError for layers that are not supported, with their line.
    """
    graph = Graph()
    heads = yolo_heads(cfg)
    layers = Layers(graph, cfg, weights, quantisation, pixels=pixels, grey=grey)
    maps: list[str] = []
    for index, layer in enumerate(cfg.layers):
        x = layers.add(index)
        if layer.kind == "yolo":
            maps.append(decoded_map(graph, heads[len(maps)], x, cfg) if decode else x)
    outputs = _outputs(graph, cfg, heads, maps, decode=decode)
    for index in taps:
        name = graph.node("Identity", layers.names[index], name=f"layer_{index}")
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, None))
    image = helper.make_tensor_value_info(
        "images",
        TensorProto.UINT8 if pixels else TensorProto.FLOAT,
        ["batch", 1 if grey else cfg.net.integer("channels", 3), cfg.height, cfg.width],
    )
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
    with replacing(path) as partial:
        partial.write_bytes(model.SerializeToString())
    return [output.name for output in model.graph.output]


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
