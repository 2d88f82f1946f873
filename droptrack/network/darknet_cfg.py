"""Darknet's ``.cfg`` files: text <-> typed values."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.data.files import read_text
from droptrack.errors import DroptrackError
from droptrack.network.cfg_options import NEEDED, refusal

MAX_INTEGER = 2**53  # which a float holds exactly
MAX_VALUES = 2**31  # of a network: 8 GB
MAX_PIXELS = 2**26  # of a network's input
INPUT_MULTIPLE = 32  # px: a YOLO network's input is a multiple of it
MAX_LOG_SIZE = 10.0  # bound on the logarithm of a box's size over its anchor's: none overflows
BATCH_NORM_EPSILON = 1e-5  # in Darknet's forks and OpenCV; the first Darknet had 1e-6
LEAKY_SLOPE = 0.1  # of activation=leaky below 0


@dataclass(frozen=True)
class Layer:
    """One section of a ``.cfg``: its kind, its options as written, and its line number (from 1)."""

    kind: str
    options: Mapping[str, str]
    line: int

    def integer(self, key: str, default: int | None = None) -> int:
        """The option as an int; raises DroptrackError if it is absent without default or no int."""
        value = self.number(key, default)
        if abs(value) > MAX_INTEGER or value != int(value):
            raise self._bad(key, "a whole number")
        return int(value)

    def count(self, key: str, default: int | None = None) -> int:
        """The option as an int from 1 on; raises DroptrackError as `integer` does."""
        value = self.integer(key, default)
        if value < 1:
            raise self._bad(key, "1 or more")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """The option as a float; raises DroptrackError as `integer` does."""
        values = self.numbers(key, None if default is None else (default,))
        if len(values) != 1:
            raise self._bad(key, "a number")
        return values[0]

    def numbers(self, key: str, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """The option as comma-separated numbers; raises DroptrackError as `integer` does."""
        text = self.options.get(key)
        if text is None:
            if default is None:
                raise DroptrackError(f"line {self.line}: [{self.kind}] needs {key}=")
            return default
        try:
            if not text.isascii() or "_" in text:  # which Python takes for a part of a number
                raise ValueError
            values = tuple(float(part) for part in text.split(",") if part.strip())
        except ValueError:
            raise self._bad(key, "a number, or several with commas") from None
        if not all(map(isfinite, values)):
            raise self._bad(key, "finite")
        return values

    def text(self, key: str, default: str) -> str:
        """The option as written, or the default."""
        return self.options.get(key, default)

    def _bad(self, key: str, wanted: str) -> DroptrackError:
        return DroptrackError(
            f"line {self.line}: [{self.kind}] {key}={self.options[key]} should be {wanted}"
        )


@dataclass(frozen=True)
class Cfg:
    """A network: the options of ``[net]`` and the layers in order, with the file they came from."""

    path: Path
    net: Layer
    layers: tuple[Layer, ...]

    @property
    def width(self) -> int:
        """Width of the network's input, px."""
        return self.net.integer("width")

    @property
    def height(self) -> int:
        """Height of the network's input, px."""
        return self.net.integer("height")


@dataclass(frozen=True, kw_only=True)
class Convolution:
    """Where one ``[convolutional]`` lies in a ``.weights`` file: counts of float32 values."""

    layer: int  # index into Cfg.layers
    inputs: int  # channels per group
    outputs: int
    size: int
    batch_normalize: bool

    @property
    def n_values(self) -> int:
        """Number of float32 values this layer has in the file."""
        per_channel = 4 if self.batch_normalize else 1
        return self.outputs * (per_channel + self.inputs * self.size * self.size)


@dataclass(frozen=True, kw_only=True)
class YoloHead:
    """One ``[yolo]`` layer: the anchors it uses (A, 2), px of the network's input, its stride."""

    layer: int
    anchors: NDArray[np.float64]
    all_anchors: NDArray[np.float64]
    mask: tuple[int, ...]
    classes: int
    stride: int
    scale_x_y: float  # how far beyond its cell a box's centre may lie (YOLOv4)


def read_cfg(path: Path) -> Cfg:
    """Read a ``.cfg``; raises DroptrackError naming the line that cannot be understood."""
    return parse_cfg(read_text(path), path)


