"""What few droplets that pass one after the other tell of the flow: it is remembered.

Where droplets are many, those of the same frame tell more, and nothing is remembered.
"""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking.droplet.tracks import Tracks
from droptrack.tracking.neighbour_velocity import velocity_of_neighbours
from droptrack.tracking.tracker import Velocity

MAX_SAMPLES = 96  # droplets of the last frames that are remembered
MAX_DROPLETS = 12  # in a frame; where there are more, the frame itself tells
MAX_IMAGES = 12  # the last ones whose boxes vote
MIN_HITS = 2  # of a track whose velocity is remembered
MAX_COMMON_STEP = 3.0  # diameters
VOTE_DEVIATION = 0.15  # diameters, of a droplet from where the common step takes it
STEP_CELL = 0.05  # diameters, within which steps are one
MIN_SHARE = 0.6  # of the boxes that must agree with the common step
UNSURE = 2.0  # boxes that disagree, before any is counted
PLACE_WIDTH = 0.5  # diameters, standard deviation of the weight of a velocity remembered,
MIN_PASSED = 2.0  # and the sum of weights that make a flow at a place
MIN_STEP = 1e-9  # px, so that there is a direction
KERNEL_WIDTH = 0.3  # diameters, standard deviation of the kernel around a place
FIRST_STEP_DEVIATION = 0.15  # of a new droplet's velocity, diameters a frame, before any is seen:
FIRST_STEPS = 3.0  # it counts as so many droplets'
MAX_FIRST_STEPS = 20.0  # droplets that tell of the deviation, the last ones
MAX_SURPRISE = 0.5  # diameters a frame; more counts as this
ALIAS_LENGTH = 1.5  # of the best step's, up to which another is as likely


class CommonStep(NamedTuple):
    """A velocity (2,), px a frame, and another one that explains the images as well, if any.

    `share`: of the boxes that are where the velocity takes them.
    """

    velocity: Floats
    share: float
    other: Floats | None

    @property
    def ambiguous(self) -> bool:
        """Whether there is another."""
        return self.other is not None


@dataclass(frozen=True)
class WeighedVelocities:
    """How often it was asked whether one velocity explains the images, and how often two did."""

    n_asked: int = 0
    n_ambiguous: int = 0
    last: tuple[Velocity, ...] = ()  # two that did

    def of(self, flow: "Flow", diameter: float) -> "WeighedVelocities":
        """Asked once more, of the last images."""
        common = flow.common_step(diameter)
        if common is None:
            return self
        if common.other is None:
            return WeighedVelocities(self.n_asked + 1, self.n_ambiguous, self.last)
        both = tuple((float(x), float(y)) for x, y in (common.velocity, common.other))
        return WeighedVelocities(self.n_asked + 1, self.n_ambiguous + 1, both)

    @property
    def possible(self) -> tuple[Velocity, ...]:
        """Two velocities if they explain the images more often than one does."""
        return self.last if 2 * self.n_ambiguous > self.n_asked else ()


