"""Droplets that are hard to track: their ground truth and a detector's faulty output.

There are no images: a tracker sees only boxes. Speeds are in droplet diameters per frame.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from data_gen.videos.pairs import PairEvent, merging_pairs, splitting_pairs
from data_gen.videos.sine import place_droplets
from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from droptrack.data.mot_files import write_detections
from droptrack.data.trajectories import Trajectories, sorted_trajectories, write_trajectories
from droptrack.errors import DroptrackError
from droptrack.version import __version__

Flow = Callable[[Floats], Floats]  # places (N, 2) -> velocities (N, 2), px per frame

WIDTH, HEIGHT = 1200.0, 600.0
CLEARANCE = 1.1  # minimum distance of droplets at the start, in diameters
HEXAGONAL_SPACING = 1.05  # diameters
DISORDER = 0.03  # of a packing's places, in spacings


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


PAIRS = {Kind.merging: merging_pairs, Kind.splitting: splitting_pairs}


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
PULSE = 16  # frames from one pulse, or turn, to the next
JUNCTION = (450.0, 600.0)  # where channels begin to bend towards each other, and are one
N_STOPPING, STOPPING_ROOM = 4, 4.0  # droplets that stop, and their distance, in diameters
BRAKING = 6  # frames

PLUG_ASPECT, PLUG_DIAMETER = 2.0, 85.0
TRAIN_PLUGS = 18
LANE_SPEEDS = 0.2  # by which the speed of the last lane is lower, of the first one's
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


def ground_truth_of(paths: Floats, diameters: Floats, aspect: float = 1.0) -> Trajectories:
    """Those droplets that are wholly in the image; `aspect`: their width, in heights."""
    shape = np.array([np.sqrt(aspect), 1 / np.sqrt(aspect)])
    margin = diameters[..., None] * shape / 2
    whole = ((paths >= margin) & (paths <= [WIDTH, HEIGHT] - margin)).all(axis=2)
    droplet, frame = np.nonzero(whole)
    size = diameters[whole]
    boxes = np.column_stack([paths[whole], size[:, None] * shape])
    return sorted_trajectories(
        frame=frame.astype(np.int64),
        track_id=droplet.astype(np.int64) + 1,
        x=boxes[:, 0],
        y=boxes[:, 1],
        boxes=boxes,
        scores=np.ones(len(size)),
        observed=np.ones(len(size), bool),
    )


def detect(rng: np.random.Generator, truth: Trajectories, motion: Motion) -> list[Detections]:
    """What a detector would find, frame by frame: some missed, some false, all a little off."""
    found = []
    shape = np.array([np.sqrt(motion.aspect), 1 / np.sqrt(motion.aspect)])
    there = np.ones(motion.frames, bool)
    if motion.images_missing:
        there = rng.random(motion.frames) >= motion.images_missing
    for frame in range(motion.frames):
        if not there[frame]:
            found.append(Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64)))
            continue
        boxes = truth.boxes[truth.frame == frame]
        n_false = rng.poisson(motion.false * len(boxes))
        boxes = boxes[rng.random(len(boxes)) >= motion.missing]
        size = motion.diameter * rng.uniform(0.8, 1.2, (n_false, 1)) * shape
        false = np.hstack([rng.uniform(0, 1, (n_false, 2)) * [WIDTH, HEIGHT], size])
        noise = rng.normal(0, 1, boxes.shape) * motion.jitter * boxes[:, 2:3]
        noise[:, 2:] = np.maximum(noise[:, 2:], -0.5 * boxes[:, 2:])
        boxes = rng.permutation(np.vstack([boxes + noise, false]))
        found.append(Detections(boxes, np.ones(len(boxes)), np.zeros(len(boxes), np.int64)))
    return found


def make(motion: Motion, seed: int) -> tuple[Trajectories, list[Detections]]:
    """The ground truth of a motion and what a detector finds of it in each frame."""
    rng = np.random.default_rng(seed)
    truth = ground_truth_of(*move(rng, motion), motion.aspect)
    return truth, detect(rng, truth, motion)


def write_motion(out: Path, motion: Motion, seed: int) -> int:
    """Write detections.txt and truth.csv to a folder; returns the number of droplets.

    And events.csv, where droplets coalesce or break up.
    """
    truth, found = make(motion, seed)
    out.mkdir(parents=True, exist_ok=True)
    about = {
        "made by": f"droptrack {__version__}, data_gen.simulate motions",
        "parameters": f"{motion}, seed={seed}",
        "video": f"none, {WIDTH:g} x {HEIGHT:g} px",
    }
    write_trajectories(out / "truth.csv", truth, about)
    write_detections(out / "detections.txt", found)
    if events := events_of(motion, seed):
        lines = [
            f"{one.frame},{motion.kind},{' '.join(map(str, one.parents))},"
            f"{' '.join(map(str, one.children))},{one.x:.6f},{one.y:.6f}\n"
            for one in sorted(events, key=lambda one: one.frame)
        ]
        text = "frame,kind,parents,children,x,y\n" + "".join(lines)
        (out / "events.csv").write_text(text, encoding="utf-8")
    return len(np.unique(truth.track_id))