def parse_cfg(text: str, path: Path) -> Cfg:
    """Parse the text of a ``.cfg``; `path` only names it in errors."""
    # each section, its options, and their lines
    sections: list[tuple[Layer, dict[str, str], dict[str, int]]] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#")[0].strip()
        if not line or line.startswith(";"):
            continue
        if line.startswith("["):
            if not line.endswith("]"):
                raise DroptrackError(
                    f"{path}:{number}: a section is written [kind], found {line!r}"
                )
            options: dict[str, str] = {}
            sections.append((Layer(line[1:-1].strip(), options, number), options, {}))
            continue
        key, equals, value = (part.strip() for part in line.partition("="))
        if not equals or not sections:
            raise DroptrackError(
                f"{path}:{number}: expected key=value in a section, found {line!r}"
            )
        _, options, lines = sections[-1]
        if options.get(key, value) != value:
            raise DroptrackError(
                f"{path}:{number}: {key}={value}, but line {lines[key]} has "
                f"{key}={options[key]}; which one is meant?"
            )
        options[key], lines[key] = value, number
    if not sections or sections[0][0].kind not in ("net", "network"):
        raise DroptrackError(f"{path}: a Darknet .cfg starts with [net]; is this another file?")
    for section, _, lines in sections:
        _check_options(path, section, lines)
    net, *layers = (section for section, _, _ in sections)
    cfg = Cfg(path, net, tuple(layers))
    _check(cfg)
    return cfg


def _check_options(path: Path, section: Layer, lines: Mapping[str, int]) -> None:
    """Raise DroptrackError for an option that no engine applies, with its line."""
    kind = "net" if section.kind == "network" else section.kind
    for key, number in lines.items():
        problem = refusal(kind, key, section.options)
        if problem is not None:
            raise DroptrackError(f"{path}:{number}: {key}={section.options[key]} {problem}")
    for key in NEEDED.get(kind, ()):
        if key not in section.options:
            raise DroptrackError(f"{path}:{section.line}: [{kind}] needs {key}=")


def cfg_text(cfg: Cfg) -> str:
    """The ``.cfg`` as text, which `parse_cfg` reads back to the same sections."""
    parts = []
    for layer in (cfg.net, *cfg.layers):
        lines = [f"[{layer.kind}]", *(f"{key}={value}" for key, value in layer.options.items())]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def with_options(cfg: Cfg, net: Mapping[str, str], yolo: Mapping[str, str]) -> Cfg:
    """A copy of the cfg with options of ``[net]`` and of every ``[yolo]`` replaced or added."""
    layers = tuple(
        Layer(layer.kind, {**layer.options, **yolo}, layer.line) if layer.kind == "yolo" else layer
        for layer in cfg.layers
    )
    changed = Cfg(cfg.path, Layer("net", {**cfg.net.options, **net}, cfg.net.line), layers)
    _check(changed)
    return changed


def resized(cfg: Cfg, width: int, height: int) -> Cfg:
    """A copy of the cfg with another input size, px; raises DroptrackError as `parse_cfg` does."""
    return with_options(cfg, {"width": str(width), "height": str(height)}, {})


def _check(cfg: Cfg) -> None:
    for name, size in (("width", cfg.width), ("height", cfg.height)):
        if size < INPUT_MULTIPLE or size % INPUT_MULTIPLE:
            nearest = max(1, round(size / INPUT_MULTIPLE)) * INPUT_MULTIPLE
            raise DroptrackError(
                f"{cfg.path}:{cfg.net.line}: {name}={size}, but a YOLO network's input must be a "
                f"multiple of {INPUT_MULTIPLE}; the nearest is {nearest}"
            )
    try:
        heads = yolo_heads(cfg)
        shapes = layer_shapes(cfg)
    except DroptrackError as error:
        raise DroptrackError(f"{cfg.path}: {error}") from None
    n_values = sum(one.n_values for one in convolutions(cfg))
    if n_values > MAX_VALUES or cfg.width * cfg.height > MAX_PIXELS:
        raise DroptrackError(
            f"{cfg.path}: {n_values:,} values and an input of {cfg.width} x {cfg.height} px are "
            f"too many; up to {MAX_VALUES:,} and {MAX_PIXELS:,} px are read"
        )
    if not heads:
        raise DroptrackError(f"{cfg.path}: has no [yolo] layer, so it detects nothing")
    for head in heads:
        channels = shapes[head.layer][0]
        wanted = (head.classes + 5) * len(head.mask)
        if channels != wanted:
            raise DroptrackError(
                f"{cfg.path}:{cfg.layers[head.layer].line}: [yolo] with {head.classes} classes and "
                f"{len(head.mask)} anchors needs filters={wanted} in the [convolutional] before "
                f"it, which has {channels}"
            )


