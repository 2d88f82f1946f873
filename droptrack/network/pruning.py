"""Post-training channel pruning: channels of a layer that can be computed from the others.

After He, Zhang and Sun 2017 (Channel Pruning for Accelerating Very Deep Neural Networks): channels
of a convolution are pruned, and the convolutions that read it compute with their reconstruction
from the others, by least squares. Channels to keep are chosen one after the other, each the one
that explains most of what its readers compute and is not yet explained.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Bools, Float32s, Floats, Rows
from droptrack.network.darknet_cfg import Cfg, Convolution, Layer, layer_shapes, route_sources
from droptrack.network.darknet_weights import Weights, layer_values

Float16s = NDArray[np.float16]

STEP = 16  # the number of kept channels is a multiple of it, which processors compute faster
RIDGE = 1e-6  # of the mean variance, added to each: without, equal channels have no unique solution
# how much larger an error other readers than heads may have: docs/performance.md
BETWEEN = 15.0
MIN_VARIANCE = 1e-7  # of a channel's variance: where less of it is unexplained, none is


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Of D pruned channels from the K kept ones (..., K): kept @ mix + offset."""

    mix: Float16s  # (K, D)
    offset: Float32s  # (D,)


@dataclass(frozen=True)
class Pruning:
    """Which channels of a network's convolutions are kept, and what replaces the others."""

    kept: Mapping[int, Rows]  # channels, ascending, by the layer that computes them
    reconstructions: Mapping[int, Reconstruction]  # by the layer that reads


NO_PRUNING = Pruning({}, {})


class Moments:
    """Second moments (C, C) of the channels of what a convolution reads, over images.

    About the means (C,) with `centred`. Otherwise about 0, which a convolution with a border of
    zeros needs: there, zeros are reconstructed as zeros.
    """

    def __init__(self, *, centred: bool) -> None:
        self._centred = centred
        self._n = 0
        self._sum: Floats | float = 0.0
        self._products: Floats | float = 0.0

    def add(self, values: Float32s) -> None:
        """Count what is read (B, C, H, W) for some images."""
        flat = np.moveaxis(values, 1, 0).reshape(values.shape[1], -1)
        self._n += flat.shape[1]
        self._sum = self._sum + flat.sum(axis=1, dtype=np.float64)
        self._products = self._products + (flat @ flat.T).astype(np.float64)

    @property
    def mean(self) -> Floats:
        """Means (C,), or zeros."""
        return np.asarray(self._sum / self._n * self._centred)

    @property
    def second(self) -> Floats:
        """Second moments (C, C)."""
        return np.asarray(self._products / self._n - np.outer(self.mean, self.mean))


def prunable_layers(cfg: Cfg) -> list[int]:
    """Convolutions whose channels only convolutions read: no heads, no sums, no parts of layers."""
    read, fixed = set(), set()
    for index, layer in enumerate(cfg.layers):
        before = set(_layers_passed_on(cfg, index - 1)) if index else set()
        grouped = layer.integer("groups", 1) > 1
        if layer.kind == "convolutional" and not grouped:
            read |= before
        elif layer.kind == "convolutional":
            fixed |= {index, *before}
        elif layer.kind == "yolo":
            fixed |= before
        elif layer.kind == "shortcut":
            added = route_sources(layer, index)
            fixed |= before.union(*(_layers_passed_on(cfg, i) for i in added))
        elif layer.kind == "route" and grouped:
            fixed |= set().union(*(_layers_passed_on(cfg, i) for i in route_sources(layer, index)))
    return sorted(i for i in read - fixed if cfg.layers[i].kind == "convolutional")


def readers(cfg: Cfg) -> dict[int, list[int]]:
    """Convolutions that read prunable layers, and the layers whose channels they read, in order."""
    prunable = set(prunable_layers(cfg))
    inputs = {
        index: _layers_passed_on(cfg, index - 1)
        for index, layer in enumerate(cfg.layers)
        if index and layer.kind == "convolutional"
    }
    return {reader: sources for reader, sources in inputs.items() if prunable & set(sources)}


