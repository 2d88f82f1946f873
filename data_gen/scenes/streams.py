"""Droplets in a channel that is wider than they are: in one file or two, or anywhere in it."""

from collections.abc import Iterator

import numpy as np

from data_gen.scenes.channels import (
    REACH,
    Channel,
    draw_structures,
    draw_walls,
    random_walls,
    side_channels,
)
from data_gen.scenes.outlines import Outline, ellipse
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import log_uniform
from droptrack.data.arrays import Float32s, Floats

MAX_DROPLETS = 400
MIN_RADIUS = 4.0  # px
APART = 1.02  # of the typical diameter, that centres are apart at least, before walls move them


def stream(rng: np.random.Generator, canvas: Float32s) -> Iterator[Outline]:
    """Droplets of about one size in a channel wider than they are, straight or tapering."""
    angle = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)], p=[0.55, 0.15, 0.3]))
    channel = Channel(
        centre=rng.uniform(0.25, 0.75, 2) * [WIDTH, HEIGHT],
        angle=angle,
        width=log_uniform(rng, 30, 600),
        widening=float(rng.normal(0, 0.12)) if rng.random() < 0.4 else 0.0,
    )
    if rng.random() < 0.5:
        draw_structures(rng, canvas)
    sides, _ = side_channels(rng, channel)
    draw_walls(
        canvas,
        [[channel, *sides]],
        random_walls(rng),
        float(rng.normal(0, 15)) if rng.random() < 0.5 else 0.0,
    )
    radius = max(MIN_RADIUS, channel.width / 2 * log_uniform(rng, 0.08, 0.65))
    oblong = 1.0 if rng.random() < 0.7 else float(rng.uniform(1, 1.5))
    spread = rng.choice([0.02, 0.1, 0.3], p=[0.6, 0.25, 0.15])
    for along, across in _places(rng, channel, radius):
        one = radius * float(np.clip(np.exp(rng.normal(0, spread)), 0.5, 1.6))
        room = (channel.width + channel.widening * along) / 2 - one
        if room < 0:
            continue
        centre = channel.centre + along * channel.along
        centre += np.clip(across, -room, room) * channel.across
        outline = ellipse(rng, centre, one, oblong)
        if not outline.patch.is_empty:
            yield outline


def _places(rng: np.random.Generator, channel: Channel, radius: float) -> Floats:
    """How far droplets (N, 2) are along a channel and across it, px, few over another."""
    first, last = sorted(rng.uniform(-REACH, REACH, 2)) if rng.random() < 0.4 else (-REACH, REACH)
    room = max(channel.width / 2 - radius, 0.0)
    step = 2 * radius * (1 + log_uniform(rng, 0.02, 4.0))
    growth = float(rng.uniform(0, 0.15)) if rng.random() < 0.3 else 0.0  # they move apart
    kind = rng.random()
    steps = step * (1 + growth * np.arange(MAX_DROPLETS)) * rng.normal(1, 0.04, MAX_DROPLETS)
    along, across = first + np.cumsum(steps), np.zeros(MAX_DROPLETS)
    if kind < 0.5:  # in one file, somewhere across the channel
        across = rng.uniform(-0.5, 0.5) * room + rng.normal(0, 0.03 * radius, MAX_DROPLETS)
    elif kind < 0.65:  # in two
        across[:] = room * rng.uniform(0.3, 1)
        across[1::2] *= -1
    else:
        n = min(MAX_DROPLETS, int(2 * REACH * channel.width / step**2) + 1)
        along, across = rng.uniform(first, last, n), rng.uniform(-room, room, n)
    places = np.column_stack([along, across])
    places = places[along < last]
    return _apart(places, 2 * APART * radius)


def _apart(places: Floats, least: float) -> Floats:
    """Places (N, 2) without those that are too near to one before them."""
    kept = np.empty((0, 2))
    for place in places:
        if (np.hypot(*(kept - place).T) >= least).all():
            kept = np.vstack([kept, place])
    return kept
