"""What every analysis takes from a table: rows that count, and sizes."""

import math

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.formats.table import Table
from droptrack.data.trajectories import Trajectories
from droptrack.errors import DroptrackError


def kept_rows(rows: Trajectories) -> Bools:
    """Which rows (M,) are places that were seen: not bridged, nor cut by the image's edge."""
    return np.asarray(rows.observed & ~at_edge(rows))


def at_edge(rows: Trajectories) -> Bools:
    """Which rows (M,) are of droplets that the image cuts, where the table says so."""
    return np.asarray(rows.columns.get("at_edge", np.zeros(len(rows))) == 1)


def droplet_medians(table: Table, values: Floats) -> tuple[Rows, Floats]:
    """Identities (N,) and the median (N,) of each droplet's values (M,); NaN without any.

    Of rows that are kept.
    """
    rows = table.rows
    some = np.flatnonzero(kept_rows(rows) & np.isfinite(values))
    order = some[np.lexsort((values[some], rows.track_id[some]))]
    ids, start, count = np.unique(rows.track_id[order], return_index=True, return_counts=True)
    low, high = start + (count - 1) // 2, start + count // 2
    medians = (values[order][low] + values[order][high]) / 2
    return ids, np.asarray(medians)


def diameters(table: Table) -> Floats:
    """Diameters (M,) px, NaN where no size is known."""
    found = table.diameters()
    return np.where(found > 0, found, np.nan)


def droplet_areas(table: Table) -> Floats:
    """Areas (M,) px²: of the outline where it was measured, else of an ellipse in the box."""
    boxes = table.rows.boxes
    of_boxes = np.pi / 4 * boxes[:, 2] * boxes[:, 3]
    measured = table.column("area_px2")
    areas = of_boxes if measured is None else np.where(np.isfinite(measured), measured, of_boxes)
    return np.where(areas > 0, areas, np.nan)


def typical_diameter(table: Table) -> float:
    """The median of the droplets' median diameters, px; NaN where no sizes are known."""
    _, medians = droplet_medians(table, diameters(table))
    return float(np.median(medians)) if len(medians) else float("nan")


def neighbourhood_radius(
    radius_px: float | None, radius_diameters: float | None, diameter: float, default: float
) -> float:
    """The radius, px, that two options give, else `default` diameters; NaN where none is known.

    Raises DroptrackError for both options, and for what is not above 0.
    """
    if radius_px is not None and radius_diameters is not None:
        raise DroptrackError("give --radius or --radius-diameters, not both")
    for option, value in (("--radius", radius_px), ("--radius-diameters", radius_diameters)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise DroptrackError(f"{option} {value:g}: should be above 0")
    if radius_px is not None:
        return radius_px
    return (radius_diameters or default) * diameter


def frame_notes(table: Table) -> list[str]:
    """What is to be said of a table without any two frames in a row."""
    frames = np.unique(table.rows.frame)
    apart = int(np.diff(frames).min()) if len(frames) > 1 else 1
    if apart == 1:
        return []
    return [
        f"No two frames in a row: they are at least {apart} apart. Steps, headings and velocities "
        "are from one frame to the next, so there are none; number the frames 0, 1, 2."
    ]


def jump_notes(table: Table, steps: Floats) -> list[str]:
    """What is to be said of steps (S, 2) px that nothing makes."""
    long = np.abs(steps) > np.array(table.size) / 2  # false for NaN
    if not long.any():
        return []
    return [
        f"{int(long.any(axis=1).sum())} steps are longer than half the image: positions in a "
        "periodic box have to be unwrapped before."
    ]
