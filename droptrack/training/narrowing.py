"""A narrower network with the same layers, to be trained on: pruned to the filters one wants."""

from collections.abc import Mapping
from pathlib import Path

from droptrack.data.darknet_dataset import DataSet
from droptrack.data.files import write_text
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, cfg_text
from droptrack.network.darknet_weights import read_weights, write_weights
from droptrack.network.pruning import Pruning, choose_pruning, prunable_layers, pruned
from droptrack.training.calibration import PRUNING_ERROR, calibration_frames, measure_moments


def parse_filters(text: str) -> dict[int, int]:
    """Numbers of filters by layer; raises DroptrackError for another text.

    >>> parse_filters("8=192, 12=384")
    {8: 192, 12: 384}
    """
    try:
        pairs = [part.split("=") for part in text.split(",")]
        return {int(layer): int(n) for layer, n in pairs}
    except ValueError:
        raise DroptrackError(
            f"--filters {text}: should be layers and numbers such as 8=192,12=384"
        ) from None


def narrow(
    data: DataSet,
    cfg: Cfg,
    weights: Path,
    out: Path,
    *,
    filters: Mapping[int, int] | None = None,
    images: int = 200,
    error: float = PRUNING_ERROR,
) -> tuple[Path, Pruning]:
    """Write a pruned network into the folder `out`: a ``.cfg``, and ``.weights`` of that name.

    Other layers compute with what is kept as well as they can, by least squares, as measured on the
    first `images` training images, as they are and degraded, half of them larger and smaller.
    `filters`: how many each layer has, by its number; without, as few as an `error` allows
    (`choose_pruning`). Returns the weights' path, and what is kept. Raises DroptrackError for
    layers that cannot be pruned, where there are files of these names, and where OpenVINO is not
    installed.
    """
    try:
        import droptrack.detection.engines.openvino  # noqa: F401, of an extra
        from droptrack.network.onnx_layers import folded_convolutions
    except ImportError:
        raise DroptrackError("narrowing needs: pip install 'droptrack[openvino]'") from None
    if filters is not None:
        _check(cfg, filters)
    written = out / f"{weights.stem}.weights"
    for path in (written, written.with_suffix(".cfg")):
        if path.exists():
            raise DroptrackError(f"{path}: is there already; choose another --out")
    values = read_weights(weights, cfg)
    kernels = {i: kernel for i, (kernel, _) in folded_convolutions(cfg, values).items()}
    frames = calibration_frames(data.train[:images], "channels", zoomed=True)
    moments = measure_moments(cfg, values, kernels, frames)
    pruning = choose_pruning(cfg, kernels, moments, error, filters)
    smaller, kept = pruned(cfg, values, pruning)
    out.mkdir(parents=True, exist_ok=True)
    write_text(written.with_suffix(".cfg"), cfg_text(smaller))
    write_weights(written, kept)
    return written, pruning


def _check(cfg: Cfg, filters: Mapping[int, int]) -> None:
    layers = prunable_layers(cfg)
    for layer, n in filters.items():
        if layer not in layers:
            names = ", ".join(map(str, layers))
            raise DroptrackError(f"--filters {layer}={n}: layers that can be pruned are {names}")
        there = cfg.layers[layer].integer("filters")
        if not 1 <= n <= there:
            raise DroptrackError(f"--filters {layer}={n}: layer {layer} has {there} filters")
