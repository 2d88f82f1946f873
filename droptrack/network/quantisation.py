"""Post-training quantisation: the range of every layer's output, measured, checked and kept.

A calibration is a small file beside the weights, valid for these weights (their sha256) at one
input size, or at any. It has the pruning of the network (`pruning`), for 8 bits and for whatever a
CPU computes in by `--precision auto`, the ranges, and what both cost in mAP.
"""

import functools
import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.files import reading, replacing, user_cache
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, route_sources
from droptrack.network.pruning import Pruning, Reconstruction

Range = tuple[float, float]  # of a layer's output: what is beyond it is clipped

MAX_LOSS = 0.002  # of mAP against fp32: 0.2 points
# the maximum step of a quantised kernel. A CPU without VNNI adds two products of bytes in 16 bits,
# which overflow beyond 2 * 255 * 64
KERNEL_MAX, UNSATURATED_MAX = 127, 64


@dataclass(frozen=True)
class Quantisation:
    """How a network is quantised to 8 bits.

    `ranges`: by the index of the layers whose outputs are quantised, as all kernels are.
    `kernel_max`: the maximum step of a kernel, KERNEL_MAX or UNSATURATED_MAX. `pool_bytes`: compute
    the first pools as `onnx_pools` does, for OpenVINO.
    """

    ranges: Mapping[int, Range]
    kernel_max: int = KERNEL_MAX
    pool_bytes: bool = False


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What int8 needs to know of a network; ranges by the layer's index.

    `width` and `height` of the input it holds for; 0 and 0: for any, and the mAPs are means over
    the sizes it was checked at.
    """

    weights_sha256: str
    width: int
    height: int
    ranges: Mapping[int, Range]
    n_calibrated: int  # images that the ranges come from
    n_checked: int  # images that the mAPs come from
    map_fp32: tuple[float, float]  # of all channels: on images as they are, and degraded
    map_int8: tuple[float, float]
    pruning: Pruning

    @property
    def losses(self) -> tuple[float, float]:
        """What int8 costs in mAP, on images as they are and degraded."""
        (fp32, fp32_degraded), (int8, int8_degraded) = self.map_fp32, self.map_int8
        return fp32 - int8, fp32_degraded - int8_degraded

    def digest(self) -> str:
        """What tells it from others, in hexadecimal digits."""
        digest = hashlib.sha256()
        for name, array in sorted(_to_arrays(self).items()):
            digest.update(f"{name} {array.dtype} {array.shape} ".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


def sha256_of(path: Path) -> str:
    """The sha256 of a file, in hexadecimal digits; read once unless the file changes.

    Raises DroptrackError where it cannot be read.
    """
    with reading(path, "a file"):
        stat = path.stat()
        return _sha256(path, stat.st_size, stat.st_mtime_ns, stat.st_ino)


@functools.lru_cache(maxsize=64)
def _sha256(path: Path, *_: int) -> str:
    """The sha256 of a file; its size, time and number tell whether it is the same still."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def quantised_layers(cfg: Cfg) -> list[int]:
    """Layers whose outputs are to be quantised: those that compute.

    Except for the maps of the heads, and for what a shortcut adds: the sum is quantised.
    """
    kinds = [layer.kind for layer in cfg.layers]
    return [
        index
        for index, (kind, following) in enumerate(zip(kinds, [*kinds[1:], ""], strict=True))
        if kind == "shortcut" or (kind == "convolutional" and following not in ("yolo", "shortcut"))
    ]


def least_error_range(counts: Floats, limits: Range) -> Range:
    """The range in which 8 bits have the least mean square error, what is beyond it included.

    `counts` (N,) of a layer's outputs in N bins of equal width between `limits`. Rare large values
    would make the steps of all others coarse. After Nagel et al. 2021 (A White Paper on Neural
    Network Quantization), section 3.1.

    >>> counts = np.zeros(1000)
    >>> counts[:100], counts[-1] = 1e6, 1  # one in 100 million is ten times as large as the others
    >>> [round(limit) for limit in least_error_range(counts, (0.0, 1000.0))]
    [0, 100]
    """
    edges = np.linspace(*limits, len(counts) + 1)
    values = (edges[1:] + edges[:-1]) / 2
    share = counts / counts.sum()

    def error(candidate: Range) -> float:
        low, high = candidate
        step = (high - low) / 255
        shown = np.clip(np.round((values - low) / step), 0, 255) * step + low
        return float(share @ (shown - values) ** 2)

    lows = {float(min(0.0, limits[0]) * part) for part in np.linspace(0.0, 1, 41)}
    highs = [float(max(1e-6, limits[1]) * part) for part in np.linspace(0.05, 1, 58)]
    return min(((low, high) for high in highs for low in sorted(lows)), key=error)


