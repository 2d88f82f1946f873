"""The settings of the PyTorch trainer."""

from dataclasses import dataclass
from pathlib import Path

from droptrack.data.darknet_dataset import DataSet
from droptrack.network.darknet_cfg import Cfg
from droptrack.training.config import DrawImage


@dataclass(frozen=True, kw_only=True)
class TorchSettings:
    """How to train, beside what the ``.cfg`` says."""

    iterations: int  # batches in all
    batch: int  # images an iteration, over all devices
    subdivisions: int  # parts that a device's share of a batch is computed in
    optimizer: str  # "sgd": Darknet's, by the cfg; "adamw": fewer iterations, half a cosine
    learning_rate: float
    window: tuple[int, int] | None  # see Augmentation
    sizes: tuple[float, float] | None  # range of the factor on the network's size
    seed: int
    workers: int  # processes a device that prepare images
    save_every: int  # iterations between checkpoints
    map_every: int  # iterations between measurements of the mAP
    map_images: int  # validation images they use
    patience: int  # mAPs without a new best that end the training; 0: never
    devices: tuple[str, ...]  # one process each: ("cuda:0", "cuda:1")
    bf16: bool  # the network computes in bfloat16; weights, gradients and loss are float32
    frozen_statistics: bool = False  # batch normalisation keeps the statistics that it has
    droplets: tuple[float, float] | None = None  # see Augmentation
    negatives: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Job:
    """One training: a network, a data set, a run folder, and how to train.

    `start`: weights to begin from. With `resume`, the training resumes from the checkpoint in
    `out`. `draw` makes the training images instead of the data set.
    """

    cfg: Cfg
    data: DataSet
    out: Path
    settings: TorchSettings
    start: Path | None = None
    resume: bool = False
    draw: DrawImage | None = None

    def file(self, name: str) -> Path:
        """A file of the run, by the cfg's stem: ``yolov3_last.weights``."""
        return self.out / f"{self.cfg.path.stem}_{name}"