def _layers_passed_on(cfg: Cfg, index: int) -> list[int]:
    """The layers whose channels, one after the other, a layer passes on."""
    layer = cfg.layers[index]
    if layer.kind in ("maxpool", "upsample"):
        return _layers_passed_on(cfg, index - 1)
    if layer.kind == "route" and layer.integer("groups", 1) == 1:
        return [i for source in route_sources(layer, index) for i in _layers_passed_on(cfg, source)]
    return [index]


def choose_pruning(
    cfg: Cfg,
    kernels: Mapping[int, Float32s],
    moments: Mapping[int, Moments],
    error: float,
    filters: Mapping[int, int] | None = None,
) -> Pruning:
    """Prune as many channels as an error allows; or to as many `filters` as given, by layer.

    `kernels` (outputs, inputs, h, w) of the convolutions, with their normalisation, and `moments`
    of what each of the `readers` reads, by layer. `error`: mean square of the change of what a head
    computes, over its mean square; for other readers it may be BETWEEN times as much.
    """
    kinds = [layer.kind for layer in cfg.layers]
    channels = [channels for channels, _ in layer_shapes(cfg)]
    unexplained: dict[int, list[_Unexplained]] = {layer: [] for layer in prunable_layers(cfg)}
    for reader, sources in readers(cfg).items():
        second, kernel = moments[reader].second, kernels[reader].astype(np.float64)
        metric = np.einsum("octu,odtu->cd", kernel, kernel, optimize=True)
        allowed = float((metric * second).sum()) * error
        if kinds[reader + 1 :][:1] != ["yolo"]:
            allowed *= BETWEEN
        start = 0
        for source in sources:
            own = slice(start, start + channels[source])
            start = own.stop
            if source in unexplained:
                part = _Unexplained(second[own, own], metric[own, own], allowed)
                unexplained[source].append(part)
    if filters is None:
        chosen = {layer: choose_channels(parts) for layer, parts in unexplained.items()}
    else:
        chosen = {layer: choose_channels(unexplained[layer], n) for layer, n in filters.items()}
    kept = {layer: rows for layer, rows in chosen.items() if len(rows) < channels[layer]}
    reconstructions = {}
    for reader, sources in readers(cfg).items():
        if kept.keys() & sources:
            among = _kept_inputs(cfg, kept, sources)
            reconstructions[reader] = fit(moments[reader], among)
    return Pruning(kept, reconstructions)


class _Unexplained:
    """What a reader computes from C channels, as far as those chosen do not explain it.

    Each choice is a step of a Cholesky decomposition with pivots of the second moments (C, C);
    `metric` (C, C) is the reader's kernelᵀ kernel, and `allowed` what may stay unexplained.
    """

    def __init__(self, second: Floats, metric: Floats, allowed: float) -> None:
        values, vectors = np.linalg.eigh(metric)
        root = vectors * np.sqrt(np.maximum(values, 0))
        self._second, self._by_channel = second, second @ root
        self._variances = second.diagonal().copy()
        self._min_variances = MIN_VARIANCE * self._variances
        self._factor = np.zeros((len(second), 0))
        self._rest = float((metric * second).sum())
        self._allowed = max(allowed, np.finfo(float).tiny)

    @property
    def share(self) -> float:
        """What is unexplained, over what is allowed."""
        return self._rest / self._allowed

    def gains(self) -> Floats:
        """How much less `share` would be with each channel (C,); 0 for what nothing is left of."""
        usable = self._variances > self._min_variances
        gains = (self._by_channel**2).sum(axis=1) / np.where(usable, self._variances, np.inf)
        return np.asarray(gains / self._allowed)

    def take(self, channel: int) -> None:
        """Explain by one more channel."""
        if self._variances[channel] <= self._min_variances[channel]:
            return
        scale = np.sqrt(self._variances[channel])
        column = (self._second[:, channel] - self._factor @ self._factor[channel]) / scale
        explained = self._by_channel[channel] / scale
        self._by_channel = self._by_channel - np.outer(column, explained)
        self._variances = np.maximum(self._variances - column**2, 0)
        self._factor = np.column_stack([self._factor, column])
        self._rest -= float(explained @ explained)


