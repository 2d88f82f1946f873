"""Post-training channel pruning: the channels of a layer that the others can stand in for.

After He, Zhang and Sun 2017 (Channel Pruning for Accelerating Very Deep Neural Networks): of a
convolution whose only reader is a 1 x 1 convolution, channels are left out and the reader's kernel
is fitted anew by least squares, so that it computes what it did from all of them. Channels are
chosen one after the other, each the one that explains most of what is not yet explained.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from droptrack.darknet_files import Cfg, Layer, Weights, layer_values, route_sources

Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]
Rows = NDArray[np.int64]

STEP = 32  # channels that are left are a multiple, as processors like it
RIDGE = 1e-6  # of the mean variance, added to each: channels that say the same leave it undecided


@dataclass(frozen=True, eq=False)
class Reduction:
    """What is left of the convolution `layer`, and what its reader, the next layer, becomes."""

    layer: int
    kept: Rows  # (K,) channels, ascending
    kernel: Float32s  # (outputs, K) of the reader
    shift: Float32s  # (outputs,) added to what the reader's convolution gives


class Moments:
    """Means (C,) and covariances (C, C) of the channels of a layer's output, over pictures."""

    def __init__(self) -> None:
        self._n = 0
        self._sum: Floats | float = 0.0
        self._products: Floats | float = 0.0

    def add(self, output: Float32s) -> None:
        """Take the output (B, C, H, W) for some pictures."""
        values = np.moveaxis(output, 1, 0).reshape(output.shape[1], -1).astype(np.float64)
        self._n += values.shape[1]
        self._sum = self._sum + values.sum(axis=1)
        self._products = self._products + values @ values.T

    @property
    def mean(self) -> Floats:
        """Means (C,)."""
        return np.asarray(self._sum / self._n)

    @property
    def covariance(self) -> Floats:
        """Covariances (C, C)."""
        return np.asarray(self._products / self._n - np.outer(self.mean, self.mean))


def prunable_layers(cfg: Cfg) -> list[int]:
    """Convolutions whose output is read by one 1 x 1 convolution, the next layer, only."""
    read_elsewhere = {
        source
        for index, layer in enumerate(cfg.layers)
        if layer.kind in ("route", "shortcut")
        for source in route_sources(layer, index, "layers" if layer.kind == "route" else "from")
    }
    return [
        index
        for index, (layer, reader) in enumerate(zip(cfg.layers, cfg.layers[1:], strict=False))
        if layer.kind == reader.kind == "convolutional"
        and index not in read_elsewhere
        and reader.integer("size", 1) == reader.integer("stride", 1) == 1
        and layer.integer("groups", 1) == reader.integer("groups", 1) == 1
    ]


def reductions(
    cfg: Cfg, weights: Weights, moments: Mapping[int, Moments], error: float
) -> list[Reduction]:
    """Leave out channels of the layers in `moments`, as many as an error allows.

    `error`: mean square of the change of what the readers compute, before normalisation, over its
    variance. Layers that would keep all their channels are left as they are.
    """
    found = []
    kernels = {convolution.layer: kernel for convolution, _, kernel in layer_values(cfg, weights)}
    for layer, moment in moments.items():
        kernel = kernels[layer + 1].astype(np.float64)
        kept, fitted = fit(moment.covariance, kernel, error)
        if len(kept) == kernel.shape[1]:
            continue
        shift = kernel @ moment.mean - fitted @ moment.mean[kept]
        found.append(Reduction(layer, kept, fitted.astype(np.float32), shift.astype(np.float32)))
    return found


def fit(covariance: Floats, kernel: Floats, error: float) -> tuple[Rows, Floats]:
    """The fewest channels (K,), chosen greedily, and a kernel (O, K) for them.

    That of `kernel` (O, C) over all channels of `covariance` (C, C) is met but for `error` of its
    variance. Each choice is a step of a Cholesky decomposition with pivots.
    """
    unexplained = covariance @ kernel.T  # of outputs, by each channel
    total = float(np.einsum("oc,co->", kernel, unexplained))
    variances = covariance.diagonal().copy()
    least = 1e-7 * variances
    factor = np.zeros((len(kernel.T), 0))
    chosen: list[int] = []
    rest = total
    while len(chosen) < len(variances) and (rest > error * total or len(chosen) % STEP):
        usable = variances > least
        usable[chosen] = False
        if not usable.any():
            break
        gain = (unexplained**2).sum(axis=1) / np.where(usable, variances, np.inf)
        best = int(gain.argmax())
        column = (covariance[:, best] - factor @ factor[best]) / np.sqrt(variances[best])
        share = unexplained[best] / np.sqrt(variances[best])
        unexplained = unexplained - np.outer(column, share)
        variances = np.maximum(variances - column**2, 0)
        factor = np.column_stack([factor, column])
        chosen.append(best)
        rest -= float(share @ share)
    kept = np.sort(np.array(chosen, np.int64))
    among = covariance[np.ix_(kept, kept)]
    among += RIDGE * among.diagonal().mean() * np.eye(len(kept))
    fitted = np.linalg.solve(among, covariance[kept] @ kernel.T)
    return kept, np.asarray(fitted.T, np.float64)


def pruned(cfg: Cfg, weights: Weights, changes: Iterable[Reduction]) -> tuple[Cfg, Weights]:
    """The smaller network, with the same layers."""
    by_layer = {change.layer: change for change in changes}
    parts: list[NDArray[np.float32]] = []
    for convolution, vectors, kernel in layer_values(cfg, weights):
        if change := by_layer.get(convolution.layer):
            parts += [vectors[:, change.kept].ravel(), kernel[change.kept].ravel()]
        elif change := by_layer.get(convolution.layer - 1):
            shifted = vectors.copy()
            if convolution.batch_normalize:
                shifted[2] -= change.shift  # the mean that is subtracted
            else:
                shifted[0] += change.shift
            parts += [shifted.ravel(), change.kernel.ravel()]
        else:
            parts += [vectors.ravel(), kernel.ravel()]
    layers = tuple(
        Layer(layer.kind, {**layer.options, "filters": str(len(by_layer[i].kept))}, layer.line)
        if i in by_layer
        else layer
        for i, layer in enumerate(cfg.layers)
    )
    values = np.concatenate(parts).astype(np.float32)
    return Cfg(cfg.path, cfg.net, layers), Weights(weights.version, weights.seen, values)
