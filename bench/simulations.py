"""Speed of the simulations over grid size, droplets and threads, ``python -m bench.simulations``.

Each line: milliseconds a step and million lattice updates (nodes times steps) a second, and how
that compares with the first line of its table, measured in the same run.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import typer

from data_gen import color_gradient as cg
from data_gen import free_energy as fe
from data_gen.constriction import PAPER, SMALL
from data_gen.settings import compiled
from droptrack.command_line import new_app, one_line_errors

SECONDS = 3.0  # a measurement
app = new_app()


def updates_a_second(engine: Any, nodes: int) -> float:
    """Lattice updates a second of a running engine, after a start that is not counted."""
    engine.run(4)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < SECONDS:
        engine.run(16)
        steps += 16
    return steps * nodes / (time.perf_counter() - start)


def table(title: str, cases: dict[str, Callable[[], tuple[Any, int]]]) -> None:
    """Measure and print the cases; each makes an engine and says how many nodes it has."""
    typer.echo(title)
    first = 0.0
    for name, make in cases.items():
        engine, nodes = make()
        speed = updates_a_second(engine, nodes)
        first = first or speed
        typer.echo(
            f"  {name:28} {1e3 * nodes / speed:8.3f} ms a step {speed / 1e6:8.1f} M updates/s"
            f"  x {speed / first:.2f}"
        )


def shear(params: fe.Params) -> tuple[Any, int]:
    """A free-energy engine."""
    engine = compiled("free_energy_engine").Engine(params, fe.initial_state(params))
    return engine, params.width * params.height


def constriction(params: Any) -> tuple[Any, int]:
    """A colour-gradient engine."""
    engine = compiled("color_gradient_engine").Engine(params, cg.initial_state(params))
    return engine, params.width * params.height


@app.command()
@one_line_errors
def bench(threads: int = 0) -> None:
    """Print tables for both simulations."""
    compiled("free_energy_engine", threads)
    base = fe.Params(rest_steps=0)
    table(
        "free energy, 340 x 170",
        {
            "four cores in windows": lambda: shear(base),
            "two cores in windows": lambda: shear(replace(base, cores=2)),
            "four cores on the whole grid": lambda: shear(replace(base, window=0)),
            "680 x 340, four in windows": lambda: shear(replace(base, width=680, height=340)),
        },
    )
    table(
        "colour gradient",
        {
            "392 x 205, no droplets": lambda: constriction(replace(SMALL, droplets=0)),
            "392 x 205, 7 droplets": lambda: constriction(replace(SMALL, droplets=7)),
            "392 x 205, 19 droplets": lambda: constriction(SMALL),
            "1,200 x 600, no droplets": lambda: constriction(replace(PAPER, droplets=0)),
            "1,200 x 600, 49 droplets": lambda: constriction(PAPER),
        },
    )


if __name__ == "__main__":
    app()