def choose_channels(parts: Sequence[_Unexplained], n: int | None = None) -> Rows:
    """Few channels (K,), ascending, that explain enough to all readers, or `n`; chosen greedily."""
    chosen: list[int] = []

    def enough() -> bool:
        if n is not None:
            return len(chosen) == n
        return bool(chosen) and not len(chosen) % STEP and max(p.share for p in parts) <= 1

    while not enough():
        gains = np.sum([part.gains() for part in parts], axis=0)
        gains[chosen] = -1
        best = int(gains.argmax())
        if gains[best] < 0:
            break  # all are chosen
        for part in parts:
            part.take(best)
        chosen.append(best)
    return np.sort(np.array(chosen, np.int64))


def fit(moments: Moments, kept: Bools) -> Reconstruction:
    """The least squares estimate of the channels (C,) that are not kept from those that are."""
    second, mean = moments.second, moments.mean
    among = second[np.ix_(kept, kept)]
    among += RIDGE * among.diagonal().mean() * np.eye(len(among))
    mix = np.linalg.solve(among, second[np.ix_(kept, ~kept)]).astype(np.float16)
    return Reconstruction(mix, (mean[~kept] - mean[kept] @ mix).astype(np.float32))


def _kept_inputs(cfg: Cfg, kept: Mapping[int, Rows], sources: Iterable[int]) -> Bools:
    """Which channels (C,) are kept of what a convolution reads."""
    shapes = layer_shapes(cfg)
    return np.concatenate(
        [
            np.isin(np.arange(shapes[i][0]), kept[i]) if i in kept else np.ones(shapes[i][0], bool)
            for i in sources
        ]
    )


def pruned(cfg: Cfg, weights: Weights, pruning: Pruning) -> tuple[Cfg, Weights]:
    """The smaller network, with the same layers."""
    sources = readers(cfg)
    parts: list[Float32s] = []
    for convolution, vectors, flat in layer_values(cfg, weights):
        layer = convolution.layer
        parameters, kernel = vectors, flat.reshape(convolution.outputs, convolution.inputs, -1)
        if reconstruction := pruning.reconstructions.get(layer):
            among = _kept_inputs(cfg, pruning.kept, sources[layer])
            parameters, kernel = _reading(convolution, vectors, kernel, among, reconstruction)
        own = pruning.kept.get(layer, slice(None))
        parts += [parameters[:, own].ravel(), kernel[own].ravel()]
    layers = tuple(
        Layer(layer.kind, {**layer.options, "filters": str(len(pruning.kept[i]))}, layer.line)
        if i in pruning.kept
        else layer
        for i, layer in enumerate(cfg.layers)
    )
    values = np.concatenate(parts).astype(np.float32)
    return Cfg(cfg.path, cfg.net, layers), Weights(weights.version, weights.images_seen, values)


def _reading(
    convolution: Convolution,
    vectors: Float32s,
    kernel: Float32s,
    kept: Bools,
    reconstruction: Reconstruction,
) -> tuple[Float32s, Float32s]:
    """Vectors and kernel (outputs, K, size²) of a convolution that reads only the kept channels.

    `vectors` as of `layer_values`, `kernel` (outputs, C, size²), `kept` (C,).
    """
    removed = kernel[:, ~kept]
    mix = reconstruction.mix.astype(np.float32)
    kernel = kernel[:, kept] + np.einsum("odt,kd->okt", removed, mix, optimize=True)
    vectors = vectors.copy()
    shift = removed.sum(axis=2) @ reconstruction.offset
    if convolution.batch_normalize:
        vectors[2] -= shift  # the mean that is subtracted
    else:
        vectors[0] += shift
    return vectors, kernel
