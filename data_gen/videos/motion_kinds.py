"""The motions that are hard to track: how droplets move, and the faults of their detector.

Speeds are in droplet diameters per frame.
"""

from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum

import numpy as np

WIDTH, HEIGHT = 1200.0, 600.0  # of the image, px
PLUG_ASPECT, PLUG_DIAMETER = 2.0, 85.0
TRAIN_PLUGS = 18


@dataclass(frozen=True)
class Motion:
    """A kind of motion, the droplets that take part, and a detector's faults."""

    kind: str
    _: KW_ONLY
    speed: float = 0.3  # diameters per frame, at most
    droplets: int = 410  # in the image
    diameter: float = 20.0  # px
    frames: int = 100
    missing: float = 0.0  # share of droplets without a box, each frame
    false: float = 0.0  # share of boxes without a droplet
    jitter: float = 0.0  # standard deviation of a box's place and size, in diameters
    aspect: float = 1.0  # a box's width, in heights; both together have the diameter's square
    spacing: tuple[float, float] = (1.0, 1.0)  # of a train, in lengths: minimum and maximum
    lanes: int = 1  # channels side by side, in which trains go at different speeds
    images_missing: float = 0.0  # share of frames of which there is no image, and no box


class Kind(StrEnum):
    """What the droplets do; `filled` is a packing all over the image.

    A lattice without disorder has no answer but its edge, so packings have some.
    """

    sine = "sine"  # the paper's paths (Eq. D1)
    crossing = "crossing"  # two swarms through each other
    uniform = "uniform"
    shear = "shear"  # from rest at the top to full speed at the bottom
    channel = "channel"  # Poiseuille's parabola: droplets enter and leave
    vortices = "vortices"  # Taylor and Green's
    growing = "growing"  # a channel in which half of them double their size, half halve it
    packing = "packing"  # a dense hexagonal patch that moves by half a spacing per frame
    filled = "filled"
    merging = "merging"  # pairs that coalesce, and bystanders
    splitting = "splitting"  # droplets that break up, and bystanders
    train = "train"  # equal plugs one after the other in a channel, through the whole image
    pulsing = "pulsing"  # a train that nearly rests and goes on, again and again
    reversing = "reversing"  # a train that goes to and fro
    joining = "joining"  # trains of two channels that become one, twice as fast
    stopping = "stopping"  # a uniform flow in which some droplets stop at the wall below


def with_faults(motion: Motion) -> Motion:
    """With a detector's usual faults."""
    return replace(motion, missing=0.05, false=0.02, jitter=0.01)


def train(*, spacing: float, step: float, images_missing: float = 0.0) -> Motion:
    """Some twenty equal plugs that pass, with a detector's usual faults.

    `spacing` in lengths of a plug, `step` a frame in spacings.
    """
    length = float(np.sqrt(PLUG_ASPECT))  # diameters
    return Motion(
        Kind.train,
        speed=step * spacing * length,
        diameter=PLUG_DIAMETER,
        frames=round((TRAIN_PLUGS + WIDTH / (spacing * length * PLUG_DIAMETER)) / step),
        missing=0.05,
        false=0.02,
        jitter=0.01,
        aspect=PLUG_ASPECT,
        spacing=(spacing, spacing),
        images_missing=images_missing,
    )


IN_CHANNELS = (Kind.train, Kind.pulsing, Kind.reversing, Kind.joining)

SHORT_VIEW = Motion(
    Kind.train,
    speed=1.0,
    diameter=260.0,
    frames=80,
    jitter=0.01,
    aspect=2.0,
    spacing=(2.0, 3.0),
    lanes=2,
)
TRAINS = {
    f"train {spacing:g} {step:g}{' holes' if missing else ''}": train(
        spacing=spacing, step=step, images_missing=missing
    )
    for missing in (0.0, 0.3)
    for spacing in (1.1, 2.0, 4.0)
    for step in (0.05, 0.2, 0.45)
}
MOTIONS = {
    "sine": Motion(Kind.sine, droplets=12, frames=150),
    "crossing": Motion(Kind.crossing, droplets=80),
    **{f"uniform {u:g}": Motion(Kind.uniform, speed=u, frames=60) for u in (0.5, 1, 1.5, 2)},
    **{f"shear {u:g}": Motion(Kind.shear, speed=u, frames=60) for u in (0.5, 1, 1.5, 2)},
    "packing": Motion(Kind.packing, droplets=200, frames=60),
    "filled": Motion(Kind.filled, diameter=36, frames=60),
    **{f"missing {p:.0%}": Motion(Kind.vortices, missing=p) for p in (0.1, 0.2, 0.3)},
    **{f"false {p:.0%}": Motion(Kind.vortices, false=p) for p in (0.05, 0.1, 0.2)},
    **{f"jitter {p:.0%}": Motion(Kind.vortices, jitter=p) for p in (0.05, 0.1, 0.2)},
    "missing 10% false 5%": Motion(Kind.vortices, missing=0.1, false=0.05),
    "thousand": Motion(Kind.vortices, droplets=1080, diameter=14, frames=60),
    "growing": Motion(Kind.growing, speed=0.5),
    "entering and leaving": Motion(Kind.channel, speed=0.8),
    **TRAINS,
    "short views": SHORT_VIEW,
    "short views holes": replace(SHORT_VIEW, images_missing=1 / 3),
    "pulsing": with_faults(Motion(Kind.pulsing, speed=0.6, spacing=(2, 2), diameter=60)),
    "reversing": with_faults(Motion(Kind.reversing, speed=0.6, spacing=(2, 2), diameter=60)),
    "joining": with_faults(Motion(Kind.joining, speed=0.3, spacing=(2, 2), diameter=60)),
    "stopping": with_faults(Motion(Kind.stopping, speed=0.5, droplets=60, diameter=40, frames=60)),
    "short views faults": replace(SHORT_VIEW, missing=0.05, false=0.02),
}
