"""The figures of the analysis ``motion``."""

import numpy as np

from droptrack.analysis.bootstrap import ratio, ratio_and_error, resampled, standard_error
from droptrack.analysis.motion.displacements import Moments, exponent, fit_lags, van_hove
from droptrack.analysis.motion.non_affine import non_affine_in
from droptrack.analysis.motion.velocities import profile
from droptrack.analysis.paths import Paths
from droptrack.analysis.records import (
    AREA,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    Axis,
    Chart,
    Curve,
    Figure,
    Snapshot,
    Style,
)
from droptrack.analysis.tables import diameters
from droptrack.data.arrays import Floats, Rows
from droptrack.data.formats.table import Table

BINS = 41
REACH = 5.0  # standard deviations that the distribution of fluctuations shows


def moment_charts(raw: Moments, still: Moments, rng: np.random.Generator) -> list[Figure]:
    """The mean square displacement, and the non-Gaussian parameter, against the lag."""
    lags = raw.lags.astype(float)
    curves = []
    for label, of in (("as it is", raw), ("drift subtracted", still)):
        mean, error = ratio_and_error(of.second, of.counts, rng)
        curves.append(Curve(label=label, x=lags, y=mean, error=error))
        fitted = fit_lags(of.lags)
        slope = exponent(of.lags[fitted], mean[fitted])
        if np.isfinite(slope):
            x = lags[fitted]
            middle = np.exp(np.log(mean[fitted]).mean() - slope * np.log(x).mean())
            y = middle * x**slope
            curves.append(Curve(label=f"exponent {slope:.3g}", x=x, y=y, style=Style.guide))
    first = ratio(still.second, still.counts)[:1]
    if len(first) and first[0] > 0:
        chance = Curve(label="steps at random", x=lags, y=first[0] * lags, style=Style.null)
        curves.append(chance)
    msd = Chart(
        name="msd",
        caption="Mean square displacement; red: the fit of the exponent; dashed: steps as long, "
        "drift subtracted, that know nothing of each other.",
        x=Axis(label="lag", stem="lag", dimension=TIME),
        y=Axis(label="mean square displacement", stem="msd", dimension=AREA),
        curves=curves,
        log="xy",
    )
    return [msd, _non_gaussian(still, rng)]


def _non_gaussian(of: Moments, rng: np.random.Generator) -> Chart:
    k = len(of.lags)
    sums, counts = np.hstack([of.second, of.fourth]), np.hstack([of.counts, of.counts])
    both, samples = ratio(sums, counts), resampled(sums, counts, rng)

    def alpha(means: Floats) -> Floats:
        second = np.where(means[..., :k] > 0, means[..., :k], np.nan)
        return np.asarray(means[..., k:] / (2 * second**2) - 1)

    x = of.lags.astype(float)
    return Chart(
        name="non_gaussian",
        caption="Non-Gaussian parameter in two dimensions, <r⁴> / (2 <r²>²) - 1, drift subtracted.",
        x=Axis(label="lag", stem="lag", dimension=TIME),
        y=Axis(label="non-Gaussian parameter", stem="alpha_2"),
        curves=[
            Curve(label="displacements", x=x, y=alpha(both), error=standard_error(alpha(samples))),
            Curve(label="Gaussian", x=x, y=np.zeros(k), style=Style.null),
        ],
        log="x",
    )