def _none() -> Floats:
    return np.zeros((0, 2))


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Places and velocities of droplets, and the boxes' centres of the last images.

    `low`, `high` (2,): corners of the region where droplets have been seen.
    """

    positions: Floats = field(default_factory=_none)  # (K, 2)
    velocities: Floats = field(default_factory=_none)  # (K, 2) px a frame
    images: tuple[tuple[int, Floats], ...] = ()  # frame numbers and points (M, 2)
    n_images: int = 0  # the last ones, in which the samples were seen
    low: Floats = field(default_factory=lambda: np.full(2, np.inf))
    high: Floats = field(default_factory=lambda: np.full(2, -np.inf))
    n_first: float = FIRST_STEPS  # first steps, of which the last ones count more,
    first_squares: float = FIRST_STEPS * FIRST_STEP_DEVIATION**2  # and their squares, see below

    @property
    def deviation(self) -> float:
        """Of a new droplet's velocity from what is remembered, diameters a frame.

        A flow that is less sure than was thought at first gets no wider: where a droplet may go
        almost anywhere, it goes to the next one's place.
        """
        return min(FIRST_STEP_DEVIATION, float(np.sqrt(self.first_squares / self.n_first)))

    def surprised(self, steps: Floats) -> "Flow":
        """With how far off first steps (K, 2) of new droplets were, diameters a frame."""
        if not self.images or not len(steps):
            return self
        squares = np.minimum((steps**2).sum(axis=1) / 2, MAX_SURPRISE**2)
        keep = min(1.0, MAX_FIRST_STEPS / (self.n_first + len(steps)))
        return replace(
            self,
            n_first=keep * (self.n_first + len(steps)),
            first_squares=keep * (self.first_squares + float(squares.sum())),
        )

    def seeing(self, frame: int, points: Floats) -> "Flow":
        """With the centres (M, 2) of a frame's boxes."""
        if not len(points):
            return self
        few = len(points) <= MAX_DROPLETS
        if not few and not self.images:
            return self
        images = (*self.images[1 - MAX_IMAGES :], (frame, points)) if few else ()
        return Flow(
            positions=self.positions if few else _none(),
            velocities=self.velocities if few else _none(),
            images=images,
            n_images=self.n_images,
            low=self.low,
            high=self.high,
            n_first=self.n_first,
            first_squares=self.first_squares,
        )

    def learned(self, tracks: Tracks, confirmed: tuple[int, ...] = ()) -> "Flow":
        """With the tracks' droplets of this frame, and where those `confirmed` now were first."""
        if not self.images:
            return self
        known = (tracks.hits >= MIN_HITS) & (tracks.missed == 0)
        if not known.any():
            return self
        sure = known & tracks.confirmed
        new = sure & np.isin(tracks.ids, confirmed)
        velocity = tracks.state.velocity
        positions = np.concatenate(
            [self.positions, tracks.first_position[new], tracks.state.position[sure]]
        )
        velocities = np.concatenate([self.velocities, velocity[new], velocity[sure]])
        places = np.concatenate([tracks.state.position[known], tracks.first_position[known]])
        full = len(positions) > MAX_SAMPLES
        return Flow(
            positions=positions[-MAX_SAMPLES:],
            velocities=velocities[-MAX_SAMPLES:],
            images=self.images,
            n_images=self.n_images if full else self.n_images + 1,
            low=np.minimum(self.low, places.min(axis=0)),
            high=np.maximum(self.high, places.max(axis=0)),
            n_first=self.n_first,
            first_squares=self.first_squares,
        )

    def without_images(self) -> "Flow":
        """What is remembered of droplets, before the images are seen once more."""
        return replace(self, images=())

    def velocity_at(self, places: Floats, diameters: Floats) -> tuple[Floats, Floats]:
        """Mean velocity (N, 2) of droplets that passed at places (N, 2), and its variance (N,).

        Where too few passed just there, of those further around: see `velocity_of_neighbours`.
        """
        mean, variance = velocity_of_neighbours(places, diameters, self.positions, self.velocities)
        if not len(self.positions):
            return mean, variance
        square = ((places[:, None] - self.positions) ** 2).sum(axis=2) / diameters[:, None] ** 2
        weight = np.exp(-square / (2 * PLACE_WIDTH**2))
        total = weight.sum(axis=1)
        there = total >= MIN_PASSED
        weight = weight[there] / total[there, None]
        mean[there] = weight @ self.velocities
        off = ((self.velocities - mean[there][:, None]) ** 2).sum(axis=2)
        variance[there] = (weight * off).sum(axis=1) / 2
        return mean, variance

    def density(self, diameter: float) -> float:
        """Droplets a squared diameter of the region, or 0 where they are too many to be counted."""
        if not self.images:
            return 0.0
        n_boxes = sum(len(points) for _, points in self.images)
        return n_boxes / len(self.images) / self.area(diameter)

    def area(self, diameter: float) -> float:
        """Squared diameters of the region of all boxes of the last images."""
        everything = np.concatenate([points for _, points in self.images])
        return float((np.ptp(everything, axis=0) / diameter + 1).prod())

    def left_by(self, tracks: Tracks) -> Bools:
        """Tracks (N,) that began in the region and are expected out of it by now.

        None where droplets are so many that nothing is remembered.
        """
        if not self.images:
            return np.zeros(len(tracks), bool)
        first = tracks.first_position
        margin = KERNEL_WIDTH * tracks.diameters[:, None]
        inside = ((first >= self.low - margin) & (first <= self.high + margin)).all(axis=1)
        return inside & self.outside(tracks)

    def outside(self, tracks: Tracks) -> Bools:
        """Tracks (N,) that are expected out of the region by now."""
        if not self.images or self.low[0] > self.high[0]:  # no region is known yet
            return np.zeros(len(tracks), bool)
        now = tracks.state.position
        return np.asarray(((now < self.low) | (now > self.high)).any(axis=1))

    def density_at(self, places: Floats, diameters: Floats) -> Floats:
        """Droplets a squared diameter (N,) that were around places (N, 2) in the last images.

        Each might as well have been seen half a step earlier or later.
        """
        d = diameters[:, None]
        step = np.hypot(*self.velocities.T)
        x, y = self.velocities.T / np.maximum(step, MIN_STEP)
        dx, dy = ((places[:, None] - self.positions) / d[..., None]).transpose(2, 0, 1)
        along = np.sqrt(KERNEL_WIDTH**2 + (step / d) ** 2 / 12)
        square = ((x * dx + y * dy) / along) ** 2 + ((x * dy - y * dx) / KERNEL_WIDTH) ** 2
        total = (np.exp(-square / 2) / along).sum(axis=1) / (2 * np.pi * KERNEL_WIDTH)
        anywhere = self.density(float(np.median(diameters)))  # counts as one more image
        return np.asarray((total + anywhere) / (self.n_images + 1))

    def common_step(self, diameter: float) -> CommonStep | None:
        """The velocity with which all droplets of the last images go, px a frame, if there is one.

        Also whether another one, about as long, explains the images as well: in a train of equal
        droplets, a step and the same less the spacing cannot be told apart.
        """
        pairs = [(later - before, a, b) for (before, a), (later, b) in pairwise(self.images)]
        if not pairs:
            return None
        steps = np.concatenate(
            [((b[None] - a[:, None]) / gap).reshape(-1, 2) for gap, a, b in pairs]
        )
        steps = steps[np.hypot(*steps.T) < MAX_COMMON_STEP * diameter]
        if not len(steps):
            return None
        steps, votes = _means_of_cells(steps, STEP_CELL * diameter)
        length = np.hypot(*steps.T)
        share, count = _shares(steps, pairs, VOTE_DEVIATION * diameter)
        best = int(share.argmax())
        alike = share > share[best] - 1 / np.sqrt(count[best])  # as sure as a count is
        good = np.flatnonzero(alike)
        best = int(good[length[good].argmin()])  # of steps that explain alike, the shortest
        if share.max() < MIN_SHARE:
            return None
        near = np.hypot(*(steps - steps[best]).T) < 3 * VOTE_DEVIATION * diameter
        mean = np.average(steps[near & alike], axis=0, weights=votes[near & alike])
        others = np.flatnonzero(~near & alike & (length < ALIAS_LENGTH * length[best]))
        if not len(others):
            return CommonStep(mean, float(share[best]), None)
        return CommonStep(mean, float(share[best]), steps[others[share[others].argmax()]])


