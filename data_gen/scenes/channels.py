"""Plugs in channels: stadium shapes one after the other between straight walls."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_gen.scenes.distances import Patch, patch_around, stadium_distance
from data_gen.scenes.inclusions import paint_suspended
from data_gen.scenes.outlines import SHAPE, Outline, margin_of
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import draw_line, log_uniform, texture
from droptrack.data.arrays import Float32s, Floats

REACH = 1.1 * WIDTH  # px from a channel's middle, beyond which nothing of it is in the image
SUSPENSIONS = 0.4  # share of images of plugs with cells or beads in the liquid
JOINED = 0.75  # share of images whose channels open into one another


@dataclass(frozen=True)
class WallLine:
    """One line of a wall: px from the channel's edge, px wide, and its grey level."""

    away: float
    width: float
    level: float


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A straight channel through a point, at an angle in radians, from `start` px along it on.

    It is `width` px wide there, and becomes wider by `widening` px a px along it.
    """

    centre: Floats
    angle: float
    width: float
    start: float = -2.0 * WIDTH
    widening: float = 0.0

    @property
    def along(self) -> Floats:
        """Unit vector (2,) of the flow."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    @property
    def across(self) -> Floats:
        """Unit vector (2,) at right angles to it."""
        return np.array([-np.sin(self.angle), np.cos(self.angle)])

    def distance(self) -> Float32s:
        """How far (H, W) px from its walls each pixel is; negative in the channel."""
        whole = patch_around(SHAPE, np.array([WIDTH, HEIGHT]) / 2, WIDTH)
        x, y = whole.x - np.float32(self.centre[0]), whole.y - np.float32(self.centre[1])
        along, across = self.along.astype(np.float32), self.across.astype(np.float32)
        forwards = np.add.outer(along[1] * y, along[0] * x)
        half = (np.float32(self.width) + np.float32(self.widening) * forwards) / 2
        sideways = np.abs(np.add.outer(across[1] * y, across[0] * x)) - half
        before = np.float32(self.start) - forwards
        return np.asarray(np.maximum(sideways, before), np.float32)


def plugs(
    rng: np.random.Generator, canvas: Float32s, *, suspensions: float = SUSPENSIONS
) -> Iterator[Outline]:
    """Plugs one after the other in one to three parallel channels, with junctions.

    `suspensions`: share of images with cells or beads in the liquid. Without plugs they could be
    droplets.
    """
    width = log_uniform(rng, 22, 330)
    angle = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)], p=[0.6, 0.15, 0.25]))
    middle = rng.uniform(0.25, 0.75, 2) * [WIDTH, HEIGHT]
    main = Channel(centre=middle, angle=angle, width=width)
    if rng.random() < 0.5:
        draw_structures(rng, canvas)
    n = int(rng.integers(1, 4)) if width < 120 else 1
    lanes = []
    for lane in range(n):
        shift = (lane - (n - 1) / 2) * width * rng.uniform(1.5, 2.5)
        lanes.append(Channel(centre=middle + main.across * shift, angle=angle, width=width))
    sides, junction = side_channels(rng, main)
    walls = random_walls(rng)
    inside = rng.normal(0, 12) if rng.random() < 0.4 else 0.0
    channels = lanes + sides
    layers = [channels] if rng.random() < JOINED else [[channel] for channel in channels]
    draw_walls(canvas, layers, walls, inside)
    trains = [plug for channel in lanes for plug in _train(rng, channel, junction)]
    if any(plug.labelled for plug in trains) and rng.random() < suspensions:
        distance = np.minimum.reduce([channel.distance() for channel in channels])
        paint_suspended(canvas, distance, width, rng)
    yield from trains


def side_channels(rng: np.random.Generator, main: Channel) -> tuple[list[Channel], float | None]:
    """Channels that cross or join one, and where along it, in px, if there are any."""
    if rng.random() < 0.5:
        return [], None
    place = float(rng.uniform(-0.4, 0.4)) * WIDTH
    angle = float(rng.choice([np.pi / 2, rng.uniform(0.4, 2.7)]))
    sides = []
    for turn in (angle, -angle)[: rng.integers(1, 3)]:
        spread = 0.0 if rng.random() < 0.7 else rng.normal(0, 0.2) * WIDTH
        sides.append(
            Channel(
                centre=main.centre + main.along * (place + spread),
                angle=main.angle + turn,
                width=main.width * rng.uniform(0.4, 1.2),
                start=-2 * WIDTH if rng.random() < 0.4 else 0.0,
            )
        )
    return sides, place