def merge_ranges(cfg: Cfg, ranges: Mapping[int, Range]) -> dict[int, Range]:
    """Ranges in which layers that a ``[route]`` concatenates have one in common.

    Only maps with one scale can be concatenated in 8 bits without being computed again.
    """
    group = {layer: {layer} for layer in ranges}
    for index, layer in enumerate(cfg.layers):
        if layer.kind == "route":
            members: set[int] = set()
            for source in route_sources(layer, index):
                origins = _origins(cfg, source) & group.keys()
                members |= set().union(*(group[origin] for origin in origins))
            for member in members:
                group[member] = members
    return {
        layer: (min(ranges[m][0] for m in group[layer]), max(ranges[m][1] for m in group[layer]))
        for layer in ranges
    }


def _origins(cfg: Cfg, index: int) -> set[int]:
    """The layers that compute the values which a layer passes on."""
    layer = cfg.layers[index]
    if layer.kind == "route":
        return set().union(*(_origins(cfg, source) for source in route_sources(layer, index)))
    if layer.kind in ("maxpool", "upsample"):
        return _origins(cfg, index - 1)
    return {index}


def find_calibration(weights: Path, cfg: Cfg) -> Calibration | None:
    """The calibration of weights for the cfg's input size, or else for any, if one fits them.

    Raises DroptrackError for a file that is damaged.
    """
    digest = sha256_of(weights)
    size = f"-{cfg.width}x{cfg.height}"
    for path in (*_places(weights, digest, size), *_places(weights, digest, "")):
        try:
            with path.open("rb") as file, np.load(file) as arrays:
                calibration = _from_arrays(dict(arrays))
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            raise DroptrackError(f"{path}: cannot be read: {error}; delete it") from None
        except (TypeError, KeyError, ValueError, AttributeError, zipfile.BadZipFile):
            raise DroptrackError(f"{path}: is no calibration; delete it") from None
        layers = set(calibration.ranges)
        if calibration.weights_sha256 == digest and layers == set(quantised_layers(cfg)):
            return calibration
    return None


def write_calibration(weights: Path, calibration: Calibration) -> Path:
    """Keep a calibration beside the weights, or in the user's cache where that is not writable.

    Returns the file. Raises DroptrackError if int8 costs more than MAX_LOSS on images as they
    are, or where nothing is writable.
    """
    if not calibration.losses[0] <= MAX_LOSS:
        raise DroptrackError(
            f"{weights}: int8 is refused: mAP falls from {calibration.map_fp32[0]:.4f} to "
            f"{calibration.map_int8[0]:.4f} on {calibration.n_checked} images, by more than "
            f"{MAX_LOSS}; use bf16, or calibrate on more images"
        )
    arrays = _to_arrays(calibration)
    size = f"-{calibration.width}x{calibration.height}" if calibration.width else ""
    for path in _places(weights, calibration.weights_sha256, size):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as partial:
                np.savez(partial, **arrays)
        except OSError:
            continue
        return path
    raise DroptrackError(f"{weights}: neither its folder nor the user's cache is writable")


def _to_arrays(calibration: Calibration) -> dict[str, Any]:
    """A calibration as its file has it: the arrays, and the rest as JSON."""
    about = {key: value for key, value in vars(calibration).items() if key != "pruning"}
    arrays: dict[str, Any] = {"about": np.array(json.dumps(about))}
    for layer, rows in calibration.pruning.kept.items():
        arrays[f"kept_{layer}"] = rows
    for layer, reconstruction in calibration.pruning.reconstructions.items():
        arrays[f"mix_{layer}"] = reconstruction.mix
        arrays[f"offset_{layer}"] = reconstruction.offset
    return arrays


def _from_arrays(arrays: dict[str, Any]) -> Calibration:
    def layers(prefix: str) -> list[int]:
        return [int(name.removeprefix(prefix)) for name in arrays if name.startswith(prefix)]

    about = json.loads(str(arrays["about"]))
    ranges = {int(layer): (float(a), float(b)) for layer, (a, b) in about["ranges"].items()}
    pruning = Pruning(
        {i: arrays[f"kept_{i}"] for i in layers("kept_")},
        {i: Reconstruction(arrays[f"mix_{i}"], arrays[f"offset_{i}"]) for i in layers("mix_")},
    )
    maps = {key: tuple(about[key]) for key in ("map_fp32", "map_int8")}
    return Calibration(**{**about, **maps, "ranges": ranges, "pruning": pruning})


def _places(weights: Path, digest: str, size: str) -> tuple[Path, Path]:
    beside = weights.with_name(f"{weights.stem}-int8{size}.npz")
    return beside, user_cache() / f"{digest}-int8{size}.npz"
