"""The analysis ``size``: quantities and figures."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.bootstrap import ratio, ratio_and_error, resampled, standard_error
from droptrack.analysis.motion.velocities import profile
from droptrack.analysis.paths import Paths, paths_of
from droptrack.analysis.records import (
    LENGTH,
    TIME,
    Analysis,
    Axis,
    Chart,
    Curve,
    Figure,
    Quantity,
    Style,
)
from droptrack.analysis.tables import diameters, droplet_medians, kept_rows
from droptrack.data.arrays import Bools, Floats
from droptrack.data.formats.table import Table
from droptrack.data.report import Value

MAX_BINS = 40
ABOUT = (
    "A droplet's size is the median of its diameters over its frames: that of the circle of the "
    "outline's area where it was measured; of droplets never measured, sqrt(w h) of the box. "
    "Bridged rows and those of droplets that the image cuts are left out."
)


@dataclass(frozen=True, kw_only=True)
class SizeConfig:
    """The seed of the bootstrap."""

    seed: int = 0


def analyse_size(table: Table, config: SizeConfig) -> Analysis:
    """Sizes, how much they differ, and deformation."""
    rng = np.random.default_rng(config.seed)
    kept = kept_rows(table.rows)
    sizes, notes = _sizes_of_rows(table, kept)
    ids, medians = droplet_medians(table, sizes)
    paths = paths_of(table.rows, kept)
    stretch, deformation = _stretch(table), _deformation(table)
    found, charts = _deformations(table, paths, stretch, deformation, rng)
    noise = _noise(table, sizes)
    return Analysis(
        title="Size",
        about=ABOUT,
        settings={**table.about, "seed": config.seed},
        counts={
            "n_droplets": len(np.unique(table.rows.track_id)),
            "n_sized": len(medians),
            "n_excluded_bridged_or_at_edge": int((~kept).sum()),
        },
        quantities=[*_sizes(medians, noise, rng), *found],
        figures=[_histogram(medians, noise), *charts],
        notes=notes,
        tables={"droplets": _rows(table, ids.tolist(), medians.tolist())},
    )


def _sizes_of_rows(table: Table, kept: Bools) -> tuple[Floats, list[str]]:
    """Diameters (M,) px, those of boxes only of droplets that have no others; and what to say."""
    sizes, measured = diameters(table), table.column("diameter_px")
    known = np.zeros(len(sizes), bool) if measured is None else np.isfinite(measured)
    ids = table.rows.track_id
    sizes = np.where(~known & np.isin(ids, ids[known & kept]), np.nan, sizes)
    some = kept & np.isfinite(sizes)
    n_boxes = int((some & ~known).sum())
    note = (
        f"{n_boxes} of {int(some.sum())} sizes are those of boxes, as the outline was not measured "
        "in any frame of these droplets: a network's boxes are off by some per cent."
    )
    return sizes, [note] if n_boxes else []


def _sizes(medians: Floats, noise: float, rng: np.random.Generator) -> list[Quantity]:
    n = len(medians)
    powers = np.column_stack([medians, medians**2, medians**3]) if n else np.zeros((0, 3))
    below = np.ones_like(powers)
    means, samples = ratio(powers, below), resampled(powers, below, rng)

    def spread(of: Floats) -> Floats:
        variance = np.maximum(of[..., 1] - of[..., 0] ** 2, 0.0)
        return np.asarray(np.sqrt(variance * n / max(n - 1, 1)) / of[..., 0])

    none = "" if n else "the trajectories have no sizes of droplets"
    one = none or ("" if n > 1 else "one droplet has no spread of sizes")
    mean = float(means[0])
    centiles = np.quantile(medians, (0.1, 0.5, 0.9)) if n else np.full(3, np.nan)
    found = [
        Quantity(
            stem="mean_diameter", label="Mean diameter", value=mean, dimension=LENGTH,
            error=float(standard_error(samples[:, 0])), definition="mean over droplets",
            reason=none,
        ),
        Quantity(
            stem="polydispersity", label="Polydispersity",
            value=float(spread(means)) if n > 1 else float("nan"),
            error=float(standard_error(spread(samples))) if n > 1 else float("nan"),
            null=noise / mean if n else float("nan"),
            null_model="equal droplets, measured as often and with the same scatter",
            definition="standard deviation of the droplets' diameters over their mean", reason=one,
        ),
        Quantity(
            stem="sauter_diameter", label="Sauter mean diameter D_32",
            value=float(means[2] / means[1]) if n else float("nan"), dimension=LENGTH,
            error=float(standard_error(samples[:, 2] / samples[:, 1])), null=mean,
            null_model="equal droplets: the mean diameter",
            definition="sum of d³ over sum of d², over droplets", reason=none,
        ),
    ]  # fmt: skip
    for share, value in zip((10, 50, 90), centiles.tolist(), strict=True):
        found.append(
            Quantity(
                stem=f"diameter_centile_{share}", label=f"{share} % are smaller than", value=value,
                dimension=LENGTH, definition=f"{share} % quantile over droplets", reason=none,
            )
        )  # fmt: skip
    return found


def _noise(table: Table, sizes: Floats) -> float:
    """What scatter within droplets leaves of a droplet's mean, px: rms of s_i / sqrt(n_i)."""
    some = np.flatnonzero(kept_rows(table.rows) & np.isfinite(sizes))
    _, of = np.unique(table.rows.track_id[some], return_inverse=True)
    n = np.bincount(of)
    mean = np.bincount(of, sizes[some]) / np.maximum(n, 1)
    square = np.bincount(of, (sizes[some] - mean[of]) ** 2)
    often = n > 1
    if not often.any():
        return float("nan")
    return float(np.sqrt(np.mean(square[often] / (n[often] - 1) / n[often])))


