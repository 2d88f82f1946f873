"""What an adaptation is told."""

from dataclasses import dataclass, field
from pathlib import Path

from droptrack.data.video import ReadOptions
from droptrack.pipeline.config import DetectorConfig

ITERATIONS = 500
BATCH = 16
LEARNING_RATE = 5e-4


@dataclass(frozen=True, kw_only=True)
class AdaptationConfig(DetectorConfig):
    """How to adapt a network to a video.

    `video`: a file, or a folder of images, which may be unrelated; `reading`: how it is read.
    `labels`: a folder of images with Darknet's label files beside them, which count most. `out`:
    the folder for everything. `resume`: an adaptation that was ended too early. The rest: how long
    and how to train. `weights` and `cfg` are what it starts from; by default, the bundled model for
    footage.
    """

    video: str
    out: Path
    labels: Path | None = None
    reading: ReadOptions = field(default_factory=ReadOptions)
    iterations: int = ITERATIONS
    batch: int = BATCH
    learning_rate: float = LEARNING_RATE
    seed: int = 0
    resume: bool = False
