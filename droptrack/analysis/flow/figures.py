"""The figures of the analysis ``flow``."""

from collections.abc import Sequence

import numpy as np

from droptrack.analysis.flow.circulation import Turns
from droptrack.analysis.flow.tails import fit_tail
from droptrack.analysis.paths import Paths
from droptrack.analysis.records import TIME, Axis, Chart, Curve, Style
from droptrack.data.arrays import Floats
from droptrack.tracking.events.passages import Passage, Stay

MAX_SHOWN = 10  # droplets whose turns are drawn, each in a colour of its own
MAX_POINTS = 2000


def cumulative_chart(found: Sequence[Passage], span: tuple[int, int]) -> Chart:
    """How many have passed, against time; span: first frame and number of frames."""
    frames = np.array([one.frame for one in found])
    net = np.cumsum([float(one.forward) for one in found])
    first, n_frames = span
    ends = np.array([first, first + n_frames - 1], float)
    curves = []
    if len(frames):
        curves = [
            Curve(label="passages", x=frames, y=net, style=Style.steps),
            Curve(label="at a constant rate", x=ends, y=np.array([0.0, net[-1]]), style=Style.null),
        ]
    return Chart(
        name="passages",
        caption="Droplets that have passed the line, forward less backward.",
        x=Axis(label="time", stem="time", dimension=TIME),
        y=Axis(label="droplets", stem="n_passed"),
        curves=curves,
    )


def interval_chart(intervals: Floats) -> Chart:
    """The share of intervals that are at least so long, with the fit of the tail."""
    x = np.sort(intervals[intervals > 0])
    curves: list[Curve] = []
    if len(x):
        longer = 1 - np.arange(len(x)) / len(x)
        curves.append(Curve(label="intervals", x=x, y=longer, style=Style.points))
        mean = float(x.mean())
        at = np.geomspace(x[0], x[-1], 100) if x[-1] > x[0] else x[:1]
        seen = np.exp(-at / mean) > 0.1 / len(x)
        curves.append(
            Curve(label="Poisson", x=at[seen], y=np.exp(-at[seen] / mean), style=Style.null)
        )
        if (tail := fit_tail(intervals)) is not None:
            on = np.geomspace(tail.least, x[-1], 50)
            y = tail.n / len(x) * (on / tail.least) ** (1 - tail.exponent)
            label = f"power law, exponent {tail.exponent:.3g}"
            curves.append(Curve(label=label, x=on, y=y, style=Style.guide))
    return Chart(
        name="intervals",
        caption="Share of the intervals between passages that are at least so long.",
        x=Axis(label="interval", stem="interval", dimension=TIME),
        y=Axis(label="share at least so long", stem="share"),
        curves=curves,
        log="xy",
    )


def residence_chart(found: Sequence[Stay]) -> Chart:
    """The share of whole stays that are at least so long."""
    x = np.sort([float(one.last_frame - one.first_frame + 1) for one in found if one.whole])
    curves = []
    if len(x):
        longer = 1 - np.arange(len(x)) / len(x)
        curves = [Curve(label="whole stays", x=x, y=longer, style=Style.points)]
    return Chart(
        name="residence",
        caption="Share of the whole stays in the region that are at least so long.",
        x=Axis(label="residence", stem="residence", dimension=TIME),
        y=Axis(label="share at least so long", stem="share"),
        curves=curves,
    )


def turn_chart(paths: Paths, around: Turns) -> Chart:
    """Turns of the droplets that are seen the longest, against time."""
    longest = np.argsort(-around.counts, kind="stable")[:MAX_SHOWN]
    curves = []
    for k in np.sort(longest[around.counts[longest] > 0]).tolist():
        mine = np.flatnonzero(paths.owners == k)
        turned = np.cumsum(np.nan_to_num(around.steps[mine])) / (2 * np.pi)
        known = np.isfinite(around.steps[mine])
        some = np.unique(np.linspace(0, known.sum() - 1, MAX_POINTS).astype(int))
        shown = np.flatnonzero(known)[some]
        x = paths.frames[mine][shown] + 1.0
        curves.append(Curve(label=f"droplet {paths.ids[k]}", x=x, y=turned[shown]))
    return Chart(
        name="turns",
        caption="Turns around the centre, clockwise above 0, of the droplets that are seen the "
        "longest; gaps are left out.",
        x=Axis(label="time", stem="time", dimension=TIME),
        y=Axis(label="turns", stem="turns"),
        curves=curves,
    )
