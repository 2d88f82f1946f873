"""Plugs in channels: stadium shapes one after the other between straight walls."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from data_gen.scenes.distances import Patch, patch_around, stadium_distance
from data_gen.scenes.outlines import SHAPE, Outline, log_uniform
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import draw_line, texture
from droptrack.data.arrays import Float32s, Floats

REACH = 1.1 * WIDTH  # px from a channel's middle, beyond which nothing of it is in the image


@dataclass(frozen=True)
class WallLine:
    """One line of a wall: px from the channel's edge, px wide, and its grey level."""

    away: float
    width: float
    level: float


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A straight channel through a point, at an angle in radians, with the lines of its walls."""

    centre: Floats
    angle: float
    width: float
    walls: tuple[WallLine, ...]

    @property
    def along(self) -> Floats:
        """Unit vector (2,) of the flow."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    @property
    def across(self) -> Floats:
        """Unit vector (2,) at right angles to it."""
        return np.array([-np.sin(self.angle), np.cos(self.angle)])


def plugs(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Plugs one after the other in one to three parallel channels, with junctions."""
    width = log_uniform(rng, 22, 330)
    angle = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)], p=[0.6, 0.15, 0.25]))
    middle = rng.uniform(0.25, 0.75, 2) * [WIDTH, HEIGHT]
    main = Channel(centre=middle, angle=angle, width=width, walls=_random_walls(rng))
    if rng.random() < 0.5:
        _draw_structures(rng, canvas)
    n = int(rng.integers(1, 4)) if width < 120 else 1
    for lane in range(n):
        shift = (lane - (n - 1) / 2) * width * rng.uniform(1.5, 2.5)
        centre = middle + main.across * shift
        lane_channel = Channel(centre=centre, angle=angle, width=width, walls=main.walls)
        _draw_walls(canvas, lane_channel, start=-2 * WIDTH)
        yield from _train(rng, lane_channel)
    for _ in range(rng.integers(0, 3) if rng.random() < 0.5 else 0):
        side = Channel(
            centre=middle + main.along * rng.uniform(-0.5, 0.5) * WIDTH,
            angle=angle + float(rng.choice([np.pi / 2, rng.uniform(0.4, 2.7)])),
            width=width * rng.uniform(0.4, 1.2),
            walls=main.walls,
        )
        crosses = rng.random() < 0.7
        _draw_walls(canvas, side, start=-2 * WIDTH if crosses else side.width / 2)


def empty(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Channels, lines and structures without droplets."""
    if rng.random() < 0.7:
        for _ in plugs(rng, canvas):
            pass  # nothing is drawn of them, only their channels
    _draw_structures(rng, canvas)
    yield from ()


def _train(rng: np.random.Generator, channel: Channel) -> Iterator[Outline]:
    """The plugs of a channel, alike and evenly spaced; sometimes one is still being formed."""
    filling = rng.uniform(0.78, 1.02) if rng.random() < 0.75 else rng.uniform(0.4, 0.8)
    height = filling * channel.width / 2
    length = height * log_uniform(rng, 1.0, 4.5)
    roundness = rng.uniform(0.75, 1.0) if rng.random() < 0.8 else rng.uniform(0.4, 0.75)
    step = 2 * length * (rng.uniform(1.06, 3.0) if rng.random() < 0.8 else 5.0)
    sides = float(rng.uniform(0, 0.7)) if rng.random() < 0.5 else 1.0
    at = rng.uniform(0, step) - REACH
    # a thread from the image's edge up to where plugs break off; it is no droplet yet
    thread = rng.uniform(-0.5, 0.5) * WIDTH if rng.random() < 0.2 else REACH
    while at < min(thread, REACH):
        place = channel.centre + channel.along * at
        place = place + channel.across * rng.normal(0, 0.01) * channel.width
        half = np.array([length * rng.normal(1, 0.03), height])
        yield from _plug(channel.angle, place, half, roundness, sides, labelled=True)
        at += step * rng.normal(1, 0.02) if rng.random() < 0.9 else 2 * step
    if thread < REACH:
        half = np.array([2.0 * WIDTH, height * rng.uniform(0.4, 1)])
        place = channel.centre + channel.along * (at + half[0])
        yield from _plug(channel.angle, place, half, roundness, sides, labelled=False)


def _plug(
    angle: float, centre: Floats, half: Floats, roundness: float, sides: float, *, labelled: bool
) -> Iterator[Outline]:
    """One plug of half sizes (2,) px, if any of it is in the image."""
    radius = float(min(half)) * roundness
    patch = patch_around(SHAPE, centre, float(np.hypot(*half)) + 4)
    if patch.is_empty:
        return
    distance = stadium_distance(patch, centre, half, radius, angle)
    if not (distance < 3).any():
        return
    yield Outline(
        patch=patch,
        distance=distance,
        radius=float(half[1]),
        centre=centre,
        area=float(4 * half.prod() - (4 - np.pi) * radius**2),
        rim=_caps(patch, centre, float(half[0] - radius), radius, angle, sides),
        labelled=labelled,
    )


def _caps(
    patch: Patch, centre: Floats, straight: float, radius: float, angle: float, sides: float
) -> Float32s | float:
    """How strong a plug's rim is (H, W): in a rectangular channel, hardly seen along the walls."""
    if sides == 1.0:
        return 1.0
    x, y = patch.x - np.float32(centre[0]), patch.y - np.float32(centre[1])
    along = np.add.outer(np.float32(np.sin(angle)) * y, np.float32(np.cos(angle)) * x)
    cap = np.clip((np.abs(along) - np.float32(straight)) / np.float32(0.6 * radius), 0, 1)
    return np.asarray(sides + (1 - sides) * cap, np.float32)


def _random_walls(rng: np.random.Generator) -> tuple[WallLine, ...]:
    """One to three lines, dark and bright in turn, mostly dark first."""
    first = -1 if rng.random() < 0.75 else 1
    width = log_uniform(rng, 1, 16)
    return tuple(
        WallLine(
            k * 1.6 * width + rng.uniform(0, 2), width, first * (-1) ** k * rng.uniform(15, 150)
        )
        for k in range(rng.integers(1, 4))
    )


def _draw_walls(canvas: Float32s, channel: Channel, start: float) -> None:
    """Both walls of a channel, from `start` px along it to beyond the image."""
    ends = [channel.centre + channel.along * at for at in (start, 2 * WIDTH)]
    for line in channel.walls:
        for side in (-1, 1):
            shift = side * channel.across * (channel.width / 2 + line.away + line.width / 2)
            draw_line(canvas, ends[0] + shift, ends[1] + shift, line.width, line.level)


def _draw_structures(rng: np.random.Generator, canvas: Float32s) -> None:
    """What may be beside channels: a texture, and lines."""
    canvas += texture(rng, SHAPE, float(rng.uniform(3, 40))) * np.float32(rng.uniform(0, 8))
    for _ in range(rng.integers(0, 5)):
        start = rng.uniform(0, 1, 2) * [WIDTH, HEIGHT]
        end = start + rng.normal(0, 300, 2)
        draw_line(canvas, start, end, log_uniform(rng, 1, 8), float(rng.normal(0, 50)))
