"""The figures and tables of the analysis ``flock``."""

from collections.abc import Mapping, Sequence

import numpy as np

from droptrack.analysis.bootstrap import ratio, ratio_and_error
from droptrack.analysis.flock.alignment import Alignment, Sweep
from droptrack.analysis.flock.following import Following
from droptrack.analysis.flock.headings import Headings, mean_flow
from droptrack.analysis.flock.polarisation import polarisation
from droptrack.analysis.records import (
    LENGTH,
    NUMBER,
    TIME,
    Axis,
    Chart,
    Cloud,
    Curve,
    Figure,
    Snapshot,
    Style,
)
from droptrack.data.arrays import Rows
from droptrack.data.formats.table import Table
from droptrack.data.report import Value

SWEEP_DIAMETERS = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0)
SWEEP_OF_RADIUS = (0.6, 0.8, 1.0, 1.25, 1.5, 2.0)  # where no diameter is known
SWEEP_THRESHOLDS = np.array([0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 3.0])
MAX_CLOUD = 40_000


def swept(radius: float, diameter: float) -> list[float]:
    """The radii, px, to be tried beside the one that was asked for."""
    if diameter > 0:
        return sorted({*(one * diameter for one in SWEEP_DIAMETERS), radius})
    return [one * radius for one in SWEEP_OF_RADIUS]


def sweep_charts(
    counts: Sweep, radii: Sequence[float], radius: float, diameter: float, rng: np.random.Generator
) -> list[Figure]:
    """The share against R, against the threshold, and how many neighbours R holds."""
    n, k, m = counts.aligned.shape
    below = np.repeat(counts.compared[:, :, None], m, axis=2).reshape(n, -1)
    share, error = (
        one.reshape(k, m) for one in ratio_and_error(counts.aligned.reshape(n, -1), below, rng)
    )
    chance = ratio(counts.by_chance.reshape(n, -1), below).reshape(k, m)
    scale = diameter if diameter > 0 else 1.0
    x = np.array(radii) / scale
    along = Axis(label="R / diameters", stem="radius_diameters")
    if not diameter > 0:
        along = Axis(label="R", stem="radius", dimension=LENGTH)
    curves = []
    for j in (1, 2, 3, 4):
        label = f"< {SWEEP_THRESHOLDS[j]:g} rad"
        curves.append(Curve(label=label, x=x, y=share[:, j], error=error[:, j]))
        curves.append(Curve(label=f"{label}, shuffled", x=x, y=chance[:, j], style=Style.null))
    i = int(np.argmin(np.abs(np.array(radii) - radius)))
    thresholds = [
        Curve(label="as it is", x=SWEEP_THRESHOLDS, y=share[i], error=error[i]),
        Curve(label="shuffled", x=SWEEP_THRESHOLDS, y=chance[i], style=Style.null),
        Curve(
            label="no preference: threshold / pi",
            x=SWEEP_THRESHOLDS,
            y=SWEEP_THRESHOLDS / np.pi,
            style=Style.guide,
        ),
    ]
    return [
        Chart(
            name="radius", x=along, y=Axis(label="share", stem="share"), curves=curves,
            caption="Share of droplets aligned with their neighbours against the radius of the "
            "neighbourhood, for several thresholds; dashed: headings shuffled.",
        ),
        Chart(
            name="threshold", x=Axis(label="threshold / rad", stem="threshold_rad"),
            y=Axis(label="share", stem="share"), curves=thresholds, log="x",
            caption=f"Share against the threshold, at R = {radii[i]:.4g} px.",
        ),
        Chart(
            name="neighbours", x=along, y=Axis(label="neighbours", stem="neighbours"),
            curves=[Curve(label="neighbours", x=x, y=counts.n_neighbours)],
            caption="Neighbours within R that move, on average.",
        ),
    ]  # fmt: skip


def order_chart(headings: Headings) -> Chart:
    """The polarisation of each frame."""
    frames, order, chance = polarisation(headings)
    moved_frames, moved, _ = polarisation(headings.relative_to(mean_flow(headings)))
    return Chart(
        name="polarisation",
        caption="Polarisation: 1 where all droplets go the same way.",
        x=Axis(label="time", stem="time", dimension=TIME),
        y=Axis(label="polarisation", stem="polarisation", dimension=NUMBER),
        curves=[
            Curve(label="as it is", x=frames, y=order),
            Curve(label="mean flow subtracted", x=moved_frames, y=moved),
            Curve(label="headings at random", x=frames, y=chance, style=Style.null),
        ],
    )


def following_chart(following: Following, rng: np.random.Generator) -> Chart:
    """The correlation of headings against the lag."""
    value, error = ratio_and_error(following.sums, following.counts, rng)
    lags = following.lags.astype(float)
    return Chart(
        name="following_correlation",
        caption="Who follows whom: correlation of the heading of the droplet behind with that of "
        "the neighbour ahead of it, which is this much earlier.",
        x=Axis(label="lag", stem="lag", dimension=TIME),
        y=Axis(label="<cos(theta_ahead(t) - theta_behind(t + lag))>", stem="correlation"),
        curves=[
            Curve(label="neighbours", x=lags, y=value, error=error),
            Curve(
                label="any other droplet of the frame instead",
                x=lags,
                y=ratio(following.chance, following.chance_counts),
                style=Style.null,
            ),
        ],
    )


def following_rows(following: Following, ids: Rows) -> list[Mapping[str, Value]]:
    """Pairs that were neighbours for long enough."""
    return [
        {
            "leader": int(ids[pair[0]]),
            "follower": int(ids[pair[1]]),
            "delay_frames": int(best),
            "correlation": float(high),
            "correlation_at_0": float(now),
            "n_frames": int(n),
        }
        for pair, best, high, now, n in zip(
            following.pairs, following.best, following.highest, following.now, following.n,
            strict=True,
        )
    ]  # fmt: skip


def pictures(
    table: Table, headings: Headings, main: Alignment, radius: float, threshold: float
) -> list[Figure]:
    """The two panels of the paper's figure: a neighbourhood, and all headings."""
    known = np.flatnonzero(np.isfinite(main.neighbours))
    known = (
        known[np.unique(np.linspace(0, len(known) - 1, MAX_CLOUD).astype(int))]
        if len(known)
        else known
    )
    cloud = Cloud(
        name="scatter",
        caption="Heading of each droplet against the mean heading of its neighbours, a colour a "
        "droplet, as the paper's figure; red: equal, and the threshold.",
        x=Axis(label="theta_S / rad", stem="theta_s_rad"),
        y=Axis(label="theta_i / rad", stem="theta_i_rad"),
        values=(main.neighbours[known], headings.angles[known]),
        droplets=table.rows.track_id[headings.rows[known]],
        band=threshold,
    )
    if not len(known):
        return [cloud]
    frames, at = np.unique(headings.frames, return_inverse=True)
    best = int(np.argmax(np.bincount(at, main.n_neighbours)))
    rows = np.flatnonzero(at == best)
    centre = rows[int(np.argmax(main.n_neighbours[rows]))]
    lengths = np.hypot(*headings.velocities[rows].T)
    x, y = headings.places[centre].tolist()
    snapshot = Snapshot(
        name="neighbourhood",
        caption=f"Neighbourhood of one droplet in frame {frames[best]}, R = {radius:.4g} px; "
        "arrows: headings.",
        places=headings.places[rows],
        radii=table.diameters()[headings.rows[rows]] / 2,
        size=table.size,
        arrows=headings.velocities[rows] / lengths[:, None],
        circle=(x, y, radius),
    )
    return [snapshot, cloud]
