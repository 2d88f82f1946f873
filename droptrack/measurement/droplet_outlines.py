"""Boxes -> the outlines of the droplets in them, without what is another thing's edge.

First ray by ray. Where that leaves gaps too wide, an outline that bends inwards, or one that is not
like its box, as where some rays go on to a channel's wall, all rays together tell how far each may
go (`closed_paths`), and what lies within is looked at once more.
"""

from dataclasses import dataclass, replace

import numpy as np

from droptrack.data.arrays import Bools, Floats, Pixels, Rows
from droptrack.data.region import Region
from droptrack.measurement.centre_of_mass import nearest_boxes
from droptrack.measurement.outlines import Outlines, look_for_edges, look_nearer, trace_outlines
from droptrack.measurement.rays import DIRECTIONS, FREE
from droptrack.measurement.shapes import (
    corners,
    outline_boxes,
    smooth_outlines,
    without_outliers,
)

MAX_RATIO = 1.3  # of the sizes of an outline's box and the detector's, either way
MAX_RATIO_BENT = 1.15  # of their sides, where an outline is not smooth
MAX_APART = 0.25  # of their centres, in sides of the box
SHARP = np.radians(60.0)  # a corner from which on an outline may have changed over to another edge:
MAX_OFF_SHARP = 0.1  # then none of its sides may be off the box by more, in units of its size
MIN_FREE = 0.25  # share of rays that no neighbour ends, where an outline may be looked at again
EDGE_PX = 1.0  # a box that ends nearer to the image's edge is cut by it


@dataclass(frozen=True, kw_only=True)
class Found:
    """The outlines of N droplets.

    traced: what was seen; whole (N, N_RAYS) px: the radii with gaps bridged, NaN where that may not
    be done; bent (N,): whether they bent inwards sharply before they were smoothed; boxes (N, 4):
    of whole ones; fits (N,): whether these are like the detector's.
    """

    traced: Outlines
    whole: Floats
    bent: Bools
    boxes: Floats
    fits: Bools

    @property
    def seen(self) -> Bools:
        """Which edges (N, N_RAYS) were seen."""
        return np.asarray(np.isfinite(self.traced.radii))

    @property
    def cut(self) -> Bools:
        """Of which droplets (N,) rays leave what is to be seen before they meet an edge."""
        return np.asarray((self.traced.cut & ~self.seen).any(axis=1))

    def put(self, rows: Rows, others: "Found", their_rows: Rows) -> None:
        """Take the outlines of others in some rows."""
        for ours, theirs in (
            (self.traced.radii, others.traced.radii),
            (self.traced.cut, others.traced.cut),
            (self.traced.rings, others.traced.rings),
            (self.whole, others.whole),
            (self.bent, others.bent),
            (self.boxes, others.boxes),
            (self.fits, others.fits),
        ):
            ours[rows] = theirs[their_rows]


def find_outlines(
    grey: Pixels, boxes: Floats, centres: Floats, levels: Rows, region: Region | None
) -> Found:
    """The outlines of the droplets in boxes (N, 4) of a grey image (H, W).

    `centres` and `levels` are as of `centre_of_mass.centres_and_levels`; `region` is what is to be
    seen of the image.
    """
    search = look_for_edges(grey, boxes, centres, levels, nearest_boxes(boxes), region)
    free = (search.limits[..., 1] == FREE).mean(axis=1) >= MIN_FREE
    found = _judged(trace_outlines(grey, centres, levels, search), boxes, free, region)
    again = np.flatnonzero((~found.fits | found.bent) & free & ~found.cut)
    if len(again):
        search = look_nearer(grey, boxes, centres, levels, search, again)[again]
        traced = trace_outlines(grey, centres[again], levels[again], search)
        second = _judged(traced, boxes[again], free[again], region)
        better = np.flatnonzero(~found.fits[again] | (second.fits & ~second.bent))
        found.put(again[better], second, better)
    return found


def _judged(traced: Outlines, boxes: Floats, free: Bools, region: Region | None) -> Found:
    """Outlines without edges that stick out, jags, and edges at and beyond a region's border.

    A corner is odd where droplets stand `free` (N,), not between others.
    """
    radii, cut = without_outliers(traced.radii), traced.cut
    if region is not None:
        beyond = _beyond(replace(traced, radii=radii), boxes, region)
        radii, cut = np.where(beyond, np.nan, radii), cut | beyond
    radii, whole, good, bent = smooth_outlines(radii)
    outlined = outline_boxes(traced.origins, whole)
    return Found(
        traced=replace(traced, radii=radii, cut=cut),
        whole=whole,
        bent=bent,
        boxes=outlined,
        fits=good & _alike(outlined, boxes, bent, free & (corners(whole) > SHARP)),
    )


def _alike(outlined: Floats, boxes: Floats, bent: Bools, sharp: Bools) -> Bools:
    """Whether outlines' boxes (N, 4) are about as large as those given, and at their places.

    Of those that are `bent` (N,), the width and the height must each be about the same; of those
    with a `sharp` (N,) corner, as where one changes over to a wall's edge, each side's place.
    """
    ratios = outlined[:, 2:] / boxes[:, 2:]
    size = np.sqrt(ratios.prod(axis=1))
    alike = (size <= MAX_RATIO) & (size * MAX_RATIO >= 1)
    sides = (ratios <= MAX_RATIO_BENT) & (ratios * MAX_RATIO_BENT >= 1)
    near = np.abs(outlined[:, :2] - boxes[:, :2]) <= MAX_APART * boxes[:, 2:]
    off = np.abs(outlined[:, :2] - boxes[:, :2]) + np.abs(outlined[:, 2:] - boxes[:, 2:]) / 2
    there = off.max(axis=1) <= MAX_OFF_SHARP * np.sqrt(boxes[:, 2:].prod(axis=1))
    return np.asarray(alike & (sides.all(axis=1) | ~bent) & near.all(axis=1) & (there | ~sharp))


def _beyond(traced: Outlines, boxes: Floats, region: Region) -> Bools:
    """Which rays (N, K) leave a region before they meet an edge: where there is none, the box's."""
    share = np.abs(DIRECTIONS[None] / (boxes[:, None, 2:] / 2)).max(axis=2)
    reach = np.where(np.isfinite(traced.radii), traced.radii, 1 / share) + EDGE_PX
    ends = traced.origins[:, None] + reach[..., None] * DIRECTIONS
    return ~region.contains(ends.reshape(-1, 2)).reshape(reach.shape)
