"""A network with two classes, made of the bundled one: what either of its heads finds is one."""

from pathlib import Path

import numpy as np

from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import read_cfg
from droptrack.network.darknet_weights import Weights, layer_values, read_weights, write_weights

NEVER = -12.0  # logit of a class that is not
SMALL, LARGE = 0, 1  # the head for up to 54 px of the input, and the one from 80 px on


def write_two_classes(folder: Path) -> Path:
    """Write two.cfg, two.weights and two.names (small, large) to a folder; returns the weights."""
    cfg = read_cfg(find_cfg(BUNDLED_WEIGHTS))
    text = (
        cfg.path.read_text().replace("classes=1", "classes=2").replace("filters=18", "filters=21")
    )
    (folder / "two.cfg").write_text(text)
    (folder / "two.names").write_text("small\nlarge\n")
    old = read_weights(BUNDLED_WEIGHTS, cfg)
    heads = iter((LARGE, SMALL))
    values = []
    for convolution, vectors, kernel in layer_values(cfg, old):
        if not convolution.batch_normalize:
            one = np.hstack([vectors.T, kernel]).reshape(3, 6, -1)  # of three anchors
            none = np.zeros_like(one[:, :1])
            none[..., 0] = NEVER
            both = (one[:, 5:], none) if next(heads) == SMALL else (none, one[:, 5:])
            two = np.concatenate([one[:, :5], *both], axis=1).reshape(21, -1)
            values += [two[:, 0], two[:, 1:].ravel()]
        else:
            values += [vectors.ravel(), kernel.ravel()]
    new = Weights(old.version, old.images_seen, np.concatenate(values))
    write_weights(folder / "two.weights", new)
    return folder / "two.weights"
