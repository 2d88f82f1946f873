"""The analysis ``flock``: quantities, figures and tables."""

import math
from dataclasses import dataclass

import numpy as np

from droptrack.analysis.bootstrap import ratio, ratio_and_error, resampled, standard_error
from droptrack.analysis.flock.alignment import Alignment, align, sweep
from droptrack.analysis.flock.figures import (
    SWEEP_THRESHOLDS,
    following_chart,
    following_rows,
    order_chart,
    pictures,
    sweep_charts,
    swept,
)
from droptrack.analysis.flock.following import MAX_LAG, Following, follow
from droptrack.analysis.flock.headings import Headings, headings_of, local_flow, mean_flow
from droptrack.analysis.flock.polarisation import polarisation, polarisation_error
from droptrack.analysis.neighbourhoods import some_frames
from droptrack.analysis.paths import paths_of
from droptrack.analysis.records import (
    TIME,
    Analysis,
    Quantity,
)
from droptrack.analysis.tables import (
    frame_notes,
    jump_notes,
    kept_rows,
    neighbourhood_radius,
    typical_diameter,
)
from droptrack.data.arrays import Floats
from droptrack.data.formats.table import Table
from droptrack.data.report import Value
from droptrack.errors import DroptrackError

DEFAULT_DIAMETERS = 1.5  # between the first and the second ring of neighbours of a dense emulsion
PAPER_SHARE, PAPER_THRESHOLD = 0.47, 0.12
SWEEP_FRAMES = 500
MIN_PEAK = 4.0  # standard errors over the median of all lags, for a delay to be one
CHANCE = "headings shuffled among the droplets of each frame"


@dataclass(frozen=True, kw_only=True)
class FlockConfig:
    """R in px, or in diameters; the threshold, rad; the seed of shuffles and bootstrap."""

    radius_px: float | None = None
    radius_diameters: float | None = None
    threshold_rad: float = PAPER_THRESHOLD
    seed: int = 0


def analyse_flock(table: Table, config: FlockConfig) -> Analysis:
    """What the paper's last section reports, and what it leaves open.

    Raises DroptrackError for options that cannot be, and where no radius is known.
    """
    diameter = typical_diameter(table)
    radius = neighbourhood_radius(
        config.radius_px, config.radius_diameters, diameter, DEFAULT_DIAMETERS
    )
    if math.isnan(radius):
        raise DroptrackError("the trajectories have no sizes of droplets; give --radius, in px")
    if not 0 < config.threshold_rad <= math.pi:
        raise DroptrackError(f"--threshold {config.threshold_rad:g}: should be above 0, up to pi")
    kept = kept_rows(table.rows)
    paths = paths_of(table.rows, kept)
    headings, excluded = headings_of(paths)
    rng = np.random.default_rng(config.seed)
    main = align(headings, radius, config.threshold_rad, rng, "neighbours")
    n_pairs = int(main.compared.sum())
    counts = {
        "n_droplets": len(np.unique(table.rows.track_id)),
        "n_frames": len(np.unique(table.rows.frame)),
        "n_pairs": n_pairs,
        "n_excluded": len(table.rows) - n_pairs,
        "n_excluded_bridged_or_at_edge": int((~kept).sum()),
        **excluded,
        "n_excluded_no_neighbour": len(headings) - n_pairs,
    }
    quantities = [*_shares(headings, main, radius, diameter, config, rng)]
    quantities += _order(headings, rng)
    following = follow(headings, radius, rng)
    quantities += _delay(following, rng)
    radii = swept(radius, diameter)
    some = headings[some_frames(headings.frames, SWEEP_FRAMES)]
    counts_of_sweep = sweep(some, radii, SWEEP_THRESHOLDS, rng)
    return Analysis(
        title="Flock",
        about=_about(radius, diameter, config.threshold_rad),
        settings=_settings(table, radius, diameter, config),
        counts=counts,
        quantities=quantities,
        figures=[
            *pictures(table, headings, main, radius, config.threshold_rad),
            *sweep_charts(counts_of_sweep, radii, radius, diameter, rng),
            order_chart(headings),
            following_chart(following, rng),
        ],
        tables={"following": following_rows(following, paths.ids)},
        notes=[
            *frame_notes(table),
            *jump_notes(table, headings.velocities),
            *_notes(headings, main),
        ],
    )


def _settings(
    table: Table, radius: float, diameter: float, config: FlockConfig
) -> dict[str, Value]:
    return {
        **table.about,
        "radius_px": radius,
        "radius_diameters": radius / diameter if diameter > 0 else float("nan"),
        "diameter_px": diameter,
        "threshold_rad": config.threshold_rad,
        "seed": config.seed,
    }


def _about(radius: float, diameter: float, threshold: float) -> str:
    in_diameters = f", {radius / diameter:.3g} median diameters" if diameter > 0 else ""
    return (
        "The heading theta of a droplet is the direction of its way to the next frame; theta_S is "
        "the circular mean of the headings of the droplets whose centres are within R of its own, "
        f"itself left out. Here R = {radius:.4g} px{in_diameters}. M. Durve et al. (2021) report "
        f"that 47 % of all points have |theta - theta_S| < 0.12 rad at R = 30 px; how large their "
        "droplets are in px they do not say, so R is given in diameters here, as wide as to hold "
        f"the first ring of neighbours. Threshold here: {threshold:g} rad. Whether a share is "
        "high, only its fellow of shuffled headings tells: a flow that carries all droplets the "
        "same way aligns strangers, too."
    )


