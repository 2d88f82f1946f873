"""The analysis ``motion``: quantities and figures."""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.bootstrap import ratio, ratio_and_error, resampled, standard_error
from droptrack.analysis.motion.displacements import (
    Moments,
    exponent,
    fit_lags,
    lags_for,
    moments,
)
from droptrack.analysis.motion.figures import (
    fluctuation_charts,
    moment_charts,
    non_affine_figures,
    profile_charts,
    van_hove_charts,
)
from droptrack.analysis.motion.non_affine import non_affine_sums
from droptrack.analysis.motion.velocities import autocorrelation, correlation_lags, fluctuations
from droptrack.analysis.paths import Paths, free_of_drift, paths_of
from droptrack.analysis.records import (
    AREA,
    SPEED,
    TIME,
    Analysis,
    Axis,
    Chart,
    Curve,
    Figure,
    Quantity,
    Style,
)
from droptrack.analysis.tables import (
    frame_notes,
    jump_notes,
    kept_rows,
    neighbourhood_radius,
    typical_diameter,
)
from droptrack.data.arrays import Floats, Rows
from droptrack.data.formats.table import Table
from droptrack.errors import DroptrackError

DEFAULT_DIAMETERS = 2.0
LAGS = np.array([1, 2, 5, 10, 20, 50])  # of the non-affine motion, frames
DEFAULT_LAG = 10
ABOUT = (
    "Displacements and velocities are differences of positions; bridged rows and those of droplets "
    "that the image cuts are left out, and count as gaps. A displacement over a lag needs both "
    "ends, not what is between; velocities are steps from one frame to the next. Drift is the mean "
    "step of all droplets, summed."
)


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """The neighbourhood of D²min in px, or in diameters; its lag, frames; the bootstrap's seed."""

    radius_px: float | None = None
    radius_diameters: float | None = None
    lag: int = DEFAULT_LAG
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Paths with places less the drift (S, 2) px, velocities and fluctuations (S, 2) px a frame."""

    paths: Paths
    still: Floats
    velocities: Floats
    fluctuations: Floats


def analyse_motion(table: Table, config: MotionConfig) -> Analysis:
    """How droplets move; raises DroptrackError for options that cannot be."""
    if config.lag < 1:
        raise DroptrackError(f"--lag {config.lag}: should be at least 1 frame")
    diameter = typical_diameter(table)
    radius = neighbourhood_radius(
        config.radius_px, config.radius_diameters, diameter, DEFAULT_DIAMETERS
    )
    kept = kept_rows(table.rows)
    paths = paths_of(table.rows, kept)
    velocities = paths.displacements(1)
    motion = _Motion(
        paths=paths,
        still=free_of_drift(paths),
        velocities=velocities,
        fluctuations=fluctuations(paths, velocities),
    )
    rng = np.random.default_rng(config.seed)
    quantities, figures = _diffusion(motion, rng)
    for found, charts in (_velocity(motion, rng), _memory(motion, rng)):
        quantities += found
        figures += charts
    found, charts = _non_affine(table, paths, radius, config.lag, rng)
    return Analysis(
        title="Motion",
        about=ABOUT,
        settings={
            **table.about,
            "radius_px": radius,
            "lag_frames": config.lag,
            "diameter_px": diameter,
            "seed": config.seed,
        },
        counts={
            "n_droplets": len(np.unique(table.rows.track_id)),
            "n_frames": len(np.unique(table.rows.frame)),
            "n_steps": int(np.isfinite(velocities[:, 0]).sum()),
            "n_excluded_bridged_or_at_edge": int((~kept).sum()),
        },
        quantities=[*quantities, *found],
        figures=[*figures, *charts],
        notes=[*frame_notes(table), *jump_notes(table, velocities), *_notes(motion)],
    )


def _diffusion(motion: _Motion, rng: np.random.Generator) -> tuple[list[Quantity], list[Figure]]:
    """Exponents of the mean square displacement, and the non-Gaussian parameter."""
    paths = motion.paths
    lags = lags_for(paths.longest)
    both = [moments(paths, places, lags) for places in (paths.places, motion.still)]
    quantities = [
        _exponent(of, stem, what, rng)
        for of, stem, what in (
            (both[0], "msd_exponent", ""),
            (both[1], "msd_exponent_drift_subtracted", ", drift subtracted"),
        )
    ]
    figures = moment_charts(both[0], both[1], rng)
    for axis, name in enumerate("xy"):
        figures.append(van_hove_charts(paths, motion.still, lags, axis, name, rng))
    return quantities, figures


def _exponent(of: Moments, stem: str, what: str, rng: np.random.Generator) -> Quantity:
    fitted = fit_lags(of.lags)
    lags = of.lags[fitted]
    mean = ratio(of.second, of.counts)[fitted]
    value = float(exponent(lags, mean))
    samples = exponent(lags, resampled(of.second, of.counts, rng)[:, fitted])
    reason = ""
    if not np.isfinite(value):
        short = len(lags) < 3
        reason = "no path is long enough for three lags" if short else "nothing moves"
    span = f"lags of 1 to {lags[-1]} frames" if len(lags) else "no lags"
    return Quantity(
        stem=stem,
        label=f"Exponent of the mean square displacement{what}",
        value=value,
        error=float(standard_error(samples)),
        null=1.0,
        null_model="steps that know nothing of each other: diffusion",
        definition=f"slope of log <|r(t + lag) - r(t)|²> over log lag{what}, {span}; 2: straight "
        "ways",
        reason=reason,
    )


def _velocity(motion: _Motion, rng: np.random.Generator) -> tuple[list[Quantity], list[Figure]]:
    """Mean velocities, what they fluctuate by, and both across and along the image."""
    paths, quantities = motion.paths, []
    known = np.isfinite(motion.velocities[:, 0])
    n = paths.counts(known)[:, None]
    for axis, name in enumerate("xy"):
        mean, error = ratio_and_error(paths.sums(motion.velocities[:, axis])[:, None], n, rng)
        quantities.append(
            Quantity(
                stem=f"mean_velocity_{name}", label=f"Mean velocity along {name}",
                value=float(mean[0]), error=float(error[0]), dimension=SPEED, null=0.0,
                null_model="no flow", definition=f"mean step along {name} of all droplets and "
                "frames; y points down",
                reason="" if known.any() else "no droplet is seen in two frames in a row",
            )
        )  # fmt: skip
    there = np.isfinite(motion.fluctuations[:, 0])
    counts = paths.counts(there)[:, None]
    for axis, name in enumerate("xy"):
        of = motion.fluctuations[:, axis]
        quantities += _spread(paths, of, counts, name, rng)
    figures = profile_charts(paths, motion.velocities, rng)
    figures += fluctuation_charts(paths, motion.fluctuations, rng)
    return quantities, figures


def _spread(
    paths: Paths, of: Floats, counts: Floats, name: str, rng: np.random.Generator
) -> list[Quantity]:
    """Root mean square of the fluctuations along one axis, and their excess kurtosis."""
    sums = np.column_stack([paths.sums(of**2), paths.sums(of**4)])
    below = np.repeat(counts, 2, axis=1)
    mean, samples = ratio(sums, below), resampled(sums, below, rng)
    reason = "" if counts.any() else "no place has ten steps, to be compared with their mean"
    none = not mean[0] > 0
    kurtosis = np.nan if none else mean[1] / mean[0] ** 2 - 3
    spread = samples[:, 1] / np.where(samples[:, 0] > 0, samples[:, 0], np.nan) ** 2 - 3
    return [
        Quantity(
            stem=f"velocity_fluctuation_{name}", label=f"Velocity fluctuation along {name}",
            value=float(np.sqrt(mean[0])), error=float(standard_error(np.sqrt(samples[:, 0]))),
            dimension=SPEED, null=0.0, null_model="a steady flow",
            definition="root mean square of velocities less the mean of all droplets and frames in "
            "the same of 16 x 16 cells; noise of positions included", reason=reason,
        ),
        Quantity(
            stem=f"velocity_fluctuation_excess_kurtosis_{name}",
            label=f"Excess kurtosis of the fluctuations along {name}", value=float(kurtosis),
            error=float("nan") if none else float(standard_error(spread)), null=0.0,
            null_model="Gaussian", definition="<dv⁴> / <dv²>² - 3",
            reason=reason or ("nothing fluctuates" if none else ""),
        ),
    ]  # fmt: skip


def _memory(motion: _Motion, rng: np.random.Generator) -> tuple[list[Quantity], list[Figure]]:
    """How long velocities remember: the first lag at which the correlation is below 1 / e."""
    paths = motion.paths
    lags = correlation_lags(paths.longest)
    curves, value, error, reason = [], float("nan"), float("nan"), ""
    moved = paths.displacements(1, motion.still)
    for label, of in (("as it is", motion.velocities), ("drift subtracted", moved)):
        sums, counts = autocorrelation(paths, of, lags)
        mean, samples = ratio(sums, counts), resampled(sums, counts, rng)
        if not (np.isfinite(mean[0]) and mean[0] > 1e-12):
            reason = "nothing moves, the drift subtracted"
            continue
        curves.append(
            Curve(
                label=label,
                x=lags.astype(float),
                y=mean / mean[0],
                error=standard_error(samples / samples[:, :1]),
            )
        )
        if label == "drift subtracted":
            value = _below(lags, mean / mean[0])
            error = float(standard_error(np.array([_below(lags, one / one[0]) for one in samples])))
            reason = "" if np.isfinite(value) else "the correlation stays above 1 / e"
    zero = Curve(
        label="steps at random", x=lags.astype(float), y=(lags == 0).astype(float), style=Style.null
    )
    chart = Chart(
        name="velocity_autocorrelation",
        caption="Autocorrelation of the velocity, <v(t) . v(t + lag)> over that at lag 0. Noise of "
        "positions makes it negative at lag 1.",
        x=Axis(label="lag", stem="lag", dimension=TIME),
        y=Axis(label="correlation of velocities", stem="correlation"),
        curves=[*curves, zero] if curves else [],
    )
    quantity = Quantity(
        stem="velocity_correlation_time", label="Memory of velocities", value=value, error=error,
        dimension=TIME, null=float("nan"), null_model="steps at random: below one frame",
        definition="lag at which the autocorrelation of velocities, drift subtracted, falls below "
        "1 / e, between lags on a straight line", reason=reason,
    )  # fmt: skip
    return [quantity], [chart]


def _below(lags: Rows, values: Floats) -> float:
    """Where values (L,) that begin at 1 first fall below 1 / e."""
    under = np.flatnonzero(values < np.exp(-1))
    if not len(under):
        return float("nan")
    k = int(under[0])
    high, low = values[k - 1] - np.exp(-1), np.exp(-1) - values[k]
    return float(lags[k - 1] + (lags[k] - lags[k - 1]) * high / (high + low))


def _non_affine(
    table: Table, paths: Paths, radius: float, lag: int, rng: np.random.Generator
) -> tuple[list[Quantity], list[Figure]]:
    """D²min at one lag, and against the lag."""
    lags = np.unique(np.append(LAGS[paths.longest > LAGS], lag))
    value = error = null = float("nan")
    figures: list[Figure] = []
    if np.isnan(radius):
        reason = "the trajectories have no sizes of droplets; give --radius, in px"
    else:
        sums, counts, null_sums, null_counts = non_affine_sums(paths, radius, lags, rng)
        mean, errors = ratio_and_error(sums, counts, rng)
        chance = ratio(null_sums, null_counts)
        k = int(np.flatnonzero(lags == lag)[0])
        value, error, null = float(mean[k]), float(errors[k]), float(chance[k])
        reason = "" if np.isfinite(value) else "no droplet has three neighbours for so long"
        figures = non_affine_figures(table, paths, radius, lag, (lags, mean, errors, chance))
    quantity = Quantity(
        stem="d2min", label="Non-affine displacement D²min", value=value, error=error, null=null,
        null_model="displacements shuffled among the droplets of each frame", dimension=AREA,
        definition=f"least mean square over the neighbours within {radius:.4g} px of r_ij(t + "
        f"{lag}) - F r_ij(t), for any matrix F (Falk and Langer 1998), a mean instead of a sum; at "
        "least three neighbours", reason=reason,
    )  # fmt: skip
    return [quantity], figures


def _notes(motion: _Motion) -> list[str]:
    if motion.paths.n_droplets == 1:
        return ["One droplet: no errors, and drift subtracted nothing is left."]
    return []
