"""Sums over all frames of what is measured in each: cells, neighbours, order, rearrangements."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from droptrack.analysis.structure.cells import Cells, cells_of
from droptrack.analysis.structure.order import hexatic_order, n_neighbours
from droptrack.analysis.structure.rearrangements import NeighbourChanges, Rearrangement
from droptrack.analysis.structure.window import Window
from droptrack.analysis.tables import diameters, droplet_areas
from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.formats.table import Table
from droptrack.progress import with_progress

MOST_NEIGHBOURS = 12
FRACTION_BINS = 40  # of local area fractions, 0 to 1.2
MOST_FRACTION = 1.2


@dataclass(frozen=True, kw_only=True)
class FrameSums:
    """Of each of N droplets, over the frames in which it is inner, (N,) each; of each of F frames.

    ids (N,), owners (M,): which of the N each row of the table is of. inner: in how many frames;
    lonely: without neighbours; order, order_weighted: sums of |psi_6|; neighbours; with_neighbours
    (N, 13): frames with so many; droplet_area, cell_area, px², where both are known, in `sized`
    frames; fractions (N, 40): of local area fractions. in_window: frames with the centre in it.
    """

    ids: Rows
    owners: Rows
    frames: Rows
    inner: Floats
    lonely: Floats
    in_window: Floats
    order: Floats
    order_weighted: Floats
    neighbours: Floats
    with_neighbours: Floats
    droplet_area: Floats
    cell_area: Floats
    sized: Floats
    fractions: Floats
    inner_of_frame: Floats
    order_of_frame: Floats
    global_order: Floats
    events: Sequence[Rearrangement]
    n_flips: int


def sum_frames(table: Table, window: Window, reach: float, persistence: int) -> FrameSums:
    """Measure every frame of a table."""
    rows = table.rows
    ids, owners = np.unique(rows.track_id, return_inverse=True)
    frames, starts = np.unique(rows.frame, return_index=True)
    places = np.column_stack([rows.x, rows.y])
    n, sums = len(ids), _Sums(len(ids), len(frames))
    radii, areas = diameters(table) / 2, droplet_areas(table)
    changes = NeighbourChanges(persistence, window.size if window.periodic else None)
    stops = [*starts[1:].tolist(), len(rows)]
    for f, stop in enumerate(with_progress(stops, len(stops), "cells", "frames")):
        part = slice(int(starts[f]), stop)
        cells = cells_of(places[part], radii[part], window, reach)
        changes.add(
            int(frames[f]), owners[part].astype(np.int64), places[part], (cells.first, cells.second)
        )
        sums.add(f, owners[part], cells, areas[part])
    inside = window.contains(places)
    return FrameSums(
        ids=ids, owners=owners, frames=frames, inner=sums.inner, lonely=sums.lonely,
        in_window=np.bincount(owners[inside], minlength=n).astype(float), order=sums.order,
        order_weighted=sums.order_weighted,
        neighbours=sums.with_neighbours @ np.arange(MOST_NEIGHBOURS + 1.0),
        with_neighbours=sums.with_neighbours, droplet_area=sums.droplet_area,
        cell_area=sums.cell_area, sized=sums.sized, fractions=sums.fractions,
        inner_of_frame=sums.inner_of_frame, order_of_frame=sums.order_of_frame,
        global_order=sums.global_order, events=_within(changes.found(), window),
        n_flips=changes.n_flips,
    )  # fmt: skip


def _within(events: Sequence[Rearrangement], window: Window) -> list[Rearrangement]:
    places = np.array([[one.x, one.y] for one in events]).reshape(-1, 2)
    return [one for one, inside in zip(events, window.contains(places), strict=True) if inside]


class _Sums:
    """What `FrameSums` has of droplets and frames, while it grows."""

    def __init__(self, n: int, n_frames: int) -> None:
        self.inner, self.lonely, self.order, self.order_weighted = np.zeros((4, n))
        self.droplet_area, self.cell_area, self.sized = np.zeros((3, n))
        self.with_neighbours = np.zeros((n, MOST_NEIGHBOURS + 1))
        self.fractions = np.zeros((n, FRACTION_BINS))
        self.inner_of_frame = np.zeros(n_frames)
        self.order_of_frame, self.global_order = np.full((2, n_frames), np.nan)

    def add(self, f: int, owners: Rows, cells: Cells, areas: Floats) -> None:
        """The cells of one frame, whose droplets (K,) have areas (K,) px²."""
        inner = cells.inner
        who = owners[inner]
        self.inner[who] += 1
        self.inner_of_frame[f] = inner.sum()
        count = np.minimum(n_neighbours(cells)[inner], MOST_NEIGHBOURS)
        self.with_neighbours[who, count] += 1
        order = hexatic_order(cells)[inner]
        known = np.isfinite(order)
        self.lonely[who[~known]] += 1
        self.order[who[known]] += np.abs(order[known])
        weighted = hexatic_order(cells, weighted=True)[inner]
        self.order_weighted[who[known]] += np.abs(weighted[known])
        if known.any():
            self.order_of_frame[f] = np.abs(order[known]).mean()
            self.global_order[f] = np.abs(order[known].mean())
        self._add_areas(who, cells.areas[inner], areas[inner])

    def _add_areas(self, who: Rows, cells: Floats, droplets: Floats) -> None:
        known: Bools = np.isfinite(cells) & np.isfinite(droplets) & (cells > 0)
        who, cells, droplets = who[known], cells[known], droplets[known]
        self.sized[who] += 1
        self.droplet_area[who] += droplets
        self.cell_area[who] += cells
        bins = (droplets / cells / MOST_FRACTION * FRACTION_BINS).astype(np.int64)
        self.fractions[who, np.minimum(bins, FRACTION_BINS - 1)] += 1