def layer_shapes(cfg: Cfg) -> list[tuple[int, int]]:
    """(channels, stride with respect to the input) of each layer's output.

    Raises DroptrackError for a layer that this project does not know, with its line.
    """
    shapes: list[tuple[int, int]] = []
    channels, stride = cfg.net.integer("channels", 3), 1
    for index, layer in enumerate(cfg.layers):
        if layer.kind == "convolutional":
            groups = layer.count("groups", 1)
            if channels % groups or layer.count("filters") % groups:
                raise DroptrackError(f"line {layer.line}: groups={groups} does not divide channels")
            channels = layer.count("filters")
            stride *= layer.count("stride", 1)
        elif layer.kind == "maxpool":
            stride *= layer.count("stride", 1)
        elif layer.kind == "upsample":
            factor = layer.count("stride", 2)
            if stride % factor:
                raise DroptrackError(f"line {layer.line}: [upsample] beyond the input's size")
            stride //= factor
        elif layer.kind == "route":
            sources = route_sources(layer, index)
            if len({shapes[source][1] for source in sources}) > 1:
                raise DroptrackError(
                    f"line {layer.line}: [route] concatenates layers of different sizes"
                )
            groups, group = layer.count("groups", 1), layer.integer("group_id", 0)
            if not 0 <= group < groups or any(shapes[source][0] % groups for source in sources):
                raise DroptrackError(f"line {layer.line}: group {group} of {groups} is not there")
            channels = sum(shapes[source][0] for source in sources) // groups
            stride = shapes[sources[0]][1]
        elif layer.kind == "shortcut":
            sources = route_sources(layer, index)
            if len(sources) > 1:
                raise DroptrackError(
                    f"line {layer.line}: [shortcut] from={layer.options['from']} adds several "
                    "layers, which no engine here does; one is supported"
                )
            source = sources[0]
            if shapes[source] != shapes[index - 1]:
                raise DroptrackError(f"line {layer.line}: [shortcut] adds layers of unlike shapes")
        elif layer.kind != "yolo":
            raise DroptrackError(f"line {layer.line}: layer [{layer.kind}] is not supported")
        shapes.append((channels, stride))
    return shapes


def route_sources(layer: Layer, index: int) -> list[int]:
    """Absolute indices of the layers that a ``[route]`` or ``[shortcut]`` at `index` reads."""
    key = "from" if layer.kind == "shortcut" else "layers"
    sources = [int(n) if n >= 0 else index + int(n) for n in layer.numbers(key)]
    if not sources or any(not 0 <= source < index for source in sources):
        raise DroptrackError(
            f"line {layer.line}: [{layer.kind}] names a layer that is not above it"
        )
    return sources


def convolution_padding(layer: Layer) -> int:
    """Cells of zeros on each side of what a ``[convolutional]`` reads."""
    return layer.integer("size", 1) // 2 if layer.integer("pad", 0) else layer.integer("padding", 0)


def pool_options(layer: Layer) -> tuple[int, int, int]:
    """Size, stride, and padding (of both sides together) of a ``[maxpool]``."""
    size = layer.integer("size", 2)
    return size, layer.integer("stride", 1), layer.integer("padding", size - 1)


def convolutions(cfg: Cfg) -> list[Convolution]:
    """Every convolution in the order in which a ``.weights`` file holds them."""
    shapes = layer_shapes(cfg)
    found = []
    for index, layer in enumerate(cfg.layers):
        if layer.kind != "convolutional":
            continue
        inputs = shapes[index - 1][0] if index else cfg.net.integer("channels", 3)
        found.append(
            Convolution(
                layer=index,
                inputs=inputs // layer.count("groups", 1),
                outputs=layer.count("filters"),
                size=layer.count("size", 1),
                batch_normalize=bool(layer.integer("batch_normalize", 0)),
            )
        )
    return found


def yolo_heads(cfg: Cfg) -> list[YoloHead]:
    """Every ``[yolo]`` layer, in the order of the file."""
    heads = []
    shapes = layer_shapes(cfg)
    for index, layer in enumerate(cfg.layers):
        if layer.kind != "yolo":
            continue
        if not index:
            raise DroptrackError(f"line {layer.line}: [yolo] cannot be the first layer")
        flat = layer.numbers("anchors")
        if len(flat) % 2 or not flat:
            raise DroptrackError(f"line {layer.line}: anchors= needs pairs of width, height")
        anchors = np.array(flat, float).reshape(-1, 2)
        if (anchors <= 0).any():
            raise DroptrackError(f"line {layer.line}: anchors= needs sizes above 0")
        if layer.integer("num", len(anchors)) != len(anchors):
            raise DroptrackError(
                f"line {layer.line}: num={layer.options['num']}, but anchors= has {len(anchors)}"
            )
        mask = tuple(int(n) for n in layer.numbers("mask", tuple(range(len(anchors)))))
        if any(not 0 <= n < len(anchors) for n in mask):
            raise DroptrackError(f"line {layer.line}: mask= names an anchor that is not there")
        if layer.integer("new_coords", 0):
            raise DroptrackError(f"line {layer.line}: [yolo] new_coords=1 is not supported")
        heads.append(
            YoloHead(
                layer=index,
                anchors=anchors[list(mask)],
                all_anchors=anchors,
                mask=mask,
                classes=layer.count("classes", 20),
                stride=shapes[index][1],
                scale_x_y=layer.number("scale_x_y", 1),
            )
        )
    return heads
