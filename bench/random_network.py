"""Random weights, for measuring speed and for comparing one engine with another."""

import numpy as np

from droptrack.network.darknet_cfg import Cfg, convolutions
from droptrack.network.darknet_weights import WEIGHTS_VERSION, Weights


def random_weights(cfg: Cfg, rng: np.random.Generator) -> Weights:
    """Values whose layers roughly keep the size of their input, so that an error shows."""
    gain = 0.8 if any(layer.kind == "shortcut" for layer in cfg.layers) else 2.0
    parts = []
    for shape in convolutions(cfg):
        n, fan_in = shape.outputs, shape.inputs * shape.size**2
        parts.append(rng.normal(0, 0.1, n))  # biases
        if shape.batch_normalize:
            scales, means = rng.uniform(0.7, 1.3, n), rng.normal(0, 0.1, n)
            parts += [scales, means, rng.uniform(0.5, 1.5, n)]
        parts.append(rng.normal(0, np.sqrt(gain / fan_in), n * fan_in))
    return Weights(WEIGHTS_VERSION, 0, np.concatenate(parts).astype(np.float32))