def _stretch(table: Table) -> Floats:
    """(w - h) / (w + h) of the boxes (M,); NaN where there is none."""
    w, h = table.rows.boxes[:, 2], table.rows.boxes[:, 3]
    return np.asarray(np.divide(w - h, w + h, out=np.full(len(w), np.nan), where=w + h > 0))


def _deformation(table: Table) -> Floats | None:
    """Taylor's deformation (M,), from the axes where it is not there, as in simulated truth."""
    found = table.column("deformation")
    major, minor = table.column("major_px"), table.column("minor_px")
    if found is not None or major is None or minor is None:
        return found
    whole = major + minor
    share = np.divide(major - minor, whole, out=np.full(len(whole), np.nan), where=whole > 0)
    return np.asarray(share)


def _deformations(
    table: Table,
    paths: Paths,
    stretch: Floats,
    deformation: Floats | None,
    rng: np.random.Generator,
) -> tuple[list[Quantity], list[Figure]]:
    """Deformation, and how far boxes are stretched along x: means, and against the place."""
    there = paths.rows >= 0
    named = (
        ("deformation", "Deformation", deformation, "Taylor's (major - minor) / (major + minor) of "
         "the outline, mean over droplets and frames", "the trajectories have no deformations"),
        ("stretch_x", "Stretch of the boxes along x", stretch, "(w - h) / (w + h), mean over "
         "droplets and frames: above 0 along x, below 0 along y",
         "the trajectories have no boxes of droplets"),
    )  # fmt: skip
    quantities: list[Quantity] = []
    curves: dict[str, list[Curve]] = {"x": [], "y": [], "time": []}
    for stem, label, of_rows, definition, reason in named:
        values = np.full(len(paths.rows), np.nan)
        if of_rows is not None:
            values[there] = of_rows[paths.rows[there]]
        known = np.isfinite(values)
        mean, error = ratio_and_error(
            paths.sums(values)[:, None], paths.counts(known)[:, None], rng
        )
        quantities.append(
            Quantity(
                stem=stem, label=label, value=float(mean[0]), error=float(error[0]), null=0.0,
                null_model="circles, without noise", definition=definition,
                reason="" if known.any() else reason,
            )
        )  # fmt: skip
        for name, along in (
            ("x", paths.places[:, 0]),
            ("y", paths.places[:, 1]),
            ("time", paths.frames.astype(float)),
        ):
            of = profile(paths, along, values)
            if len(of.middles):
                value, spread = ratio_and_error(of.sums, of.counts, rng)
                curves[name].append(Curve(label=label, x=of.middles, y=value, error=spread))
    charts: list[Figure] = [
        Chart(
            name=f"deformation_{name}",
            caption=f"Deformation against {name}, means of all droplets, with standard errors.",
            x=Axis(label=name, stem=name, dimension=TIME if name == "time" else LENGTH),
            y=Axis(label=some[0].label if len(some) == 1 else "deformation", stem="deformation"),
            curves=some,
        )
        for name, some in curves.items()
    ]
    return quantities, charts


def _histogram(medians: Floats, noise: float) -> Chart:
    curves: list[Curve] = []
    if len(medians):
        spread = np.ptp(medians) > 1e-9
        bins = int(np.clip(np.sqrt(len(medians)), 5, MAX_BINS)) if spread else 1
        edges = np.histogram_bin_edges(medians, bins)
        counts = np.histogram(medians, edges)[0].astype(float)
        middles, width = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
        curves = [
            Curve(label="droplets", x=middles, y=counts, error=np.sqrt(counts), style=Style.bars)
        ]
        if noise > width / 5:
            x = np.linspace(edges[0], edges[-1], 200)
            bell = np.exp(-(((x - medians.mean()) / noise) ** 2) / 2)
            y = len(medians) * width * bell / (noise * np.sqrt(2 * np.pi))
            curves.append(Curve(label="equal droplets, measured", x=x, y=y, style=Style.null))
    return Chart(
        name="diameters",
        caption="Diameters, one a droplet.",
        x=Axis(label="diameter", stem="diameter", dimension=LENGTH),
        y=Axis(label="droplets", stem="n_droplets"),
        curves=curves,
    )


def _rows(table: Table, ids: list[int], medians: list[float]) -> list[dict[str, Value]]:
    um = table.units.um_per_px
    return [
        {"track_id": one, "diameter_px": size, **({} if um is None else {"diameter_um": size * um})}
        for one, size in zip(ids, medians, strict=True)
    ]
