"""Command: trajectories in other programs' formats and back, ``python -m droptrack.convert``."""

import functools
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.formats.choice import FORMATS, FormatName, format_by_suffix, format_of, lost_in
from droptrack.data.formats.table import Table, described
from droptrack.errors import DroptrackError
from droptrack.options import FpsOption, KnownLengthOption, UmPerPxOption, units_from

app = new_app()


@app.command()
@one_line_errors
def main(
    trajectories: Annotated[
        Path, typer.Argument(help="trajectories.csv, or a file of one of the other formats.")
    ],
    out: Annotated[Path, typer.Argument(help="The file to write, or folder of Darknet's labels.")],
    to: Annotated[
        FormatName | None, typer.Option(help="The format to write; default: by OUT's suffix.")
    ] = None,
    from_: Annotated[
        FormatName | None,
        typer.Option("--from", help="The format to read; default: by what is in the file."),
    ] = None,
    um_per_px: UmPerPxOption = None,
    known_length: KnownLengthOption = None,
    fps: FpsOption = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Image size, px, where the file does not say."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(help="Only these: 0,10,20 or START:STOP:STEP, as for Darknet's labels."),
    ] = None,
) -> None:
    """Convert trajectories to other programs' formats, and back.

    What a format cannot hold is said.
    """
    say = functools.partial(typer.echo, err=True)
    if out.resolve() == trajectories.resolve():
        raise DroptrackError(f"{out}: would be overwritten; choose another name")
    to = format_by_suffix(out) if to is None else to
    source = format_of(trajectories) if from_ is None else from_
    reader = FORMATS[source].read
    if reader is None:
        raise DroptrackError(f"{trajectories}: {source} can be written, not read")
    units = units_from(um_per_px, known_length, fps)
    table = _chosen(described(reader(trajectories, units.um_per_px), units, size), frames)
    for note in table.notes:
        say(f"{trajectories}: {note}")
    lost = lost_in(to, table)
    if lost:
        say(f"{out}: {to} cannot hold {', '.join(lost)}")
    FORMATS[to].write(out, table)
    n_tracks = len(np.unique(table.rows.track_id))
    typer.echo(f"{out}: {to}, {len(table.rows)} rows of {n_tracks} droplets")


def _chosen(table: Table, frames: str | None) -> Table:
    """Only the frames that the user chose."""
    if frames is None:
        return table
    try:
        if ":" in frames:
            parts = [int(part) if part else None for part in frames.split(":")]
            if len(parts) > 3:
                raise ValueError
            chosen = list(range(table.n_frames)[slice(*parts)])
        else:
            chosen = [int(part) for part in frames.split(",")]
    except ValueError:
        raise DroptrackError(f"--frames {frames}: should be 0,10,20 or START:STOP:STEP") from None
    rows = table.rows[np.isin(table.rows.frame, np.asarray(chosen, np.int64))]
    if not len(rows):
        raise DroptrackError(f"--frames {frames}: there are no droplets in them")
    return Table(rows=rows, about=table.about, notes=table.notes)


if __name__ == "__main__":
    app()
