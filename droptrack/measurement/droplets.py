"""Frame and boxes -> all that is measured of the droplets: centre of mass, outline, size, shape."""

from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Bools, Floats
from droptrack.data.frames import Frame
from droptrack.data.region import Region
from droptrack.measurement import centre_of_mass, closed_paths, outlines, rays, rings
from droptrack.measurement.centre_of_mass import centres_and_levels, grey_of
from droptrack.measurement.droplet_outlines import EDGE_PX, find_outlines
from droptrack.measurement.rays import DIRECTIONS, N_RAYS
from droptrack.measurement.shapes import (
    AT_EDGE,
    COLUMNS,
    OUTLINE_SEEN,
    measure_shapes,
    whole_circles,
)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What is known of N droplets.

    centres (N, 2) px: of mass where `measured` (N,), else the box's, or of the whole droplet that
    the image cuts; boxes (N, 4): of the outline, else those given; shapes (N, len(COLUMNS)): by
    their names in COLUMNS, NaN where they were not measured, or (N, 0); outlines (N, N_RAYS, 2) px:
    the places of the edges, where there are sizes, gaps bridged, else NaN, or (N, 0, 2); rings
    (N,): whether these are the outsides of rings.
    """

    centres: Floats
    measured: Bools
    boxes: Floats
    shapes: Floats
    outlines: Floats
    rings: Bools


def load_loops() -> None:
    """Load the compiled loops beforehand."""
    centre_of_mass.load_loops()
    closed_paths.load_loops()
    outlines.load_loops()
    rays.load_loops()
    rings.load_loops()


def measure_droplets(
    frame: Frame, boxes: Floats, *, shape: bool = True, region: Region | None = None
) -> Measured:
    """Measure the droplets in boxes (N, 4) px of a frame (H, W, 3); without `shape` no outlines.

    `region`: what is to be seen of the frame; droplets that reach beyond it are cut, as by the
    image's edge. None: all of it.

    A disc of 20 px, whose box is a little off:

    >>> from droptrack.data.frames import grey_frame
    >>> y, x = np.mgrid[:60, :60] + 0.5
    >>> level = 255 * np.clip(10.5 - np.hypot(x - 30.3, y - 29.8), 0, 1)
    >>> found = measure_droplets(grey_frame(level.astype(np.uint8)), np.array([[31.0, 29, 21, 19]]))
    >>> dict(zip(COLUMNS, found.shapes[0].round(1).tolist()))["diameter_px"]
    20.0
    """
    grey = grey_of(frame)
    centres, measured, levels = centres_and_levels(grey, boxes)
    if not shape:
        nothing = np.zeros((len(boxes), 0, 2))
        return Measured(
            centres=centres,
            measured=measured,
            boxes=boxes,
            shapes=nothing[..., 0],
            outlines=nothing,
            rings=np.zeros(len(boxes), bool),
        )
    found = find_outlines(grey, boxes, centres, levels, region)
    traced = found.traced
    shapes = np.full((len(boxes), len(COLUMNS)), np.nan)
    quantities, middles, edges = measure_shapes(centres, found.whole)
    shapes[found.fits, :OUTLINE_SEEN] = quantities[found.fits]
    shapes[:, OUTLINE_SEEN] = found.seen.mean(axis=1)
    ends_at_edge = at_edge(boxes, (grey.shape[1], grey.shape[0]), region)
    # rays that leave the image before they meet an edge tell; the box, where no edge is seen at all
    cut = np.where(found.seen.any(axis=1), found.cut, ends_at_edge)
    shapes[cut, :OUTLINE_SEEN] = np.nan
    shapes[:, AT_EDGE] = cut
    good = found.fits & ~cut
    ringed = good & (traced.rings | ~measured)
    centres[ringed] = middles[ringed]
    measured |= ringed
    if cut.any():
        rows = np.flatnonzero(cut)
        circles = whole_circles(traced[rows], boxes[rows])
        told = np.isfinite(circles[:, 0])
        centres[rows[told]] = circles[told]
        measured = measured & ~cut
    return Measured(
        centres=centres,
        measured=measured,
        boxes=np.where(good[:, None], found.boxes, boxes),
        shapes=shapes,
        outlines=np.where(good[:, None, None], edges, np.nan),
        rings=good & traced.rings,
    )


def at_edge(boxes: Floats, size: tuple[int, int], region: Region | None = None) -> Bools:
    """Whether boxes (N, 4) px end at the edge of an image of a size, so that droplets are cut.

    Or the ellipses in them reach beyond a region.

    >>> at_edge(np.array([[50.0, 50, 20, 20], [9.5, 50, 20, 20]]), (100, 100)).tolist()
    [False, True]
    """
    low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
    cut = (low < EDGE_PX).any(axis=1) | (high > np.array(size) - EDGE_PX).any(axis=1)
    if region is not None:
        ends = boxes[:, None, :2] + (boxes[:, None, 2:] / 2 + EDGE_PX) * DIRECTIONS
        cut |= ~region.contains(ends.reshape(-1, 2)).reshape(-1, N_RAYS).all(axis=1)
    return np.asarray(cut)
