"""The settings of a training, whichever program trains."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from droptrack.data.arrays import Floats, Pixels

# makes an image (H, W, 3) uint8 BGR and the boxes (N, 4) px of the droplets in it
DrawImage = Callable[[np.random.Generator], tuple[Pixels, Floats]]
DEFAULT_WORKERS = min(8, max(1, (os.cpu_count() or 2) - 1))


class Trainer(StrEnum):
    """The program that trains."""

    darknet = "darknet"
    torch = "torch"
    auto = "auto"


class Optimizer(StrEnum):
    """The optimizer of the PyTorch trainer."""

    sgd = "sgd"
    adamw = "adamw"


class TrainingPrecision(StrEnum):
    """What the PyTorch trainer's network computes in."""

    bf16 = "bf16"
    fp32 = "fp32"


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """A network, a data set, a run folder, and how to train.

    0 and "" keep the value of the ``.cfg``, or the default of the trainer.

    `optimizer` and the fields after it are for the PyTorch trainer only.
    """

    cfg: Path
    data: Path  # obj.data
    out: Path  # the run folder
    trainer: Trainer = Trainer.auto
    darknet: Path | None = None  # see find_darknet
    weights: Path | None = None  # to start from
    resume: bool = False  # from the last snapshot in `out`
    iterations: int = 0
    batch: int = 0
    subdivisions: int = 0
    learning_rate: float = 0
    gpus: str = ""  # "0,1"
    save_every: int = 100  # iterations
    map_every: int = 500  # iterations, about
    map_images: int = 200  # validation images for a mAP that Darknet does not measure
    patience: int = 0  # mAPs without a new best that end the training; 0: never
    hang_minutes: float = 30  # of silence after which Darknet is stopped
    optimizer: Optimizer = Optimizer.sgd
    window: tuple[int, int] | None = None  # px, see Augmentation
    sizes: tuple[float, float] | None = None  # range of the factor on the input's size
    seed: int = 0
    draw: str = ""  # a scene, of which images are drawn instead of the data set's
    precision: TrainingPrecision = TrainingPrecision.bf16
    workers: int = DEFAULT_WORKERS  # processes a device that prepare images
    frozen_statistics: bool = False  # batch normalisation keeps the statistics that it has
    droplets: tuple[float, float] | None = None  # diameters px of the input; others have no label
    negatives: float = 0.0  # share of the images that are shown as their negatives

    def only_torch(self) -> list[str]:
        """The options given that only the PyTorch trainer has."""
        given = {
            "--optimizer adamw": self.optimizer is Optimizer.adamw,
            "--window": self.window is not None,
            "--sizes": self.sizes is not None,
            "--droplets": self.droplets is not None,
            "--negatives": self.negatives > 0,
            "--frozen-statistics": self.frozen_statistics,
            "--draw": bool(self.draw),
        }
        return [option for option, is_given in given.items() if is_given]
