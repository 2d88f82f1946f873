"""Where droplets enter, leave and are missed, learned from the video.

A droplet that is lost at one place and a new one at another are the same, or one has left and
another has entered. Both have probabilities, which depend on the place and on the video.
"""

from dataclasses import dataclass, field, replace
from math import lgamma, log

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.tracking.droplet.noise import MIN_FALSE_DENSITY
from droptrack.tracking.droplet.tracks import Tracks

MAX_KEPT = 256  # of the last places of each kind
WIDTH = 0.5  # diameters, standard deviation of the kernel around a place
LEFT_INSIDE = 0.05  # probability that a lost droplet has left, before any was lost
LEFT_OUTSIDE = 0.5  # the same, if it goes out of the region where droplets are seen
FIRST_MISSED = 0.5  # boxes missed, of so many droplets in view, before any is counted
FIRST_IN_VIEW = 50.0
FIRST_GAPS = (1, 2)  # gaps and their length in images, before any is seen
ANY_SIZE = 0.4  # standard deviation of the logarithm of width and height, before any is known
MIN_SIZES = 2  # droplets that make a spread
FIRST_SIZES = 1.0  # droplets for which ANY_SIZE counts


def _none() -> Floats:
    return np.zeros((0, 2))


@dataclass(frozen=True, kw_only=True)
class Passages:
    """Places (K, 2) px, and how long gaps were."""

    entered: Floats = field(default_factory=_none)  # where droplets were first seen
    left: Floats = field(default_factory=_none)  # where they were last seen
    resumed: Floats = field(default_factory=_none)  # where they were lost and seen again after
    sizes: Floats = field(default_factory=_none)  # logarithms of width and height
    n_entered: int = 0
    n_left_inside: int = 0  # of those that left, such as were in the middle of the region
    n_images: int = 0
    n_seen: int = 0  # boxes of droplets
    n_gaps: int = FIRST_GAPS[0]
    gap_images: int = FIRST_GAPS[1]
    low: Floats = field(default_factory=lambda: np.full(2, np.inf))  # corner of the region
    high: Floats = field(default_factory=lambda: np.full(2, -np.inf))  # where droplets are seen

    def with_image(self, n_seen: int) -> "Passages":
        """One image on, with so many droplets."""
        passages = object.__new__(Passages)  # `replace` takes ten times as long
        n_images, n_seen = self.n_images + 1, self.n_seen + n_seen
        vars(passages).update(vars(self), n_images=n_images, n_seen=n_seen)
        return passages

    @property
    def miss_rate(self) -> float:
        """The share of droplets in view that are not seen."""
        missed = self.gap_images - FIRST_GAPS[1]
        return (missed + FIRST_MISSED) / (missed + self.n_seen + FIRST_IN_VIEW)

    def entering(self, tracks: Tracks, entered: Bools) -> "Passages":
        """With new droplets, some of which (N,) entered after the first frame."""
        places = tracks.first_position[entered]
        return replace(
            self,
            entered=_with(self.entered, places),
            sizes=_with(self.sizes, tracks.log_sizes),
            n_entered=self.n_entered + len(places),
        )

    def leaving(self, tracks: Tracks) -> "Passages":
        """With droplets that were not seen again."""
        inside = self._inside(tracks.state.position)
        return replace(
            self,
            left=_with(self.left, tracks.last_position),
            n_left_inside=self.n_left_inside + int(inside.sum()),
        )

    def resuming(self, places: Floats, gaps: Rows) -> "Passages":
        """With droplets seen again that were lost at places (K, 2) for some images (K,)."""
        return replace(
            self,
            resumed=_with(self.resumed, places),
            n_gaps=self.n_gaps + len(gaps),
            gap_images=self.gap_images + int(gaps.sum()),
        )

    def seeing(self, places: Floats) -> "Passages":
        """With droplets that are seen at places (N, 2)."""
        return replace(
            self,
            low=np.minimum(self.low, places.min(axis=0, initial=np.inf)),
            high=np.maximum(self.high, places.max(axis=0, initial=-np.inf)),
        )

    def probability_inside(self, distance: float) -> float:
        """That a droplet is seen last, or first, within a distance (px) of somewhere inside."""
        share = (self.n_left_inside + LEFT_INSIDE) / (len(self.left) + 1)
        length = float(np.hypot(*(self.high - self.low)))
        return share * min(1.0, distance / length) if 0 < length < np.inf else 1.0

    def log_odds_of_leaving(self, places: Floats, ahead: Floats, diameters: Floats) -> Floats:
        """Logarithm of the odds (N,) that droplets lost at places (N, 2) have left.

        `ahead` (N, 2): where they would be now.
        """
        left_inside = (self.n_left_inside + LEFT_INSIDE) / (self.n_left_inside + self.n_gaps)
        before = np.where(self._inside(ahead), left_inside, LEFT_OUTSIDE)
        left = _kernel_sum(self.left, places, diameters) + before
        back = _kernel_sum(self.resumed, places, diameters) + 1 - before
        return np.asarray(np.log(left / back))

    def log_density_of_entering(self, places: Floats, diameters: Floats) -> Floats:
        """Logarithm of new droplets (N,) an image and squared diameter at places (N, 2)."""
        share = self.n_entered / max(len(self.entered), 1) / max(self.n_images, 1)
        density = _kernel_sum(self.entered, places, diameters) / (2 * np.pi * WIDTH**2)
        return np.asarray(np.log(density * share + MIN_FALSE_DENSITY))

    def log_probability_of_gap(self, images: Rows) -> Floats:
        """Logarithm of the probability that a gap is as long (N,), to that of one image.

        Most gaps are as short as others were, but some last: the distribution has a long tail.
        """
        mean = self.gap_images / self.n_gaps
        return np.asarray(-np.log1p(np.maximum(images - 1, 0) / mean))

    def _inside(self, places: Floats) -> Bools:
        """Whether places (N, 2) are in the region."""
        return np.asarray(((places >= self.low) & (places <= self.high)).all(axis=1))

    @property
    def size_variance(self) -> Floats:
        """Of the logarithms of width and height (2,) of all droplets."""
        n = len(self.sizes)
        if n < MIN_SIZES:
            return np.full(2, ANY_SIZE**2)
        squares = ((self.sizes - self.sizes.mean(axis=0)) ** 2).sum(axis=0)
        return np.asarray((squares + FIRST_SIZES * ANY_SIZE**2) / (n - 1 + FIRST_SIZES))

    def evidence_of_size(self, log_sizes: Floats, deviation: float) -> Floats:
        """2 log likelihood ratio (N,) of sizes (N, 2): of a droplet, to any box.

        Of n droplets, the next one's size has Student's distribution with n - 1 degrees of freedom.
        `deviation`: of a box's size from its droplet's.
        """
        n = len(self.sizes)
        if n < MIN_SIZES:
            return np.zeros(len(log_sizes))
        variance = np.minimum(self.sizes.var(axis=0, ddof=1) + deviation**2, ANY_SIZE**2)
        variance *= 1 + 1 / n
        square, free = (log_sizes - self.sizes.mean(axis=0)) ** 2, n - 1
        peak = lgamma(n / 2) - lgamma(free / 2) - log(free / 2) / 2
        ratio = np.log(ANY_SIZE**2 / variance) + 2 * peak + square / ANY_SIZE**2
        ratio -= n * np.log1p(square / variance / free)
        return np.asarray(ratio.sum(axis=1))

    def evidence_of_mean_size(self, deviation: float) -> float:
        """About the same of a box as large as droplets are; little while few are known."""
        variance = np.minimum(self.size_variance + deviation**2, ANY_SIZE**2)
        return float(np.log(ANY_SIZE**2 / variance).sum())


def _with(places: Floats, more: Floats) -> Floats:
    return np.concatenate([places, more])[-MAX_KEPT:]


def _kernel_sum(places: Floats, at: Floats, diameters: Floats) -> Floats:
    """Sum (N,) of the kernels around places (K, 2) at others (N, 2)."""
    square = ((at[:, None] - places) ** 2).sum(axis=2) / (WIDTH * diameters[:, None]) ** 2
    return np.asarray(np.exp(-square / 2).sum(axis=1))