def _shares(
    headings: Headings,
    main: Alignment,
    radius: float,
    diameter: float,
    config: FlockConfig,
    rng: np.random.Generator,
) -> list[Quantity]:
    """The share, and that relative to the flow, each with its shuffled fellow."""
    base = f"share of droplets and frames with |theta - theta_S| < {config.threshold_rad:g} rad"
    found = _pair("share", "Aligned with the neighbours", base, main, rng)
    reach = diameter if diameter > 0 else radius
    for stem, label, flow, what in (
        (
            "share_mean_flow_subtracted",
            "The same, mean flow subtracted",
            mean_flow(headings),
            "velocities less the mean velocity of all droplets of the frame",
        ),
        (
            "share_local_flow_subtracted",
            "The same, local flow subtracted",
            local_flow(headings, reach),
            f"velocities less those of the other droplets around the same place in all frames, "
            f"smoothed by a Gaussian of {reach:.4g} px",
        ),
    ):
        moved = headings.relative_to(flow)
        aligned = align(moved, radius, config.threshold_rad, rng, stem.replace("_", " "))
        found += _pair(stem, label, f"{base}; {what}", aligned, rng)
    return found


def _pair(
    stem: str, label: str, definition: str, of: Alignment, rng: np.random.Generator
) -> list[Quantity]:
    values, errors = ratio_and_error(
        np.column_stack([of.aligned, of.by_chance, of.aligned - of.by_chance]),
        np.column_stack([of.compared] * 3),
        rng,
    )
    reason = "no droplet that moves has a neighbour that moves" if not of.compared.sum() else ""
    shuffled = stem.replace("share", "share_shuffled", 1)
    excess = stem.replace("share", "share_above_shuffled", 1)
    whole = "of all shuffles"
    return [
        Quantity(
            stem=stem, label=label, value=float(values[0]), error=float(errors[0]),
            null=float(values[1]), null_model=CHANCE, definition=definition, reason=reason,
        ),
        Quantity(
            stem=shuffled, label=f"{label}: shuffled", value=float(values[1]),
            error=float(errors[1]), definition=f"the same share, {CHANCE}, mean {whole}",
            reason=reason,
        ),
        Quantity(
            stem=excess, label=f"{label}: more than by chance", value=float(values[2]),
            error=float(errors[2]), null=0.0, null_model="no alignment beyond that of the frame",
            definition="the share less the shuffled share", reason=reason,
        ),
    ]  # fmt: skip


def _order(headings: Headings, rng: np.random.Generator) -> list[Quantity]:
    found = []
    for stem, label, of, what in (
        ("polarisation", "Polarisation", headings, ""),
        (
            "polarisation_mean_flow_subtracted",
            "Polarisation, mean flow subtracted",
            headings.relative_to(mean_flow(headings)),
            " of the velocities less their mean in the frame, which sum to nothing, so that less "
            "than chance is no order",
        ),
    ):
        frames, order, chance = polarisation(of)
        found.append(
            Quantity(
                stem=stem,
                label=label,
                value=float(order.mean()) if len(frames) else float("nan"),
                error=polarisation_error(of, rng) if len(frames) else float("nan"),
                null=float(chance.mean()) if len(frames) else float("nan"),
                null_model="headings at random: sqrt(pi / 4 n) for n droplets",
                definition=f"length of the mean unit vector of all headings of a frame{what}, "
                "mean of the frames with at least two",
                reason="" if len(frames) else "no frame has two droplets that move",
            )
        )
    return found


def _delay(following: Following, rng: np.random.Generator) -> list[Quantity]:
    """By how many frames those behind do later what those ahead did."""
    known = following.counts.sum(axis=0) > 0
    reason = "" if known.any() else "no two neighbours have headings"
    if known.any() and np.ptp(_correlation(following)[known]) < 1e-9:
        reason = "the headings of neighbours never change: every delay fits"
    value = error = float("nan")
    if not reason:
        mean = _correlation(following)
        best = int(np.nanargmax(mean))
        value = float(following.lags[best])
        samples = resampled(following.sums, following.counts, rng)
        sure = samples[np.isfinite(samples).all(axis=1)]
        if len(sure):
            error = float(standard_error(following.lags[sure.argmax(axis=1)].astype(float)))
            above = standard_error(sure[:, best] - np.median(sure, axis=1))
            if mean[best] - np.nanmedian(mean) < MIN_PEAK * float(above):
                reason = "the correlation has no peak that is more than its error"
                value = error = float("nan")
        if abs(value) == MAX_LAG:
            reason = f"the correlation still rises at {MAX_LAG} frames, the longest delay tried"
            value = error = float("nan")
    return [
        Quantity(
            stem="following_delay", label="Delay of those behind", value=value, error=error,
            dimension=TIME, null=0.0, null_model="no one follows",
            definition="lag of the highest correlation <cos(theta_ahead(t) - theta_behind(t + "
            "lag))> of neighbours; above 0, those behind do later what those ahead did",
            reason=reason,
        )
    ]  # fmt: skip


def _correlation(following: Following) -> Floats:
    return ratio(following.sums, following.counts)


def _notes(headings: Headings, main: Alignment) -> list[str]:
    notes = []
    speeds = np.hypot(*headings.velocities.T)
    slow = float(np.mean(speeds < 0.1)) if len(speeds) else 0.0
    if slow > 0.05:
        notes.append(
            f"{slow:.0%} of the steps are shorter than 0.1 px: their directions may be noise of "
            "the positions."
        )
    if main.compared.sum() and (main.compared > 0).sum() < 10:
        notes.append("Fewer than ten droplets: errors are rough.")
    if (main.compared > 0).sum() and headings.n_droplets and main.n_neighbours.mean() < 1.5:
        notes.append("Most droplets have one neighbour within R, or none.")
    return notes
