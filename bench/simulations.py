"""Speed of the simulations over grid size, droplets and threads, ``python -m bench.simulations``.

Each line: milliseconds per step and million lattice updates (nodes times steps) per second, and how
that compares with the first line of its table, measured in the same run. Where a GPU works, each
table has lines of it too.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import typer

from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.constriction import PAPER, SMALL
from data_gen.lattice_boltzmann.free_energy import reference as fe
from data_gen.lattice_boltzmann.settings import Device, solver_class, usable_device, use_threads
from droptrack.command_line import new_app, one_line_errors

SECONDS = 3.0  # per measurement
Cases = dict[str, Callable[[], tuple[Any, int]]]
app = new_app()


def updates_a_second(running: Any, nodes: int) -> float:
    """Lattice updates per second of a running solver, after a start that is not counted."""
    running.run(4)
    first, start = running.state.step, time.perf_counter()
    while time.perf_counter() - start < SECONDS:
        running.run(16)
    steps: int = running.state.step - first  # a GPU may be behind what it was told, until asked
    return steps * nodes / (time.perf_counter() - start)


def table(title: str, cases: Cases) -> None:
    """Measure and print the cases; each makes a solver and says how many nodes it has."""
    typer.echo(title)
    first = 0.0
    for name, make in cases.items():
        running, nodes = make()
        speed = updates_a_second(running, nodes)
        first = first or speed
        typer.echo(
            f"  {name:28} {1e3 * nodes / speed:8.3f} ms per step {speed / 1e6:8.1f} M updates/s"
            f"  x {speed / first:.2f}"
        )


def shear(params: fe.Params, device: Device = "cpu") -> tuple[Any, int]:
    """A free-energy solver."""
    running = solver_class("free_energy", device)(params, fe.initial_state(params))
    return running, params.width * params.height


def constriction(params: Any, device: Device = "cpu") -> tuple[Any, int]:
    """A colour-gradient solver."""
    running = solver_class("color_gradient", device)(params, cg.initial_state(params))
    return running, params.width * params.height


@app.command()
@one_line_errors
def bench(threads: int = 0) -> None:
    """Print tables for both simulations."""
    use_threads(threads)
    device = usable_device("auto", typer.echo)
    base = fe.Params(rest_steps=0)
    cases: Cases = {
        "four cores in windows": lambda: shear(base),
        "two cores in windows": lambda: shear(replace(base, cores=2)),
        "four cores on the whole grid": lambda: shear(replace(base, window=0)),
        "680 x 340, four in windows": lambda: shear(replace(base, width=680, height=340)),
    }
    if device == "cuda":
        cases["four cores in windows, CUDA"] = lambda: shear(base, device)
    table("free energy, 340 x 170", cases)
    cases = {
        "392 x 205, no droplets": lambda: constriction(replace(SMALL, droplets=0)),
        "392 x 205, 7 droplets": lambda: constriction(replace(SMALL, droplets=7)),
        "392 x 205, 19 droplets": lambda: constriction(SMALL),
        "1,200 x 600, no droplets": lambda: constriction(replace(PAPER, droplets=0)),
        "1,200 x 600, 49 droplets": lambda: constriction(PAPER),
    }
    if device == "cuda":
        cases["392 x 205, 19, CUDA"] = lambda: constriction(SMALL, device)
        cases["1,200 x 600, 49, CUDA"] = lambda: constriction(PAPER, device)
    table("colour gradient", cases)


if __name__ == "__main__":
    app()
