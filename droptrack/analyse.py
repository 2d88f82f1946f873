"""Command: the physics of trajectories, ``python -m droptrack.analyse``."""

import functools
import inspect
import shlex
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from droptrack.analysis.choice import ANALYSES, Asked, Config
from droptrack.analysis.flock.report import PAPER_THRESHOLD, FlockConfig
from droptrack.analysis.flow.report import FlowConfig
from droptrack.analysis.motion.report import DEFAULT_LAG, MotionConfig
from droptrack.analysis.records import Analysis
from droptrack.analysis.size.report import SizeConfig
from droptrack.analysis.structure.report import (
    DEFAULT_PERSISTENCE,
    DEFAULT_REACH,
    StructureConfig,
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

USAGE_ERROR: Any = typer.BadParameter.__base__  # Typer does not name it

app = new_app()
CONFIGURED: dict[str, Callable[..., Config]] = {}  # what makes of options what each analysis takes


@app.callback()
def main() -> None:
    """Quantities that papers report, of any trajectories, with errors and null models."""


def _analysis(name: str) -> Callable[[Callable[..., Config]], Callable[..., Config]]:
    """Make a command of what its own options configure, with those that all analyses have."""

    def add(configured: Callable[..., Config]) -> Callable[..., Config]:
        def command(
            trajectories: TrajectoriesArgument,
            out: OutOption,
            um_per_px: UmPerPxOption = None,
            known_length: KnownLengthOption = None,
            fps: FpsOption = None,
            size: ImageSizeOption = None,
            overwrite: AgainOption = False,
            **own: Any,
        ) -> None:
            check_free(out, name, overwrite=overwrite)
            table = _read(trajectories, um_per_px, known_length, fps, size)
            found = Asked(name, configured(**own)).of(table)
            _write(out, name, found, table, trajectories)

        common = list(inspect.signature(command).parameters.values())
        mine = inspect.signature(configured).parameters.values()
        *own, seed = (one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in mine)
        *rest, overwrite = (
            one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in common[2:-1]
        )
        parameters = [*common[:2], *own, *rest, seed, overwrite]
        command.__doc__ = configured.__doc__
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in parameters}
        app.command(name)(one_line_errors(command))
        CONFIGURED[name] = configured
        return configured

    return add


@_analysis("flock")
def flock(
    radius: RadiusOption = None,
    radius_diameters: Annotated[
        float | None,
        typer.Option(metavar="K", help="The same in median diameters; default: 1.5."),
    ] = None,
    threshold: Annotated[
        float, typer.Option(metavar="RAD", help="Aligned is what differs by less, rad.")
    ] = PAPER_THRESHOLD,
    seed: SeedOption = 0,
) -> Config:
    """Whether droplets go the way of their neighbours, and how much of that is chance."""
    return FlockConfig(
        radius_px=radius,
        radius_diameters=radius_diameters,
        threshold_rad=threshold,
        seed=seed,
    )


@_analysis("motion")
def motion(
    radius: RadiusOption = None,
    radius_diameters: Annotated[
        float | None,
        typer.Option(metavar="K", help="The same in median diameters; default: 2."),
    ] = None,
    lag: Annotated[
        int, typer.Option(metavar="FRAMES", help="Of the non-affine displacement.")
    ] = DEFAULT_LAG,
    seed: SeedOption = 0,
) -> Config:
    """Mean square displacement, velocities and their profiles, fluctuations, non-affine motion."""
    return MotionConfig(radius_px=radius, radius_diameters=radius_diameters, lag=lag, seed=seed)


@_analysis("structure")
def structure(
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
    seed: SeedOption = 0,
) -> Config:
    """Pair correlation, Voronoi cells, neighbours, hexatic order, rearrangements (T1)."""
    return StructureConfig(
        region=region, periodic=periodic, reach=reach, persistence=persistence, seed=seed
    )


@_analysis("flow")
def flow(
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
    seed: SeedOption = 0,
) -> Config:
    """Passages, intervals and clogs, residence, flow rate, Ca and Re, circulation."""
    return FlowConfig(
        line=line,
        region=region,
        clog_frames=clog,
        viscosity=viscosity,
        tension=tension,
        density=density,
        centre=centre,
        seed=seed,
    )


@_analysis("size")
def sizes(
    seed: SeedOption = 0,
) -> Config:
    """Sizes, polydispersity, Sauter diameter, deformation against the place."""
    return SizeConfig(seed=seed)


def asked_for(texts: Iterable[str]) -> tuple[Asked, ...]:
    """What texts such as ``size,motion``, ``flow --line 90,0,90,400`` or ``all`` ask for.

    Names with commas between them, or one with the options that its command has. Raises
    DroptrackError for what cannot be, and for an analysis that is asked for twice.
    """
    asked: dict[str, Asked] = {}
    for text in texts:
        try:
            first, *words = shlex.split(text) or [""]
        except ValueError as error:  # quotes that do not end
            raise DroptrackError(f"--analyse {text}: {error}") from None
        names = list(ANALYSES) if first == "all" else [name.strip() for name in first.split(",")]
        for name in names:
            if name not in CONFIGURED:
                known = ", ".join(ANALYSES)
                raise DroptrackError(f"--analyse {text}: {name!r} is none of {known} and all")
            if name in asked:
                raise DroptrackError(f"--analyse {text}: {name} is asked for twice")
            if words and len(names) > 1:
                raise DroptrackError(f"--analyse {text}: options are of one analysis each")
            asked[name] = Asked(name, _configured(name, words))
    return tuple(asked.values())


def _configured(name: str, words: list[str]) -> Config:
    """What the options of an analysis say; raises DroptrackError."""
    command = _parser_of(name)
    try:
        with command.make_context(name, words) as context:
            config: Config = command.invoke(context)
    except USAGE_ERROR as error:
        said = " ".join(error.format_message().split())
        raise DroptrackError(f"--analyse {name}: {said}") from None
    return config


@functools.cache
def _parser_of(name: str) -> Any:
    parser = new_app()
    parser.command()(CONFIGURED[name])
    return typer.main.get_command(parser)


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
