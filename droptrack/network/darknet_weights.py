"""Darknet's ``.weights`` files: bytes <-> typed values.

A file is little-endian: int32 major, minor, revision; then the number of images seen in training
(uint64 from version 0.2 on, uint32 before); then float32 values for each ``[convolutional]`` in
order: biases; with ``batch_normalize`` also scales, rolling means and rolling variances; then the
kernel (out, in, height, width).
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.data.files import reading, replacing
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, Convolution, convolutions

WEIGHTS_VERSION = (0, 2, 5)
PARTIAL = re.compile(r"\.conv\.(\d{1,6})$")  # what ``darknet partial`` calls the first N layers


@dataclass(frozen=True)
class Weights:
    """The content of a ``.weights`` file: version, images seen in training, values (P,) float32."""

    version: tuple[int, int, int]
    images_seen: int
    values: NDArray[np.float32]


def layer_values(
    cfg: Cfg, weights: Weights
) -> Iterator[tuple[Convolution, NDArray[np.float32], NDArray[np.float32]]]:
    """Each convolution, its vectors (1 or 4, outputs) and its kernel (outputs, inputs * size²).

    The vectors are biases and, with batch normalisation, scales, means and variances.
    """
    start = 0
    for convolution in convolutions(cfg):
        part = weights.values[start : start + convolution.n_values]
        start += convolution.n_values
        n = convolution.outputs * (4 if convolution.batch_normalize else 1)
        vectors = part[:n].reshape(-1, convolution.outputs)
        yield convolution, vectors, part[n:].reshape(convolution.outputs, -1)


def read_weights(path: Path, cfg: Cfg) -> Weights:
    """Read a ``.weights`` file for the network `cfg`, every byte of it.

    Raises DroptrackError when the file is absent, ends too early (naming the layer at which it ran
    out), is too long, or holds numbers that are not finite.
    """
    refuse_partial(path)
    return _read(path, cfg, len(cfg.layers))


def refuse_partial(path: Path) -> None:
    """Raise DroptrackError for a file of the first layers only, by its name."""
    if partial := PARTIAL.search(path.name):
        raise DroptrackError(
            f"{path}: has the first {partial[1]} layers only: a training can start from it, but it "
            "finds nothing yet"
        )


def read_start(path: Path, cfg: Cfg) -> Weights:
    """Weights that a training starts from, which may be those of the first layers only.

    The name of such a file ends with their number, as in ``yolov3-tiny.conv.15``; Darknet reads no
    further. Raises DroptrackError as `read_weights` does.
    """
    partial = PARTIAL.search(path.name)
    return _read(path, cfg, int(partial[1]) if partial else len(cfg.layers))


def _read(path: Path, cfg: Cfg, n_layers: int) -> Weights:
    """The values of the convolutions among the first layers, which should be the whole file."""
    with reading(path, "Darknet weights"):
        data = path.read_bytes()
    if len(data) < 16:
        raise DroptrackError(f"{path}: {len(data)} bytes are too few for a Darknet .weights file")
    major, minor, revision = struct.unpack_from("<3i", data)
    wide = major * 10 + minor >= 2
    if not (0 <= major < 1000 and 0 <= minor < 1000):
        raise DroptrackError(f"{path}: version {major}.{minor} is absurd: not a .weights file?")
    (images_seen,) = struct.unpack_from("<Q" if wide else "<I", data, 12)
    start = 20 if wide else 16
    here = [one for one in convolutions(cfg) if one.layer < n_layers]
    wanted = sum(convolution.n_values for convolution in here)
    present, odd = divmod(len(data) - start, 4)
    if present != wanted or odd:
        raise DroptrackError(f"{path}: does not fit {cfg.path}: {_misfit(cfg, present, wanted)}")
    values = np.frombuffer(data, "<f4", wanted, start)
    if not np.isfinite(values).all():
        raise DroptrackError(f"{path}: holds NaN or infinite values: a training that diverged?")
    return Weights((major, minor, revision), images_seen, values)


def _misfit(cfg: Cfg, present: int, wanted: int) -> str:
    if present > wanted:
        return f"it has {present:,} values, the network {wanted:,}: weights of another network"
    end = 0
    for number, convolution in enumerate(convolutions(cfg), start=1):  # noqa: B007
        end += convolution.n_values
        if present < end:
            break
    line = cfg.layers[convolution.layer].line
    return (
        f"it ends after {present:,} of {wanted:,} values, within convolution {number} "
        f"(line {line}): cut off, or weights of another network"
    )


def weights_bytes(weights: Weights) -> bytes:
    """The content of a ``.weights`` file of version 0.2 or later."""
    header = struct.pack("<3iQ", *WEIGHTS_VERSION, weights.images_seen)
    return header + weights.values.astype("<f4").tobytes()


def write_weights(path: Path, weights: Weights) -> None:
    """Write a ``.weights`` file, whole or not at all."""
    with replacing(path) as partial:
        partial.write_bytes(weights_bytes(weights))
