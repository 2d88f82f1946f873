"""Where the droplets of a motion are in each frame, and how large they are."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data_gen.videos.motion_kinds import HEIGHT, IN_CHANNELS, WIDTH, Kind, Motion
from data_gen.videos.pairs import PairEvent, merging_pairs, splitting_pairs
from data_gen.videos.sine import place_droplets
from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

Flow = Callable[[Floats], Floats]  # places (N, 2) -> velocities (N, 2), px per frame

CLEARANCE = 1.1  # minimum distance of droplets at the start, in diameters
HEXAGONAL_SPACING = 1.05  # diameters
DISORDER = 0.03  # of a packing's places, in spacings
PULSE = 16  # frames from one pulse, or turn, to the next
JUNCTION = (450.0, 600.0)  # where channels begin to bend towards each other, and are one
N_STOPPING, STOPPING_ROOM = 4, 4.0  # droplets that stop, and their distance, in diameters
BRAKING = 6  # frames
LANE_SPEEDS = 0.2  # by which the speed of the last lane is lower, of the first one's
PAIRS = {Kind.merging: merging_pairs, Kind.splitting: splitting_pairs}


def move(rng: np.random.Generator, motion: Motion) -> tuple[Floats, Floats]:
    """Paths (N, T, 2) and diameters (N, T) of the droplets, px, in and around the image."""
    if motion.kind == Kind.sine:
        size = (int(WIDTH), int(HEIGHT))
        paths, radii = place_droplets(
            rng, motion.droplets, size, motion.frames, (16.0, 30.0), (5.0, 5.0, 5.0)
        )
        return paths, np.repeat(2 * radii[:, None], motion.frames, axis=1)
    if motion.kind in PAIRS:
        paths, diameters, _ = pairs_of(rng, motion)
        return paths, diameters
    if motion.kind in IN_CHANNELS:
        paths = joining_paths(motion) if motion.kind == Kind.joining else train_paths(rng, motion)
    elif motion.kind == Kind.stopping:
        paths = stopping_paths(rng, motion)
    elif motion.kind in (Kind.packing, Kind.filled):
        paths = packing_paths(rng, motion)
    elif motion.kind == Kind.crossing:
        paths = crossing_paths(rng, motion)
    else:
        paths = carried_paths(rng, motion)
    return paths, sizes(rng, motion, len(paths))


def pairs_of(rng: np.random.Generator, motion: Motion) -> tuple[Floats, Floats, list[PairEvent]]:
    """Paths, diameters and events of pairs that coalesce or break up; four droplets an event."""
    n = max(motion.droplets // 4, 1)
    return PAIRS[Kind(motion.kind)](rng, n, motion.diameter, motion.frames, (WIDTH, HEIGHT))


def events_of(motion: Motion, seed: int) -> list[PairEvent]:
    """What happens in the motion that `make` gives with this seed."""
    if motion.kind not in PAIRS:
        return []
    return pairs_of(np.random.default_rng(seed), motion)[2]


def scattered(rng: np.random.Generator, motion: Motion, length: float) -> Floats:
    """Places (N, 2), as dense as wanted, in a strip of the image's height from -length on.

    A hexagonal lattice, each place moved at random as far as it can without touching others.
    """
    spacing = float(np.sqrt(2 / np.sqrt(3) * WIDTH * HEIGHT / motion.droplets))
    room = (spacing - CLEARANCE * motion.diameter) / 2
    if room <= 0:
        raise DroptrackError(f"no room for {motion.droplets} droplets; take fewer")
    places = lattice(spacing, -length, WIDTH, 0, HEIGHT)
    angle, radius = rng.uniform(0, 2 * np.pi, len(places)), room * np.sqrt(rng.random(len(places)))
    return np.asarray(places + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def lattice(spacing: float, left: float, right: float, top: float, bottom: float) -> Floats:
    """Places (N, 2) of a hexagonal lattice, rows along x."""
    row, column = np.mgrid[
        : int((bottom - top) / spacing / np.sqrt(0.75)) + 1, : int((right - left) / spacing) + 1
    ].reshape(2, -1)
    return np.column_stack(
        [left + (column + row % 2 / 2) * spacing, top + row * np.sqrt(0.75) * spacing]
    )


def carried(places: Floats, flow: Flow, n_frames: int, steps: int = 8) -> Floats:
    """Paths (N, T, 2) of points that go with a flow (midpoint rule)."""
    paths = [places]
    for _ in range(n_frames - 1):
        at = paths[-1]
        for _ in range(steps):
            at = at + flow(at + flow(at) / (2 * steps)) / steps
        paths.append(at)
    return np.stack(paths, axis=1)


def flow_of(kind: str, speed: float) -> Flow:
    """The velocity field of a kind of motion; `speed` in px per frame."""

    def flow(at: Floats) -> Floats:
        x, y = at[:, 0], at[:, 1]
        u, v = np.full_like(x, speed), np.zeros_like(x)
        if kind == Kind.shear:
            u = speed * y / HEIGHT
        elif kind in (Kind.channel, Kind.growing):
            u = speed * 4 * y * (HEIGHT - y) / HEIGHT**2
        elif kind == Kind.vortices:
            k = 2 * np.pi / HEIGHT
            u, v = speed * np.sin(k * x) * np.cos(k * y), -speed * np.cos(k * x) * np.sin(k * y)
        return np.column_stack([u, v])

    return flow


def packing_paths(rng: np.random.Generator, motion: Motion) -> Floats:
    """A hexagonal packing with some disorder, that moves by half a spacing per frame."""
    spacing = HEXAGONAL_SPACING * motion.diameter
    side, step = np.sqrt(motion.droplets) * spacing, spacing / 2
    places = (
        lattice(spacing, 30, 30 + side, 60, 60 + side)
        if motion.kind == Kind.packing
        else lattice(spacing, -step * motion.frames, WIDTH, 0, HEIGHT)
    )
    places = places + rng.normal(0, DISORDER * spacing, places.shape)
    return np.asarray(places[:, None] + np.arange(motion.frames)[:, None] * [step, 0.0])


def train_paths(rng: np.random.Generator, motion: Motion) -> Floats:
    """Plugs one after the other, in lanes one below the other; those in the image come first."""
    length = motion.diameter * np.sqrt(motion.aspect)
    t = np.arange(float(motion.frames))
    paths = []
    for lane in range(motion.lanes):
        slower = LANE_SPEEDS * lane / max(motion.lanes - 1, 1)
        speed = motion.speed * motion.diameter * (1 - slower)
        n = int((WIDTH + speed * motion.frames) / (motion.spacing[0] * length)) + 1
        apart = rng.uniform(*motion.spacing, n) * length
        x = WIDTH - rng.uniform(0, apart[0]) - np.append(0, np.cumsum(apart[1:]))
        x = x[:, None] + speed * gone(motion.kind, t)
        y = np.full_like(x, (lane + 0.5) * HEIGHT / motion.lanes)
        paths.append(np.stack([x, y], axis=2))
    return np.concatenate(paths)


def gone(kind: str, t: Floats) -> Floats:
    """How far a train has come by frames t (T,), in its greatest steps."""
    phase = 2 * np.pi * t / PULSE
    if kind == Kind.pulsing:  # the step is 0.55 - 0.45 cos
        return np.asarray(0.55 * t - 0.45 * np.sin(phase) * PULSE / (2 * np.pi))
    if kind == Kind.reversing:  # it is cos, and goes as far back as on
        return np.asarray(np.sin(phase) * PULSE / (2 * np.pi))
    return t


def joining_paths(motion: Motion) -> Floats:
    """Trains of two channels, out of step, that become one: there the flow is twice as fast."""
    speed = motion.speed * motion.diameter
    apart = motion.spacing[0] * motion.diameter * np.sqrt(motion.aspect)
    bend, end = JUNCTION
    slope = float(np.hypot(end - bend, HEIGHT / 4))  # as long as a channel is between the two
    t = np.arange(motion.frames)
    paths = []
    for channel in range(2):
        n = int((bend + slope + speed * motion.frames) / apart) + 1
        s = (
            apart * (channel / 2 - np.arange(-3, n))[:, None] + bend + speed * t
        )  # along the channel
        share = np.clip((s - bend) / slope, 0, 1)
        beyond = 2 * np.maximum(s - bend - slope, 0)
        x = np.minimum(s, bend) + share * (end - bend) + beyond
        wall = HEIGHT / 4 if channel == 0 else 3 * HEIGHT / 4
        y = wall + share * (HEIGHT / 2 - wall)
        paths.append(np.stack([x, y], axis=2))
    return np.concatenate(paths)


def stopping_paths(rng: np.random.Generator, motion: Motion) -> Floats:
    """A uniform flow, and below it droplets that stop one behind the other."""
    speed, room = motion.speed * motion.diameter, STOPPING_ROOM * motion.diameter
    places = scattered(rng, motion, speed * motion.frames)
    free = places[places[:, 1] < HEIGHT - 2.5 * motion.diameter]
    t = np.arange(motion.frames)
    flowing = free[:, None] + t[:, None] * [speed, 0.0]
    stops = WIDTH - room * (1 + np.arange(N_STOPPING))[:, None]
    left = np.maximum(1 - np.maximum(t - motion.frames / 3, 0) / BRAKING, 0)  # of the speed
    x = stops + np.cumsum(left) * speed - left.sum() * speed
    wall = np.full_like(x, HEIGHT - motion.diameter)
    return np.concatenate([flowing, np.stack([x, wall], axis=2)])


def crossing_paths(rng: np.random.Generator, motion: Motion) -> Floats:
    """Two swarms, half of the droplets each, that move through each other."""
    half = replace(motion, droplets=motion.droplets // 2)
    swarms = [scattered(rng, half, 0) for _ in range(2)]
    t = np.arange(motion.frames)[:, None]
    ways = np.array([[1.0, 0.25], [-1.0, 0.25]]) * (motion.speed * motion.diameter)
    return np.concatenate([s[:, None] + t * way for s, way in zip(swarms, ways, strict=True)])


def carried_paths(rng: np.random.Generator, motion: Motion) -> Floats:
    """Scattered droplets carried by a flow; in vortices only those that stay in the image.

    The others would go out and come back.
    """
    kind, speed = motion.kind, motion.speed * motion.diameter
    length = 0 if kind == Kind.vortices else speed * motion.frames
    paths = carried(scattered(rng, motion, length), flow_of(kind, speed), motion.frames)
    if kind != Kind.vortices:
        return paths
    inside = (paths > motion.diameter) & (paths < [WIDTH, HEIGHT] - np.array(motion.diameter))
    return paths[inside.all(axis=(1, 2))]


def sizes(rng: np.random.Generator, motion: Motion, n: int) -> Floats:
    """Diameters (n, T): all a little different; `growing` ones double or halve; a train's equal."""
    if motion.kind in IN_CHANNELS:
        return np.full((n, motion.frames), motion.diameter)
    diameters = motion.diameter * rng.uniform(0.9, 1.1, n)[:, None]
    if motion.kind != Kind.growing:
        return np.repeat(diameters, motion.frames, axis=1)
    growth = rng.choice([-1, 1], n)[:, None] * np.linspace(-0.5, 0.5, motion.frames)
    return np.asarray(0.8 * diameters * 2.0**growth)
