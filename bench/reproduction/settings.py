"""How large a reproduction is: the paper's size, or a small one."""

from dataclasses import dataclass
from typing import Literal

Size = Literal["small", "paper"]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How a network is trained where no trained one is at hand; 0 iterations: it is not."""

    cfg: str  # of darknet_cfg
    draw: str  # the scenes it learns
    iterations: int
    batch: int = 16
    window: tuple[int, int] | None = None
    sizes: tuple[float, float] | None = None
    map_every: int = 500
    map_images: int = 200

    def command(self) -> str:
        """The command line that trains the same, without its data set and folder."""
        words = [
            f"python -m droptrack.train --trainer torch --cfg darknet_cfg/{self.cfg}.cfg",
            "--optimizer adamw --learning-rate 0.001",
            f"--batch {self.batch} --subdivisions 1",
            f"--iterations {self.iterations} --draw {self.draw}",
        ]
        if self.window:
            words.append(f"--window {self.window[0]}x{self.window[1]}")
        if self.sizes:
            words.append(f"--sizes {self.sizes[0]:g},{self.sizes[1]:g}")
        return " ".join(words)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything that decides the numbers of a reproduction, but for the machine."""

    scale: str
    images: int  # of each data set, to train on
    valid: int  # of each, to measure the mAP on
    tiny: Recipe
    full: Recipe
    sine_frames: int = 200
    cores: int = 4
    shear_steps: int = 80_000
    shear_every: int = 500
    constriction: Size = "small"
    droplets: int = 19
    constriction_steps: int = 40_000
    degraded: bool = True  # whether the videos are tracked degraded, too
    alternatives: bool = True  # whether what one would pick instead is tried
    speed_frames: int = 200
    speed_frames_full: int = 20  # 0: the full network is not timed
    seed: int = 0


SMALL = Settings(
    scale="small",
    images=100,
    valid=100,
    sine_frames=100,  # trackpy's locator takes seconds for each
    tiny=Recipe(
        cfg="yolov3-tiny",
        draw="tiny",
        iterations=200,
        window=(224, 224),
        map_every=100,
        map_images=50,
    ),
    full=Recipe(cfg="yolov3-droplets", draw="full", iterations=0),
)
PAPER = Settings(
    scale="paper",
    images=10_000,
    valid=1_000,
    tiny=Recipe(cfg="yolov3-tiny", draw="tiny", iterations=3_400),
    full=Recipe(
        cfg="yolov3-droplets", draw="full", iterations=2_800, window=(224, 128), sizes=(0.8, 1.25)
    ),
    shear_steps=150_000,
    constriction="paper",
    droplets=49,
    constriction_steps=250_000,
    speed_frames_full=40,
)
SCALES = {"small": SMALL, "paper": PAPER}
