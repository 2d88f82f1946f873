"""Command: the physics of trajectories, ``python -m droptrack.analyse``."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from droptrack.analysis.flock.report import PAPER_THRESHOLD, FlockConfig, analyse_flock
from droptrack.analysis.flow.report import FlowConfig, analyse_flow
from droptrack.analysis.motion.report import DEFAULT_LAG, MotionConfig, analyse_motion
from droptrack.analysis.records import Analysis
from droptrack.analysis.size.report import SizeConfig, analyse_size
from droptrack.analysis.structure.report import (
    DEFAULT_PERSISTENCE,
    DEFAULT_REACH,
    StructureConfig,
    analyse_structure,
)
from droptrack.analysis.writing import check_free, write_analysis
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.formats.choice import FORMATS, format_of
from droptrack.data.formats.table import Table, described
from droptrack.errors import DroptrackError
from droptrack.options import FpsOption, KnownLengthOption, UmPerPxOption, units_from

TrajectoriesArgument = Annotated[
    Path, typer.Argument(help="trajectories.csv, or a file that droptrack convert reads.")
]
OutOption = Annotated[Path, typer.Option(help="Folder for the results.")]
ImageSizeOption = Annotated[
    str | None,
    typer.Option(metavar="WxH", help="Image size, px, where the file does not say."),
]
AgainOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace the results of an earlier analysis.")
]
RadiusOption = Annotated[
    float | None, typer.Option(metavar="PX", help="Radius of the neighbourhood, px.")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Of shuffles and of the bootstrap.")]

app = new_app()


@app.callback()
def main() -> None:
    """Quantities that papers report, of any trajectories, with errors and null models."""


@app.command()
@one_line_errors
def flock(
    trajectories: TrajectoriesArgument,
    out: OutOption,
    radius: RadiusOption = None,
    radius_diameters: Annotated[
        float | None,
        typer.Option(metavar="K", help="The same in median diameters; default: 1.5."),
    ] = None,
    threshold: Annotated[
        float, typer.Option(metavar="RAD", help="Aligned is what differs by less, rad.")
    ] = PAPER_THRESHOLD,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: ImageSizeOption = None,
    seed: SeedOption = 0,
    overwrite: AgainOption = False,
) -> None:
    """Whether droplets go the way of their neighbours, and how much of that is chance."""
    check_free(out, "flock", overwrite=overwrite)
    table = _read(trajectories, um_per_px, known_length, fps, size)
    config = FlockConfig(
        radius_px=radius,
        radius_diameters=radius_diameters,
        threshold_rad=threshold,
        seed=seed,
    )
    _write(out, "flock", analyse_flock(table, config), table, trajectories)


@app.command()
@one_line_errors
def motion(
    trajectories: TrajectoriesArgument,
    out: OutOption,
    radius: RadiusOption = None,
    radius_diameters: Annotated[
        float | None,
        typer.Option(metavar="K", help="The same in median diameters; default: 2."),
    ] = None,
    lag: Annotated[
        int, typer.Option(metavar="FRAMES", help="Of the non-affine displacement.")
    ] = DEFAULT_LAG,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: ImageSizeOption = None,
    seed: SeedOption = 0,
    overwrite: AgainOption = False,
) -> None:
    """Mean square displacement, velocities and their profiles, fluctuations, non-affine motion."""
    check_free(out, "motion", overwrite=overwrite)
    table = _read(trajectories, um_per_px, known_length, fps, size)
    config = MotionConfig(radius_px=radius, radius_diameters=radius_diameters, lag=lag, seed=seed)
    _write(out, "motion", analyse_motion(table, config), table, trajectories)


@app.command()
@one_line_errors
def structure(
    trajectories: TrajectoriesArgument,
    out: OutOption,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y X,Y X,Y... | FILE",
            help="Where droplets can be: a polygon, px, or an image that is black elsewhere; "
            "default: in the whole image.",
        ),
    ] = None,
    periodic: Annotated[
        bool, typer.Option("--periodic", help="The image is a periodic box.")
    ] = False,
    reach: Annotated[
        float,
        typer.Option(metavar="K", help="Neighbours are at most so many mean diameters apart."),
    ] = DEFAULT_REACH,
    persistence: Annotated[
        int, typer.Option(metavar="FRAMES", help="How long a change of neighbours has to last.")
    ] = DEFAULT_PERSISTENCE,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: ImageSizeOption = None,
    seed: SeedOption = 0,
    overwrite: AgainOption = False,
) -> None:
    """Pair correlation, Voronoi cells, neighbours, hexatic order, rearrangements (T1)."""
    check_free(out, "structure", overwrite=overwrite)
    table = _read(trajectories, um_per_px, known_length, fps, size)
    config = StructureConfig(
        region=region, periodic=periodic, reach=reach, persistence=persistence, seed=seed
    )
    _write(out, "structure", analyse_structure(table, config), table, trajectories)


@app.command()
@one_line_errors
def flow(
    trajectories: TrajectoriesArgument,
    out: OutOption,
    line: Annotated[
        str | None,
        typer.Option(metavar="X1,Y1,X2,Y2", help="Count what passes this line."),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="X1,Y1,X2,Y2[,X3,Y3...]",
            help="Stays in a rectangle by its corners, or in a polygon.",
        ),
    ] = None,
    clog: Annotated[
        float | None,
        typer.Option(
            metavar="FRAMES", help="Longer intervals are clogs; default: ten times their median."
        ),
    ] = None,
    viscosity: Annotated[
        float | None, typer.Option(metavar="PA_S", help="Of the liquid around, Pa s.")
    ] = None,
    tension: Annotated[
        float | None, typer.Option(metavar="N_PER_M", help="Interfacial tension, N/m.")
    ] = None,
    density: Annotated[
        float | None, typer.Option(metavar="KG_PER_M3", help="Of the liquid around, kg/m³.")
    ] = None,
    centre: Annotated[
        str | None,
        typer.Option(metavar="X,Y", help="What droplets turn around; default: their mean place."),
    ] = None,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: ImageSizeOption = None,
    seed: SeedOption = 0,
    overwrite: AgainOption = False,
) -> None:
    """Passages, intervals and clogs, residence, flow rate, Ca and Re, circulation."""
    check_free(out, "flow", overwrite=overwrite)
    table = _read(trajectories, um_per_px, known_length, fps, size)
    config = FlowConfig(
        line=line,
        region=region,
        clog_frames=clog,
        viscosity=viscosity,
        tension=tension,
        density=density,
        centre=centre,
        seed=seed,
    )
    _write(out, "flow", analyse_flow(table, config), table, trajectories)


@app.command("size")
@one_line_errors
def sizes(
    trajectories: TrajectoriesArgument,
    out: OutOption,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: ImageSizeOption = None,
    seed: SeedOption = 0,
    overwrite: AgainOption = False,
) -> None:
    """Sizes, polydispersity, Sauter diameter, deformation against the place."""
    check_free(out, "size", overwrite=overwrite)
    table = _read(trajectories, um_per_px, known_length, fps, size)
    _write(out, "size", analyse_size(table, SizeConfig(seed=seed)), table, trajectories)


def _read(
    trajectories: Path,
    um_per_px: float | None,
    known_length: str | None,
    fps: float | None,
    size: str | None,
) -> Table:
    """The table of a file, with what the options say of it; refuses one without rows."""
    reader = FORMATS[format_of(trajectories)].read
    if reader is None:
        raise DroptrackError(f"{trajectories}: cannot be read")
    units = units_from(um_per_px, known_length, fps)
    table = described(reader(trajectories, units.um_per_px), units, size)
    if not len(table.rows):
        raise DroptrackError(f"{trajectories}: has no droplets")
    for note in table.notes:
        typer.echo(f"{trajectories}: {note}", err=True)
    return table


def _write(out: Path, name: str, found: Analysis, table: Table, source: Path) -> None:
    found = replace(found, settings={"trajectories": str(source), **found.settings})
    write_analysis(out, name, found, table.units).print()
    for note in found.notes:
        typer.echo(note, err=True)
    typer.echo(f"results in {out}: {name}.html, {name}.json, tables and pictures")


if __name__ == "__main__":
    app()
