"""Where droplets may be: the image, a region in it, or a periodic box."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, zoom
from scipy.signal import fftconvolve

from droptrack.data.arrays import Bools, Floats
from droptrack.data.region import Region
from droptrack.errors import DroptrackError

MAX_SIDE = 400  # cells of the grid on which a window is laid over itself
DIRECTIONS = 64


@dataclass(frozen=True, kw_only=True)
class Window:
    """An image of a size, px; the region of it, if there is one; whether it is a periodic box."""

    size: tuple[int, int]
    region: Region | None = None
    periodic: bool = False

    @property
    def area(self) -> float:
        """The area, px²."""
        if self.region is not None:
            return float(self.region.mask.sum())
        return float(self.size[0] * self.size[1])

    @property
    def treated(self) -> str:
        """How its boundary is treated, for people."""
        if self.periodic:
            return "periodic"
        return "open: the image" if self.region is None else "open: the region that was given"

    def contains(self, points: Floats) -> Bools:
        """Whether points (N, 2) px lie in it, (N,)."""
        if self.periodic:
            return np.ones(len(points), bool)
        if self.region is not None:
            return self.region.contains(points)
        return np.asarray(((points >= 0) & (points <= self.size)).all(axis=1))

    def distance_share(self, edges: Floats) -> Floats:
        """The share (B,) of pairs of places at random in it that are edges (B + 1,) px apart.

        From the window's overlap with itself, moved by r: J. Ohser and D. Stoyan (1981). In a
        periodic box nothing is cut off.

        >>> Window(size=(100, 50), periodic=True).distance_share(np.array([0.0, 10])).round(4)
        array([0.0628])
        """
        middles, widths = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
        overlap = self.area if self.periodic else self._overlap(middles)
        return np.asarray(2 * np.pi * middles * widths * overlap / self.area**2)

    def _overlap(self, distances: Floats) -> Floats:
        """Area (B,) px² of the window and itself moved by distances (B,), mean of directions."""
        mask = np.ones(self.size[::-1]) if self.region is None else self.region.mask.astype(float)
        cell = max(1.0, max(mask.shape) / MAX_SIDE)
        if cell > 1:
            mask = np.clip(zoom(mask, 1 / cell, order=1, grid_mode=True, mode="nearest"), 0, 1)
        heights, widths = (full / n for full, n in zip(self.size[::-1], mask.shape, strict=True))
        laid = fftconvolve(mask, mask[::-1, ::-1]) * heights * widths
        laid *= self.area / laid.max()
        angles = (np.arange(DIRECTIONS) + 0.5) * 2 * np.pi / DIRECTIONS
        rows = mask.shape[0] - 1 + np.outer(distances, np.sin(angles)) / heights
        columns = mask.shape[1] - 1 + np.outer(distances, np.cos(angles)) / widths
        return np.asarray(map_coordinates(laid, [rows, columns], order=1).mean(axis=1))


def window_of(region: str | None, size: tuple[int, int], *, periodic: bool) -> Window:
    """The window that options say; raises DroptrackError where they contradict each other."""
    if region is None:
        return Window(size=size, periodic=periodic)
    if periodic:
        raise DroptrackError("give --region or --periodic, not both")
    return Window(size=size, region=Region.read(region, *size))
