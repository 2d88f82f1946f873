"""The whole paper from one command, ``python -m bench.reproduce``: one page, its figures, numbers.

``make reproduce`` calls it. Interrupted, it goes on where it was.
"""

import time
from pathlib import Path
from typing import Annotated

import typer

from bench.reproduction.data_sets import make_data_sets
from bench.reproduction.evaluation import evaluate_all, not_reached
from bench.reproduction.flock import analyse
from bench.reproduction.folder import Given, Reproduction, Stage, run_stages
from bench.reproduction.networks import existing, make_networks
from bench.reproduction.page import write_page
from bench.reproduction.real import depends_on as real_images
from bench.reproduction.real import score_real
from bench.reproduction.settings import SCALES, Size
from bench.reproduction.simulations import simulate
from bench.reproduction.speed import measure_speed
from bench.reproduction.tracking import depends_on as full_network
from bench.reproduction.tracking import track_all
from data_gen.lattice_boltzmann.settings import Device
from droptrack.command_line import new_app, one_line_errors
from droptrack.errors import DroptrackError

STAGES = (
    Stage("data_sets", make_data_sets),
    Stage("networks", make_networks, existing),
    Stage("simulations", simulate),
    Stage("tracking", track_all, full_network),
    Stage("evaluation", evaluate_all, full_network),
    Stage("speed", measure_speed),
    Stage("flock", analyse),
    Stage("real", score_real, real_images),
    Stage("page", write_page),
)

app = new_app()


@app.command()
@one_line_errors
def main(
    scale: Annotated[
        Size, typer.Option(help="small: minutes; paper: the sizes of the paper.")
    ] = "small",
    out: Annotated[Path, typer.Option(help="Folder for everything.")] = Path("reproduction"),
    stage: Annotated[
        str | None,
        typer.Option(help=f"Run again from this stage on: {', '.join(s.name for s in STAGES)}."),
    ] = None,
    tiny_weights: Annotated[
        Path | None, typer.Option(help="YOLOv3-tiny, trained; default: that of make train-tiny.")
    ] = None,
    full_weights: Annotated[
        Path | None, typer.Option(help="YOLOv3, trained; default: that of make train.")
    ] = None,
    real: Annotated[
        Path | None, typer.Option(help="Labelled real images, a folder a set (bench real).")
    ] = None,
    device: Annotated[
        Device, typer.Option(help="What simulates; auto: a GPU where one works.")
    ] = "cpu",
) -> None:
    """Make the paper's data sets, networks, flows, figures, tables and numbers, and one page.

    Run again, it goes on where it was interrupted.
    """
    start = time.perf_counter()
    given = Given(tiny_weights=tiny_weights, full_weights=full_weights, real=real, device=device)
    of = Reproduction(out, SCALES[scale], given)
    run_stages(of, STAGES, lambda text: typer.echo(text, err=True), stage)
    for line in of.result("page")["gates"]:
        typer.echo(line)
    minutes = (time.perf_counter() - start) / 60
    typer.echo(f"{out / 'index.html'}: {minutes:.1f} minutes; numbers in {out / 'results.json'}")
    missed = not_reached(of.result("evaluation")["gates"])
    if missed:
        raise DroptrackError(f"not reached: {'; '.join(missed)}")


if __name__ == "__main__":
    app()
