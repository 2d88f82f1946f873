"""Command: a multi-core emulsion between walls that move against each other (appendix B)."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from scipy import ndimage

from data_gen.lattice_boltzmann import lattice
from data_gen.lattice_boltzmann.camera import Camera
from data_gen.lattice_boltzmann.free_energy import reference as fe
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
    from data_gen.lattice_boltzmann.free_energy.solver import Solver

CORE_DISTANCE = {1: 0.0, 2: 18.0, 3: 21.0, 4: 24.0}  # of the centres from the middle
STEPS = {"small": 80_000, "paper": 150_000}  # about half a turn and a whole one


class Shear:
    """The simulation as the recorder sees it."""

    name = "shear"

    def __init__(self, params: fe.Params, state: fe.State, device: Device = "cpu") -> None:
        self.params = params
        self.parameters: Mapping[str, object] = asdict(params)
        self._start = fe.masses(fe.initial_state(params))
        self._make: type[Solver] = solver_class("free_energy", device)
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
        """The cores."""
        return fe.patches(self.params, self._solver.state)

    def shade(self) -> Floats:
        """White cores in a black shell on white."""
        return fe.shade(self.params, self._solver.state)

    def unstable(self) -> str | None:
        """Values that are not finite, or fast, or far from where the model holds."""
        state = self._solver.state
        rho = lattice.density(state.f)
        if not (np.isfinite(rho).all() and np.isfinite(state.outer).all()):
            return "values that are not finite"
        if abs(rho / self.params.rho_0 - 1).max() > 0.2:
            return f"density from {rho.min():.3g} to {rho.max():.3g}"
        speed = np.hypot(*lattice.momentum(state.f)).max() / self.params.rho_0
        if speed > 0.3:
            return f"velocity {speed:.3g}"
        highest = max((core.max() for core in state.cores), default=0.0)
        if not highest < 2 * self.params.psi_0:
            return f"a field of {highest:.3g}, psi_0 is {self.params.psi_0:g}"
        return None

    def checks(self) -> dict[str, float]:
        """Largest drift of a mass, density, velocity, and the pieces of the worst core."""
        state = self._solver.state
        rho = lattice.density(state.f)
        u = fe.velocity(state, fe.forces(self.params, state)[0])
        pieces = [ndimage.label(p > 0.5)[1] for p, _ in self.patches()]
        drift = np.abs(fe.masses(state) / self._start - 1)
        return {
            "mass_drift": float(drift.max()),
            "density_min": float(rho.min()),
            "density_max": float(rho.max()),
            "velocity_max": float(np.hypot(*u).max()),
            "pieces": float(max(pieces, default=0)),
            "droplets": float(sum(n > 0 for n in pieces)),
        }

    def finished(self) -> bool:
        """Never before the last step."""
        return False

    def arrays(self) -> dict[str, Any]:
        """The state, for a checkpoint."""
        return dict(vars(self._solver.state))

    def load(self, arrays: Any) -> None:
        """Go on from a checkpoint's state."""
        state = fe.State(**(dict(arrays) | {"step": int(arrays["step"])}))
        self._solver = self._make(self.params, state)


def shear(
    out: Annotated[Path, typer.Option(help="Folder for the video, the truth and all else.")],
    cores: Annotated[int, typer.Option(min=1, max=4)] = 4,
    size: Annotated[
        Literal["small", "paper"], typer.Option(help="Half a turn, or a whole one.")
    ] = "small",
    steps: Annotated[int | None, typer.Option(min=1, help="Of shear, after the rest.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Steps a frame.")] = 500,
    scale: Annotated[int, typer.Option(help="Pixels a lattice node.")] = 1,
    blur: Annotated[float, typer.Option(help="Sigma of the camera's blur, px.")] = 0.0,
    noise: Annotated[float, typer.Option(help="Sigma of its noise, grey levels.")] = 0.0,
    uneven: Annotated[float, typer.Option(help="How much darker a corner is, 0..1.")] = 0.0,
    fps: Annotated[int, typer.Option(min=1)] = 25,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 0,
    device: Annotated[Device, typer.Option(help="auto: a GPU where one works.")] = "cpu",
    threads: Annotated[int, typer.Option(min=0, help="Of the CPU; 0: all.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter, such as viscosity=1.2.")
    ] = None,
) -> None:
    """Cores in a shell in shear: white cores in a black shell, turning clockwise."""
    params = fe.Params(cores=cores, core_distance=CORE_DISTANCE[cores])
    params = changed(params, change or [])
    if params.cores < 1:
        raise DroptrackError("cores 0: a video needs one or more")
    camera = Camera(scale=scale, blur_px=blur, noise=noise, uneven=uneven, seed=seed)
    last = params.rest_steps + (steps or STEPS[size])
    recording = Recording(params.rest_steps, last, every, fps, camera)
    use_threads(threads)
    device = usable_device(device, lambda text: typer.echo(text, err=True))
    simulation = Shear(params, fe.initial_state(params), device)
    typer.echo(SimulationRecorder(simulation, out, recording).run(resume=resume))
