"""The analysis ``structure``: quantities, figures and tables."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.bootstrap import ratio, ratio_and_error, resampled, standard_error
from droptrack.analysis.neighbourhoods import some_frames
from droptrack.analysis.records import AREA, LENGTH, RATE, Analysis, Quantity
from droptrack.analysis.structure.cells import cells_of
from droptrack.analysis.structure.figures import Correlation, figures_of
from droptrack.analysis.structure.frames import FrameSums, sum_frames
from droptrack.analysis.structure.order import hexatic_order, n_neighbours
from droptrack.analysis.structure.pair_correlation import pair_counts
from droptrack.analysis.structure.rearrangements import per_droplet, rows_of
from droptrack.analysis.structure.window import Window, window_of
from droptrack.analysis.tables import droplet_areas, typical_diameter
from droptrack.data.formats.table import Table
from droptrack.errors import DroptrackError

DEFAULT_REACH = 1.5
DEFAULT_PERSISTENCE = 3
PAIR_FRAMES = 200  # from which g(r) is taken, evenly over all
PAIR_BINS = 100
PAIR_REACH = 5.0  # diameters
AT_RANDOM = 2000  # points, of the null model
HEXAGONAL = np.pi / np.sqrt(12)  # area fraction of equal discs in a hexagonal lattice


@dataclass(frozen=True, kw_only=True)
class StructureConfig:
    """Options of the analysis.

    region: see `data.region.Region.read`; periodic: the image is a box; reach: neighbours are at
    most so many mean diameters apart; persistence: frames that a change of neighbours lasts.
    """

    region: str | None = None
    periodic: bool = False
    reach: float = DEFAULT_REACH
    persistence: int = DEFAULT_PERSISTENCE
    seed: int = 0


def analyse_structure(table: Table, config: StructureConfig) -> Analysis:
    """How droplets are arranged; raises DroptrackError for options that cannot be."""
    if not config.reach > 0:
        raise DroptrackError(f"--reach {config.reach:g}: should be above 0")
    if config.persistence < 1:
        raise DroptrackError(f"--persistence {config.persistence}: should be at least 1 frame")
    window = window_of(config.region, table.size, periodic=config.periodic)
    rng = np.random.default_rng(config.seed)
    sums = sum_frames(table, window, config.reach, config.persistence)
    correlation = _correlation(table, window, sums, rng)
    quantities = [
        *_order(sums, rng),
        *_areas(table, window, sums, rng),
        *_peak(correlation),
        _rate(sums, config.persistence, rng),
    ]
    inside = int(sums.in_window.sum())
    if not inside:
        why = "no droplet is in the region"
        quantities = [_nowhere(one, why) for one in quantities]
    return Analysis(
        title="Structure",
        about=_about(window, config),
        settings={
            **table.about,
            "boundary": window.treated,
            "window_area_px2": window.area,
            "reach_mean_diameters": config.reach,
            "persistence_frames": config.persistence,
            "diameter_px": typical_diameter(table),
            "seed": config.seed,
        },
        counts={
            "n_droplets": len(sums.ids),
            "n_frames": len(sums.frames),
            "n_in_window": inside,
            "n_inner": int(sums.inner.sum()),
            "n_t1": len(sums.events),
            "n_t1_without_persistence": sums.n_flips,
        },
        quantities=quantities,
        figures=figures_of(table, window, config.reach, sums, correlation, rng),
        tables={"t1": rows_of(sums.events, sums.ids)},
        notes=_notes(table, window),
    )


def _about(window: Window, config: StructureConfig) -> str:
    boundary = (
        "The image is a periodic box."
        if window.periodic
        else "The boundary is open: a droplet is inner, and counts for cells, neighbours and order,"
        " where its whole cell lies in the window and all droplets around it are within reach; "
        "those at walls and at the rim of a cloud are left out."
    )
    return (
        "Neighbours share an edge of their radical Voronoi cells and are at most "
        f"{config.reach:g} mean diameters of the two apart, from centre to centre. {boundary} "
        f"Window: {window.treated}. Bridged rows and droplets cut by the image are places here, "
        "too: without them, others would seem to be neighbours."
    )


def _nowhere(one: Quantity, why: str) -> Quantity:
    return Quantity(
        stem=one.stem, label=one.label, value=float("nan"), definition=one.definition,
        null=one.null, null_model=one.null_model, dimension=one.dimension, reason=why,
    )  # fmt: skip


def _at_random(rng: np.random.Generator) -> tuple[float, float, float]:
    """Mean |psi_6|, the same weighted, and the share with six neighbours, of points at random."""
    window = Window(size=(1000, 1000), periodic=True)
    places = rng.uniform(0, 1000, (AT_RANDOM, 2))
    cells = cells_of(places, np.full(AT_RANDOM, np.nan), window)
    plain, weighted = (hexatic_order(cells, weighted=one) for one in (False, True))
    six = np.mean(n_neighbours(cells) == 6)
    return float(np.abs(plain).mean()), float(np.abs(weighted).mean()), float(six)


def _order(sums: FrameSums, rng: np.random.Generator) -> list[Quantity]:
    random = _at_random(rng)
    inner = sums.inner
    above = np.column_stack(
        [sums.order, sums.order_weighted, sums.neighbours, sums.with_neighbours[:, 6]]
    )
    ordered = inner - sums.lonely
    below = np.column_stack([ordered, ordered, inner, inner])
    value, error = ratio_and_error(above, below, rng)
    reason = "" if inner.sum() else "no droplet is inner: each is at the rim, or has none near"
    chance = "points at random (Poisson)"
    rows = (
        ("psi6", "Hexatic order |psi_6|", "mean over inner droplets of |mean over the neighbours "
         "of exp(6 i theta)|", random[0]),
        ("psi6_weighted", "Hexatic order, weighted by edges", "the same, neighbours weighted by "
         "the lengths of the edges that they share", random[1]),
        ("neighbours", "Number of neighbours", "of inner droplets, mean", 6.0),
        ("share_six_neighbours", "Share with six neighbours", "of inner droplets", random[2]),
    )  # fmt: skip
    found = [
        Quantity(
            stem=stem, label=label, value=float(value[k]), error=float(error[k]), null=null,
            null_model=chance, definition=definition, reason=reason,
        )
        for k, (stem, label, definition, null) in enumerate(rows)
    ]  # fmt: skip
    known = np.isfinite(sums.global_order)
    n = sums.inner_of_frame[known]
    found.append(
        Quantity(
            stem="psi6_global", label="Global hexatic order",
            value=float(sums.global_order[known].mean()) if known.any() else float("nan"),
            null=float(np.sqrt(np.pi / (4 * n)).mean() * random[0]) if known.any() else np.nan,
            null_model="independent directions of psi_6, as long as those of points at random",
            definition="|mean of psi_6 over the inner droplets of a frame|, mean over frames: 1 "
            "for one crystal; no error: all droplets are in each value", reason=reason,
        )
    )  # fmt: skip
    return found


def _areas(
    table: Table, window: Window, sums: FrameSums, rng: np.random.Generator
) -> list[Quantity]:
    areas = droplet_areas(table)
    known = np.isfinite(areas)
    n, frames = len(sums.ids), len(sums.frames)
    pieces = np.column_stack([sums.droplet_area, sums.cell_area])
    below = np.column_stack([sums.cell_area, sums.sized])
    value, error = ratio_and_error(pieces, below, rng)
    why = "the trajectories have no sizes of droplets" if not known.any() else ""
    no_cell = why or ("" if sums.sized.any() else "no droplet is inner")
    local = Quantity(
        stem="local_area_fraction", label="Area fraction in the cells", value=float(value[0]),
        error=float(error[0]), null=float(HEXAGONAL), null_model="equal discs in a hexagonal "
        "lattice, the densest", definition="areas of inner droplets over areas of their cells",
        reason=no_cell,
    )  # fmt: skip
    cell = Quantity(
        stem="cell_area", label="Area of a cell", value=float(value[1]), error=float(error[1]),
        dimension=AREA, definition="radical Voronoi cells of inner droplets, mean",
        reason=no_cell,
    )  # fmt: skip
    inside = window.contains(np.column_stack([table.rows.x, table.rows.y])) & known
    each = np.bincount(sums.owners[inside], areas[inside], n).astype(float)[:, None]
    share = np.full((n, 1), frames * window.area / n)
    fraction = Quantity(
        stem="packing_fraction", label="Packing fraction of the window",
        value=float(ratio(each, share)[0]) if inside.any() else float("nan"),
        error=float(standard_error(resampled(each, share, rng))[0]),
        null=float(HEXAGONAL), null_model="equal discs in a hexagonal lattice",
        definition="areas of the droplets whose centres are in the window over its area, mean over "
        "frames", reason=why,
    )  # fmt: skip
    return [local, cell, fraction]


def _correlation(
    table: Table, window: Window, sums: FrameSums, rng: np.random.Generator
) -> Correlation:
    rows = table.rows
    diameter = typical_diameter(table)
    if not diameter > 0:
        diameter = float(np.sqrt(window.area * len(sums.frames) / max(len(rows), 1)))
    reach = min(PAIR_REACH * diameter, min(window.size) / 2)
    edges = np.linspace(0, reach, PAIR_BINS + 1)
    some = some_frames(rows.frame, PAIR_FRAMES)
    places = np.column_stack([rows.x, rows.y])[some]
    counts, chance = pair_counts(
        rows.frame[some], places, sums.owners[some], window, edges, len(sums.ids)
    )
    value, error = ratio_and_error(counts, chance, rng)
    return Correlation(middles=(edges[1:] + edges[:-1]) / 2, values=value, errors=error)


def _peak(of: Correlation) -> list[Quantity]:
    """The highest value of g(r), and where it is."""
    known = np.isfinite(of.values).any() and np.nanmax(of.values) > 0
    k = int(np.nanargmax(of.values)) if known else 0
    reason = "" if known else "no two droplets are near each other in a frame"
    place, height = (float(of.middles[k]), float(of.values[k])) if known else (np.nan, np.nan)
    return [
        Quantity(
            stem="pair_correlation_peak", label="Highest value of g(r)", value=height,
            error=float(of.errors[k]) if known else float("nan"), null=1.0,
            null_model="places at random in the same window",
            definition="pairs of droplets of a frame at a distance, over those of as many places "
            "at random in the same window", reason=reason,
        ),
        Quantity(
            stem="pair_correlation_peak_distance", label="Distance of that", value=place,
            dimension=LENGTH, definition="the middle of the bin", reason=reason,
        ),
    ]  # fmt: skip


def _rate(sums: FrameSums, persistence: int, rng: np.random.Generator) -> Quantity:
    events = per_droplet(sums.events, len(sums.ids))[:, None]
    present = sums.in_window[:, None]
    long = len(sums.frames) > 2 * persistence
    reason = "" if long else f"needs more than {2 * persistence} frames"
    if not sums.inner.any() and not sums.n_flips:
        reason = "no droplet is inner, and none changes its neighbours"
    value, error = ratio_and_error(events, present, rng)
    return Quantity(
        stem="t1_rate", label="T1 events of a droplet",
        value=float("nan") if reason else float(value[0]),
        error=float("nan") if reason else float(error[0]), null=0.0, dimension=RATE,
        null_model="an affine motion; noise makes changes that do not last",
        definition="T1 events, changes of neighbours among four droplets in the window, before and "
        f"after which the pairs stay as they are for at least {persistence} frames, over droplets "
        "and frames",
        reason=reason,
    )  # fmt: skip


def _notes(table: Table, window: Window) -> list[str]:
    notes = []
    if "px" not in table.about.get("video", "") and window.region is None:
        width, height = table.size
        notes.append(
            f"The file does not say how large the image is: {width} x {height} px, as the droplets "
            "reach, is the window; --size says it."
        )
    return notes