def van_hove_charts(
    paths: Paths, places: Floats, lags: Rows, axis: int, name: str, rng: np.random.Generator
) -> Chart:
    """The self part of the van Hove function along an axis, at three lags."""
    curves = []
    for lag in sorted({int(lags[k]) for k in (0, len(lags) // 2, -1)}) if len(lags) else ():
        edges, counts, rms = van_hove(paths, places, lag, axis)
        if not rms > 0:
            continue
        x, width = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
        total = np.repeat(counts.sum(axis=1, keepdims=True), counts.shape[1], axis=1)
        share, error = ratio_and_error(counts, total, rng)
        curves.append(Curve(label=f"{lag} frames", x=x, y=share / width, error=error / width))
        gauss = np.exp(-((x / rms) ** 2) / 2) / (rms * np.sqrt(2 * np.pi))
        seen = gauss > 0.1 / (max(counts.sum(), 1) * width)
        label = "Gaussian of the same variance"
        curves.append(Curve(label=label, x=x[seen], y=gauss[seen], style=Style.null))
    return Chart(
        name=f"van_hove_{name}",
        caption=f"Van Hove function, self part: distribution of displacements along {name}, drift "
        "subtracted, at several lags.",
        x=Axis(label=f"displacement along {name}", stem=f"d{name}", dimension=LENGTH),
        y=Axis(label="probability density", stem="density", dimension=(-1, 0)),
        curves=curves,
        log="y",
    )


def profile_charts(paths: Paths, velocities: Floats, rng: np.random.Generator) -> list[Figure]:
    """Mean velocities in bins across and along the image, with standard errors."""
    charts: list[Figure] = []
    for axis, along in ((1, "y"), (0, "x")):
        curves = []
        for k, name in enumerate("xy"):
            of = profile(paths, paths.places[:, axis], velocities[:, k])
            mean, error = ratio_and_error(of.sums, of.counts, rng)
            curves.append(Curve(label=f"along {name}", x=of.middles, y=mean, error=error))
        middles = curves[0].x
        known = np.isfinite(velocities[:, 0])
        plug = float(velocities[known, 0].mean()) if known.any() else float("nan")
        flat = Curve(
            label="a plug: the mean along x", x=middles, y=np.full(len(middles), plug),
            style=Style.null,
        )  # fmt: skip
        charts.append(
            Chart(
                name=f"velocity_profile_{along}",
                caption=f"Mean velocity against {along}, of all droplets and frames, with standard "
                "errors.",
                x=Axis(label=along, stem=along, dimension=LENGTH),
                y=Axis(label="velocity", stem="velocity", dimension=SPEED),
                curves=[*curves, flat],
            )
        )
    return charts


def fluctuation_charts(paths: Paths, of: Floats, rng: np.random.Generator) -> list[Figure]:
    """Fluctuations of the velocity across the image, and their distribution."""
    across, spread = [], []
    for k, name in enumerate("xy"):
        square = profile(paths, paths.places[:, 1], of[:, k] ** 2)
        mean, samples = (
            ratio(square.sums, square.counts),
            resampled(square.sums, square.counts, rng),
        )
        error = standard_error(np.sqrt(samples))
        across.append(Curve(label=f"along {name}", x=square.middles, y=np.sqrt(mean), error=error))
        known = np.flatnonzero(np.isfinite(of[:, k]))
        sigma = np.sqrt(np.mean(of[known, k] ** 2)) if len(known) else 0.0
        if sigma > 0:
            scaled = of[known, k] / sigma
            inside = np.abs(scaled) < REACH
            at = ((scaled[inside] + REACH) / (2 * REACH) * BINS).astype(np.int64)
            flat = paths.owners[known[inside]] * BINS + at
            counts = np.bincount(flat, minlength=paths.n_droplets * BINS).reshape(-1, BINS)
            total = np.repeat(paths.counts(np.isfinite(of[:, k]))[:, None], BINS, axis=1)
            share, error = ratio_and_error(counts.astype(float), total, rng)
            width = 2 * REACH / BINS
            x = np.linspace(-REACH + width / 2, REACH - width / 2, BINS)
            curve = Curve(label=f"along {name}", x=x, y=share / width, error=error / width)
            spread.append(curve)
    if spread:
        x = spread[0].x
        gauss = np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi)
        spread.append(Curve(label="Gaussian", x=x, y=gauss, style=Style.null))
    return [
        Chart(
            name="fluctuations_y",
            caption="Root mean square of the velocity fluctuations against y.",
            x=Axis(label="y", stem="y", dimension=LENGTH),
            y=Axis(label="fluctuation", stem="fluctuation", dimension=SPEED),
            curves=across,
        ),
        Chart(
            name="fluctuation_distribution",
            caption="Distribution of the velocity fluctuations, in their root mean square.",
            x=Axis(label="fluctuation / root mean square", stem="fluctuation_over_rms"),
            y=Axis(label="probability density", stem="density", dimension=NUMBER),
            curves=spread,
            log="y",
        ),
    ]


def non_affine_figures(
    table: Table,
    paths: Paths,
    radius: float,
    lag: int,
    against_lag: tuple[Rows, Floats, Floats, Floats],
) -> list[Figure]:
    """D²min against the lag, and in the frame in the middle."""
    lags, mean, error, chance = against_lag
    x = lags.astype(float)
    chart = Chart(
        name="d2min",
        caption="Non-affine displacement against the lag; dashed: displacements shuffled.",
        x=Axis(label="lag", stem="lag", dimension=TIME),
        y=Axis(label="D²min", stem="d2min", dimension=AREA),
        curves=[
            Curve(label="D²min", x=x, y=mean, error=error),
            Curve(label="shuffled displacements", x=x, y=chance, style=Style.null),
        ],
        log="xy",
    )
    known = np.isfinite(paths.displacements(lag)[:, 0])
    frames, n = np.unique(paths.frames[known], return_counts=True)
    if not len(frames):
        return [chart]
    full = frames[n >= n.max() / 2]
    frame = int(full[len(full) // 2])
    rows, values = non_affine_in(paths, frame, radius, lag)
    some = np.isfinite(values)
    snapshot = Snapshot(
        name="d2min_frame",
        caption=f"D²min, px², of the droplets of frame {frame}, {lag} frames on.",
        places=np.column_stack([table.rows.x[rows], table.rows.y[rows]])[some],
        radii=np.nan_to_num(diameters(table)[rows][some] / 2, nan=radius / 4),
        size=table.size,
        values=values[some],
        value_label="D²min / px²",
    )
    return [chart, snapshot] if some.any() else [chart]
