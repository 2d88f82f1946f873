"""Command: what happened to the droplets of a table, ``python -m droptrack.events``."""

import functools
from pathlib import Path
from typing import Annotated

import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.formats.choice import FORMATS, format_of
from droptrack.data.formats.table import Table, described
from droptrack.errors import DroptrackError
from droptrack.options import (
    FpsOption,
    KnownLengthOption,
    LineOption,
    PlotsOption,
    UmPerPxOption,
    units_from,
)
from droptrack.pipeline.report_events import EventsConfig, write_events

app = new_app()


@app.command()
@one_line_errors
def main(
    trajectories: Annotated[
        Path, typer.Argument(help="trajectories.csv, or a file that droptrack convert reads.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    line: LineOption = None,
    region: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X1,Y1,X2,Y2[,X3,Y3...]",
            help="Stays in a rectangle by its corners, or in a polygon; repeat for more.",
        ),
    ] = None,
    plots: PlotsOption = "",
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Image size, px, where the file does not say."),
    ] = None,
) -> None:
    """Coalescence, break-up, entering, leaving, passages of lines, stays in regions.

    Writes events.csv, passages.csv, stays.csv, report.json, and trajectories.csv in which droplets
    that came of others have identities of their own, and parents.
    """
    say = functools.partial(typer.echo, err=True)
    reader = FORMATS[format_of(trajectories)].read
    if reader is None:
        raise DroptrackError(f"{trajectories}: cannot be read")
    units = units_from(um_per_px, known_length, fps)
    table: Table = described(reader(trajectories, units.um_per_px), units, size)
    for note in table.notes:
        say(f"{trajectories}: {note}")
    config = EventsConfig(lines=tuple(line or ()), regions=tuple(region or ()), plots=plots)
    write_events(out, table, config).print()
    typer.echo(f"results in {out}")


if __name__ == "__main__":
    app()
