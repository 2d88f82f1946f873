"""Report what a simulation did, from its folder, ``python -m bench.simulation_report DIR ...``.

For shear: the angle that the cores have turned clockwise, the steps of a whole turn, how their
areas and distances changed. For both: the extremes of all that was checked in every frame.
"""

import csv
import json
from pathlib import Path

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.arrays import Floats

app = new_app()


def columns(path: Path) -> dict[str, Floats]:
    """The columns of a table of numbers."""
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def rotation(truth: dict[str, Floats], steps: Floats) -> None:
    """Print how cores turned; steps (F,) of the frames since the shear began."""
    n = int(truth["track_id"].max())
    place = (truth["x"] + 1j * truth["y"]).reshape(-1, n)
    place -= place.mean(axis=1, keepdims=True)
    angle = np.degrees(np.unwrap(np.angle(place), axis=0))  # image y points down: clockwise
    turned = angle - angle[0]
    for step in (15_000, 30_000, 70_000, 150_000):
        if step <= steps[-1]:
            each = [f"{np.interp(step, steps, mine):.1f}" for mine in turned.T]
            mean = np.interp(step, steps, turned.mean(axis=1))
            typer.echo(f"  turned at {step:7}  {mean:6.1f} deg, each {' '.join(each)}")
    if (turned[-1] > 360).all():
        whole = [np.interp(360, mine, steps) for mine in turned.T]
        turns = " ".join(f"{step:.0f}" for step in whole)
        typer.echo(f"  one turn         {np.mean(whole):8.0f} steps, each {turns}")
    backward = int((np.diff(turned, axis=0) <= 0).sum())
    typer.echo(f"  not clockwise    {backward} of {turned.size - n} moves between frames")
    area = truth["area"].reshape(-1, n)
    typer.echo(f"  area             {(area / area[0]).min():.4f} to {(area / area[0]).max():.4f}")
    gaps = np.abs(place[:, :, None] - place[:, None])[:, ~np.eye(n, dtype=bool)]
    if gaps.size:
        typer.echo(f"  minimum distance {gaps.min():.1f}")


@app.command()
@one_line_errors
def report(folders: list[Path]) -> None:
    """Print what the simulations in these folders did."""
    for folder in folders:
        about = json.loads((folder / "parameters.json").read_text())
        checks = columns(folder / "checks.csv")
        typer.echo(f"{folder}: {about['simulation']}, {len(checks['step'])} frames")
        if about["simulation"] == "shear" and about["parameters"]["cores"] > 1:
            steps = checks["step"] - about["parameters"]["rest_steps"]
            rotation(columns(folder / "truth.csv"), steps)
        for name, values in checks.items():
            typer.echo(f"  {name:16} {values.min():.6g} to {values.max():.6g}")


if __name__ == "__main__":
    app()
