"""The analysis ``flow``: quantities, figures and tables."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from droptrack.analysis.bootstrap import ratio_and_error
from droptrack.analysis.flow.circulation import Turns, turns
from droptrack.analysis.flow.figures import (
    cumulative_chart,
    interval_chart,
    residence_chart,
    turn_chart,
)
from droptrack.analysis.flow.intervals import interval_quantities, intervals_of
from droptrack.analysis.paths import Paths, paths_of
from droptrack.analysis.records import RATE, TIME, Analysis, Figure, Quantity
from droptrack.analysis.tables import (
    droplet_areas,
    droplet_medians,
    frame_notes,
    kept_rows,
    typical_diameter,
)
from droptrack.data.arrays import Floats
from droptrack.data.formats.table import Table
from droptrack.data.report import Value
from droptrack.errors import DroptrackError
from droptrack.tracking.events.passages import (
    Passage,
    Region,
    Stay,
    parse_line,
    parse_region,
    passages,
    stays,
)

UM = 1e-6  # m
NO_LINE, NO_REGION = "give --line, where to count", "give --region, in which droplets stay"
ABOUT = (
    "A droplet passes a line where the straight way between two of its positions crosses it; "
    "forward is from the line's left to its right, seen from its first place to its second. "
    "Intervals are between passages one after the other in the direction of most. Bridged rows "
    "count; rows of droplets that the image cuts do not."
)


@dataclass(frozen=True, kw_only=True)
class FlowConfig:
    """Options of the analysis.

    line: X1,Y1,X2,Y2; region: a rectangle or polygon, see `events.passages`; clog_frames: from
    where on an interval is a clog; viscosity Pa s, tension N/m, density kg/m³; centre: X,Y px.
    """

    line: str | None = None
    region: str | None = None
    clog_frames: float | None = None
    viscosity: float | None = None
    tension: float | None = None
    density: float | None = None
    centre: str | None = None
    seed: int = 0


def analyse_flow(table: Table, config: FlowConfig) -> Analysis:
    """How droplets flow; raises DroptrackError for options that cannot be."""
    _check(config)
    rng = np.random.default_rng(config.seed)
    line = None if config.line is None else parse_line(config.line, table.size)
    region = None if config.region is None else parse_region(config.region, table.size)
    kept = kept_rows(table.rows)
    paths = paths_of(table.rows, kept)
    found = [] if line is None else passages(table.rows, line)
    there = [] if region is None else stays(table.rows, region)
    intervals = intervals_of(found)
    around = turns(paths, _centre(config.centre))
    quantities = [
        *_rates(table, found, intervals, line is not None),
        *interval_quantities(
            intervals, config.clog_frames, "" if line is not None else NO_LINE, rng
        ),
        _residence(table, there, region, paths, rng),
        *_numbers(table, paths, config, rng),
        *_circulation(around, rng),
    ]
    n_frames = int(np.ptp(table.rows.frame)) + 1
    figures: list[Figure] = [turn_chart(paths, around)]
    if line is not None:
        figures = [
            cumulative_chart(found, (int(table.rows.frame[0]), n_frames)),
            interval_chart(intervals),
            *figures,
        ]
    if region is not None:
        figures.append(residence_chart(there))
    forward = sum(one.forward == 1 for one in found)
    return Analysis(
        title="Flow",
        about=ABOUT,
        settings={**table.about, **asdict(config)},
        counts={
            "n_droplets": paths.n_droplets,
            "n_frames": n_frames,
            "n_forward": forward,
            "n_backward": len(found) - forward,
            "n_intervals": len(intervals),
            "n_stays": len(there),
            "n_whole_stays": sum(one.whole for one in there),
        },
        quantities=quantities,
        figures=figures,
        tables={
            **({} if line is None else {"passages": _passage_rows(found)}),
            **({} if region is None else {"stays": [_stay_row(one) for one in there]}),
        },
        notes=[*frame_notes(table), *_notes(around)],
    )


def _check(config: FlowConfig) -> None:
    for option, value in (
        ("--clog", config.clog_frames),
        ("--viscosity", config.viscosity),
        ("--tension", config.tension),
        ("--density", config.density),
    ):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise DroptrackError(f"{option} {value:g}: should be above 0")


def _centre(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise DroptrackError(f"--centre {text}: should be X,Y") from None
    return x, y


def _rates(
    table: Table, found: Sequence[Passage], intervals: Floats, counted: bool
) -> list[Quantity]:
    """Droplets and area that pass the line in a time.

    A count has the error of its intervals: each droplet passes once, so that none could be drawn
    again.
    """
    rows = table.rows
    areas = droplet_areas(table)
    ids, medians = droplet_medians(table, areas)
    area_of = dict(zip(ids.tolist(), medians.tolist(), strict=True))
    net = float(sum(one.forward for one in found))
    passed = np.array([area_of.get(one.track_id, np.nan) for one in found])
    area = float(sum(one.forward * size for one, size in zip(found, passed, strict=True)))
    n_frames = int(np.ptp(rows.frame)) + 1
    n = len(intervals)
    share = float(intervals.std(ddof=1) / intervals.mean() / math.sqrt(n)) if n > 1 else math.nan
    of_sizes = float(passed.std() / passed.mean() / math.sqrt(len(passed))) if n > 1 else math.nan
    sized = np.isfinite(passed).all()
    no_size = "" if sized else "the trajectories have no sizes of droplets that pass"
    why, why_area = ("", no_size) if counted else (NO_LINE, NO_LINE)
    error = "; error: that of the intervals"
    return [
        Quantity(
            stem="flow_rate", label="Flow rate", value=math.nan if why else net / n_frames,
            error=math.nan if why else abs(net) / n_frames * share, dimension=RATE, reason=why,
            definition="passages forward less backward, over the time of the recording" + error,
        ),
        Quantity(
            stem="area_flow_rate", label="Flow rate of area", dimension=(2, -1), reason=why_area,
            value=math.nan if why_area else area / n_frames,
            error=math.nan if why_area else abs(area) / n_frames * math.hypot(share, of_sizes),
            definition="the same, each droplet by the median of its areas" + error + " and sizes",
        ),
    ]  # fmt: skip


def _residence(
    table: Table,
    found: Sequence[Stay],
    region: Region | None,
    paths: Paths,
    rng: np.random.Generator,
) -> Quantity:
    """How long droplets stay, of whole stays; beside a plug that goes straight through."""
    whole = [one for one in found if one.whole]
    ids = sorted({one.track_id for one in whole})
    sums, counts = np.zeros((2, len(ids), 1))
    for one in whole:
        sums[ids.index(one.track_id)] += one.last_frame - one.first_frame + 1
        counts[ids.index(one.track_id)] += 1
    reason = NO_REGION if region is None else "no droplet came in and went out while it was tracked"
    value = error = null = float("nan")
    if whole and region is not None:
        mean, errors = ratio_and_error(sums, counts, rng)
        value, error, reason = float(mean[0]), float(errors[0]), ""
        speed = abs(float(np.nanmean(paths.displacements(1)[:, 0])))
        null = float(np.ptp(region.corners[:, 0])) / speed if speed > 0 else float("nan")
    return Quantity(
        stem="residence", label="Residence in the region", value=value, error=error, null=null,
        null_model="straight along x at the mean velocity of all droplets and frames",
        dimension=TIME, definition="from the first to the last frame with the centre in the "
        "region, both included, mean over whole stays", reason=reason,
    )  # fmt: skip


def _numbers(
    table: Table, paths: Paths, config: FlowConfig, rng: np.random.Generator
) -> list[Quantity]:
    """Capillary and Reynolds number, from what is given."""
    speeds = np.hypot(*paths.displacements(1).T)
    known = np.isfinite(speeds)
    mean, error = ratio_and_error(paths.sums(speeds)[:, None], paths.counts(known)[:, None], rng)
    speed, spread = float(mean[0]), float(error[0])
    units, diameter = table.units, typical_diameter(table)
    scale = why = None
    if units.um_per_px is None or units.fps is None:
        why = "needs micrometres a pixel and frames a second: --um-per-px, --fps"
    else:
        scale = units.um_per_px * UM * units.fps
    if not known.any():
        why = "no droplet is seen in two frames in a row"
    eta, sigma, rho = config.viscosity, config.tension, config.density
    no_ca = why or ("" if eta and sigma else "give --viscosity and --tension")
    no_re = why or ("" if eta and rho else "give --viscosity and --density")
    if not no_re and not diameter > 0:
        no_re = "the trajectories have no sizes of droplets"
    ca = re = float("nan")
    if not no_ca and scale and eta and sigma:
        ca = eta * scale / sigma
    if not no_re and scale and eta and rho and units.um_per_px:
        re = rho * scale * diameter * units.um_per_px * UM / eta
    return [
        Quantity(
            stem="mean_speed", label="Mean speed", value=speed, error=spread, dimension=(1, -1),
            definition="length of the step from one frame to the next, mean over droplets and "
            "frames", reason="" if known.any() else "no droplet is seen in two frames in a row",
        ),
        Quantity(
            stem="capillary_number", label="Capillary number", value=ca * speed,
            error=ca * spread, definition="viscosity times mean speed over interfacial tension, "
            "with the viscosity and the tension that were given", reason=no_ca,
        ),
        Quantity(
            stem="reynolds_number", label="Reynolds number", value=re * speed, error=re * spread,
            definition="density times mean speed times median diameter over viscosity, with the "
            "density and the viscosity that were given", reason=no_re,
        ),
    ]  # fmt: skip


def _circulation(around: Turns, rng: np.random.Generator) -> list[Quantity]:
    mean, error = ratio_and_error(around.sums[:, None], around.counts[:, None], rng)
    rate, spread = float(mean[0]), float(error[0])
    known = np.isfinite(around.steps)
    reason = "" if known.any() else "no droplet moves around another"
    chance = float("nan")
    turned = 0.0
    if known.any():
        longest = around.counts[around.counts > 0]
        turned = abs(rate) * float(longest.mean()) / (2 * np.pi)
        rms = math.sqrt(float(np.mean(around.steps[known] ** 2)))
        chance = rms / math.sqrt(float(longest.mean()))
    too_little = "" if turned >= 0.5 else f"droplets turn by {turned:.2g} of a turn on average"
    none = bool(reason or too_little)
    return [
        Quantity(
            stem="angular_velocity_rad", label="Angular velocity", value=rate, error=spread,
            null=chance, null_model="steps as large whose sense is at random", dimension=RATE,
            definition="step of the angle around the centre (--centre, or the mean of the "
            "droplets of the frame), rad, mean over droplets and frames; above 0 clockwise, as "
            "one sees the image", reason=reason,
        ),
        Quantity(
            stem="circulation_period", label="Time of one turn",
            value=float("nan") if none else 2 * np.pi / abs(rate),
            error=float("nan") if none else 2 * np.pi / rate**2 * spread, dimension=TIME,
            definition="2 pi over the angular velocity, where droplets make at least half a turn",
            reason=reason or too_little,
        ),
    ]  # fmt: skip


def _passage_rows(found: Sequence[Passage]) -> list[dict[str, Value]]:
    return [dict(asdict(one)) for one in found]


def _stay_row(one: Stay) -> dict[str, Value]:
    return {
        **asdict(one),
        "whole": int(one.whole),
        "n_frames": one.last_frame - one.first_frame + 1,
    }


def _notes(around: Turns) -> list[str]:
    known = around.steps[np.isfinite(around.steps)]
    if len(known) and np.mean(np.abs(known) > np.pi / 2) > 0.01:
        return ["Some steps are a quarter of a turn or more: turns may be counted the wrong way."]
    return []
