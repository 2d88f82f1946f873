"""Command: a dense emulsion pushed through a constriction (appendix A)."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from scipy import ndimage

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.camera import Camera
from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.geometry import Params, solid_nodes
from data_gen.lattice_boltzmann.recording import Recording, SimulationRecorder
from data_gen.lattice_boltzmann.settings import (
    Device,
    changed,
    solver_class,
    usable_device,
    use_threads,
)
from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

if TYPE_CHECKING:
    from data_gen.lattice_boltzmann.color_gradient.solver import Solver

SMALL = Params()
PAPER = Params(
    height=600, throat_height=120, throat_length=240, inlet_length=370, outlet_length=590,
    droplets=49, radius=18.1, u_in=2e-3, window=116,
)  # fmt: skip
SIZES = {"small": SMALL, "paper": PAPER}
STEPS = {"small": 40_000, "paper": 250_000}  # at most
EVERY = {"small": 100, "paper": 400}


class Constriction:
    """The simulation as the recorder sees it."""

    name = "constriction"

    def __init__(self, params: Params, state: cg.State, device: Device = "cpu") -> None:
        self.params = params
        self.parameters: Mapping[str, object] = asdict(params)
        self._fluid = ~solid_nodes(params)
        self._start = cg.masses(state)
        self._make: type[Solver] = solver_class("color_gradient", device)
        self._solver: Solver = self._make(params, state)

    @property
    def step(self) -> int:
        """Steps done."""
        return self._solver.state.step

    @property
    def device(self) -> str:
        """What it runs on."""
        return self._solver.device

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in nodes."""
        return self.params.width, self.params.height

    def run(self, steps: int) -> None:
        """Advance."""
        self._solver.run(steps)

    def patches(self) -> list[tuple[Floats, Floats]]:
        """The droplets."""
        return cg.patches(self._solver.state)

    def shade(self) -> Floats:
        """White droplets on black."""
        return cg.shade(self._solver.state)

    def unstable(self) -> str | None:
        """Values that are not finite, densities or velocities out of range."""
        f = self._solver.state.f
        rho = lattice.density(f)[self._fluid]
        if not np.isfinite(rho).all():
            return "values that are not finite"
        if rho.min() < 0.5 or rho.max() > 1.5:
            return f"density from {rho.min():.3g} to {rho.max():.3g}"
        speed = np.hypot(*lattice.momentum(f)).max()
        return f"velocity {speed:.3g}" if speed > 0.4 else None

    def checks(self) -> dict[str, float]:
        """Largest drift of a droplet's mass, density, velocity, overlap, pieces, droplets out."""
        state = self._solver.state
        rho = lattice.density(state.f)[self._fluid]
        pieces = [ndimage.label(c > 0.5)[1] for c, _ in self.patches()]
        return {
            "mass_drift": float(np.abs(cg.masses(state) / self._start - 1).max(initial=0)),
            "density_min": float(rho.min()),
            "density_max": float(rho.max()),
            "velocity_max": float(np.hypot(*lattice.momentum(state.f)).max()),
            "label_sum_max": float(cg.label_sum(state).max()),
            "pieces": float(max(pieces, default=0)),
            "droplets": float(sum(n > 0 for n in pieces)),
            "through": float(self._through()),
        }

    def _through(self) -> int:
        """Droplets that are wholly in the outlet chamber."""
        end = self.params.inlet_length + self.params.throat_length
        inside = [((c > 0.5).any(axis=0), corner[1]) for c, corner in self.patches()]
        return sum(bool(x.any() and x.argmax() + x_0 >= end) for x, x_0 in inside)

    def finished(self) -> bool:
        """Whether every droplet is through."""
        return self._through() == self.params.droplets

    def arrays(self) -> dict[str, Any]:
        """The state, for a checkpoint; with the masses of the start."""
        return dict(vars(self._solver.state)) | {"start": self._start}

    def load(self, arrays: Any) -> None:
        """Go on from a checkpoint's state."""
        values = dict(arrays) | {"step": int(arrays["step"])}
        self._start = values.pop("start")
        self._solver = self._make(self.params, cg.State(**values))


def constriction(
    out: Annotated[Path, typer.Option(help="Folder for the video, the truth and all else.")],
    droplets: Annotated[int | None, typer.Option(min=1, help="19 small, 49 paper.")] = None,
    size: Annotated[
        Literal["small", "paper"], typer.Option(help="About 390 x 205, or 1,200 x 600.")
    ] = "small",
    seed: Annotated[int, typer.Option(min=0, help="Of the droplets' places and noise.")] = 0,
    steps: Annotated[int | None, typer.Option(min=1, help="At most, after the rest.")] = None,
    every: Annotated[int | None, typer.Option(min=1, help="Steps a frame.")] = None,
    scale: Annotated[int, typer.Option(help="Pixels a lattice node.")] = 1,
    blur: Annotated[float, typer.Option(help="Sigma of the camera's blur, px.")] = 0.0,
    noise: Annotated[float, typer.Option(help="Sigma of its noise, grey levels.")] = 0.0,
    uneven: Annotated[float, typer.Option(help="How much darker a corner is, 0..1.")] = 0.0,
    fps: Annotated[int, typer.Option(min=1)] = 25,
    device: Annotated[Device, typer.Option(help="auto: a GPU where one works.")] = "cpu",
    threads: Annotated[int, typer.Option(min=0, help="Of the CPU; 0: all.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter, such as sigma=0.04.")
    ] = None,
) -> None:
    """Droplets in a dense emulsion that squeezes through a constriction: white on black."""
    params = replace(SIZES[size], seed=seed)
    if droplets is not None:
        params = replace(params, droplets=droplets)
    params = changed(params, change or [])
    if params.droplets < 1:
        raise DroptrackError("droplets 0: a video needs one or more")
    last = params.rest_steps + (steps or STEPS[size])
    camera = Camera(scale=scale, blur_px=blur, noise=noise, uneven=uneven, seed=seed)
    recording = Recording(params.rest_steps, last, every or EVERY[size], fps, camera)
    use_threads(threads)
    device = usable_device(device, lambda text: typer.echo(text, err=True))
    simulation = Constriction(params, cg.initial_state(params), device)
    summary = SimulationRecorder(simulation, out, recording).run(resume=resume)
    through = int(simulation.checks()["through"])
    typer.echo(f"{summary}; {through} of {params.droplets} droplets through")