def empty(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Channels, grids of walls, lines and structures without droplets."""
    kind = rng.random()
    if kind < 0.5:
        for _ in plugs(rng, canvas, suspensions=0):
            pass  # nothing is drawn of them, only their channels
    elif kind < 0.65:
        _draw_grid(rng, canvas)
    draw_structures(rng, canvas)
    if rng.random() < 0.5:  # what is out of focus, or a rough wall: blobs, but no outlines
        canvas += texture(rng, SHAPE, log_uniform(rng, 3, 100)) * np.float32(rng.uniform(0, 30))
    yield from ()


def _draw_grid(rng: np.random.Generator, canvas: Float32s) -> None:
    """Channels at one distance, and others across them: between them are squares and diamonds."""
    width, angle = log_uniform(rng, 8, 120), rng.uniform(0, np.pi)
    turn = np.pi / 2 if rng.random() < 0.6 else rng.uniform(0.5, 2.6)
    middle, layers = rng.uniform(0, 1, 2) * [WIDTH, HEIGHT], []
    for direction, n in ((angle, rng.integers(1, 6)), (angle + turn, rng.integers(1, 6))):
        step = width * rng.uniform(1.1, 3)
        one = Channel(centre=middle, angle=direction, width=width)
        shifts = (np.arange(n) - (n - 1) / 2) * step
        layers.append([replace(one, centre=middle + one.across * s) for s in shifts])
    if rng.random() < 0.3:  # all open into one another
        layers = [[channel for layer in layers for channel in layer]]
    draw_walls(canvas, layers, random_walls(rng), float(rng.normal(0, 12)))


def _train(rng: np.random.Generator, channel: Channel, junction: float | None) -> Iterator[Outline]:
    """The plugs of a channel, alike and evenly spaced; sometimes one is still being formed.

    `junction`: where along the channel, px, another one meets it: plugs break off there.
    """
    filling = rng.uniform(0.78, 1.02) if rng.random() < 0.75 else rng.uniform(0.4, 0.8)
    height = filling * channel.width / 2
    length = height * log_uniform(rng, 1.0, 4.5)
    roundness = rng.uniform(0.75, 1.0) if rng.random() < 0.8 else rng.uniform(0.4, 0.75)
    step = 2 * length * (rng.uniform(1.06, 3.0) if rng.random() < 0.8 else 5.0)
    sides = float(rng.uniform(0, 0.7)) if rng.random() < 0.5 else 1.0
    at = rng.uniform(0, step) - REACH
    # a thread from the image's edge up to where plugs break off; it is no droplet yet
    thread = REACH
    if rng.random() < (0.2 if junction is None else 0.5):
        thread = rng.uniform(-0.5, 0.5) * WIDTH if junction is None else junction
    while at < min(thread, REACH):
        place = channel.centre + channel.along * at
        place = place + channel.across * rng.normal(0, 0.01) * channel.width
        half = np.array([length * rng.normal(1, 0.03), height])
        yield from _plug(channel.angle, place, half, roundness, sides, labelled=True)
        at += step * rng.normal(1, 0.02) if rng.random() < 0.9 else 2 * step
    if thread < REACH:
        half = np.array([2.0 * WIDTH, height * rng.uniform(0.15, 1)])
        place = channel.centre + channel.along * (at + half[0])
        yield from forming_plug(channel, place, half, height, sides)


def forming_plug(
    channel: Channel, centre: Floats, half: Floats, height: float, sides: float
) -> Iterator[Outline]:
    """What is about to become plugs: a thread of half sizes (2,) px with a head at its beginning.

    The head is up to `height` px high, half of it; where the thread is as high, there is none.
    """
    whole = _plug(channel.angle, centre, half, 1.0, sides, labelled=False, margin=height)
    outline = next(whole, None)
    if outline is None:
        return
    if half[1] > 0.8 * height:
        yield outline
        return
    tip = centre - channel.along * (half[0] - 1.3 * height)
    head = stadium_distance(
        outline.patch, tip, np.array([1.3 * height, height]), height, channel.angle
    )
    neck = np.float32(0.4 * height)  # smooth minimum: head and thread are one surface
    both = -neck * np.logaddexp(-outline.distance / neck, -head / neck)
    yield replace(outline, distance=np.asarray(both, np.float32), rim=1.0)


def _plug(
    angle: float,
    centre: Floats,
    half: Floats,
    roundness: float,
    sides: float,
    *,
    labelled: bool,
    margin: float = 0.0,
) -> Iterator[Outline]:
    """One plug of half sizes (2,) px, if any of it is in the image.

    Its patch has `margin` px more around it than any droplet's.
    """
    radius = float(min(half)) * roundness
    patch = patch_around(SHAPE, centre, float(np.hypot(*half)) + margin_of(half[1]) + margin)
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


def random_walls(rng: np.random.Generator) -> tuple[WallLine, ...]:
    """One to three lines, dark and bright in turn, mostly dark first."""
    first = -1 if rng.random() < 0.75 else 1
    width = log_uniform(rng, 1, 16)
    return tuple(
        WallLine(
            k * 1.6 * width + rng.uniform(0, 2), width, first * (-1) ** k * rng.uniform(15, 150)
        )
        for k in range(rng.integers(1, 4))
    )


def draw_walls(
    canvas: Float32s,
    layers: Sequence[Sequence[Channel]],
    walls: Sequence[WallLine],
    inside: float,
) -> None:
    """The walls of channels, and the level of the liquid between them, relative to what is below.

    Channels of one layer open into one another; layers cross.
    """
    for channels in layers:
        distance = np.minimum.reduce([channel.distance() for channel in channels])
        canvas += wall_lines(distance, walls)
        canvas += np.clip(np.float32(0.5) - distance, 0, 1) * np.float32(inside)


def wall_lines(distance: Float32s, walls: Sequence[WallLine]) -> Float32s:
    """Grey levels (H, W) of the walls of channels, relative to what is below.

    `distance` (H, W): px from the channels' edges, negative in them.
    """
    levels = np.zeros_like(distance)
    for line in walls:
        middle, half = np.float32(line.away + line.width / 2), np.float32(line.width / 2)
        shown = np.clip(half + np.float32(0.5) - np.abs(distance - middle), 0, 1)
        levels += shown * np.float32(line.level)
    return levels


def draw_structures(rng: np.random.Generator, canvas: Float32s) -> None:
    """What may be beside channels: a texture, and lines."""
    canvas += texture(rng, SHAPE, float(rng.uniform(3, 40))) * np.float32(rng.uniform(0, 8))
    for _ in range(rng.integers(0, 5)):
        start = rng.uniform(0, 1, 2) * [WIDTH, HEIGHT]
        end = start + rng.normal(0, 300, 2)
        draw_line(canvas, start, end, log_uniform(rng, 1, 8), float(rng.normal(0, 50)))