def _means_of_cells(steps: Floats, width: float) -> tuple[Floats, Rows]:
    """Steps (S, 2) that are alike as one, their mean (C, 2), and how many they are (C,)."""
    cells = np.round(steps / width).astype(np.int64)
    cells -= cells.min(axis=0)
    _, place, votes = np.unique(
        cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True, return_counts=True
    )
    sums = np.column_stack([np.bincount(place, weights=part) for part in steps.T])
    return sums / votes[:, None], votes


def _shares(
    steps: Floats, pairs: list[tuple[int, Floats, Floats]], deviation: float
) -> tuple[Floats, Floats]:
    """Of all boxes of images, the share (S,) that is where each step (S, 2) takes it, of how many.

    Looking forwards and backwards; what a step takes out of the region of all boxes does not count.
    """
    everything = np.concatenate([points for _, *both in pairs for points in both])
    low, high = everything.min(axis=0) - deviation, everything.max(axis=0) + deviation
    agree, count = np.zeros(len(steps)), np.full(len(steps), UNSURE)
    for gap, before, later in pairs:
        for here, there, way in ((before, later, gap), (later, before, -gap)):
            expected = here[None] + way * steps[:, None]  # (S, A, 2)
            apart = expected[:, :, None] - there  # (S, A, B, 2)
            square = (apart**2).sum(axis=3).min(axis=2) / deviation**2
            inside = ((expected >= low) & (expected <= high)).all(axis=2)
            agree += (inside * np.exp(-square / 2)).sum(axis=1)
            count += inside.sum(axis=1)
    return agree / count, count
