"""A simulation as the recorder sees it: a solver, and what is drawn and checked of its state."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from data_gen.lattice_boltzmann.settings import Device, solver_class
from droptrack.data.arrays import Floats


class Params(Protocol):
    """Parameters of a model, a dataclass; a grid of width x height nodes."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def width(self) -> int:
        """Nodes in x."""

    @property
    def height(self) -> int:
        """Nodes in y."""


class State(Protocol):
    """What a solver's steps change, a dataclass of arrays."""

    @property
    def step(self) -> int:
        """Steps done."""


P = TypeVar("P", bound=Params)
S = TypeVar("S", bound=State)


class Simulation(ABC, Generic[P, S]):
    """A running simulation: a model's solver on a device, from a state on."""

    name: ClassVar[str]
    model: ClassVar[str]  # the folder of its solvers

    def __init__(self, params: P, state: S, device: Device = "cpu") -> None:
        self.params = params
        self._make_solver = solver_class(self.model, device)
        self._solver = self._make_solver(params, state)

    @classmethod
    @abstractmethod
    def initial_state(cls, params: P) -> S:
        """Where a run with these parameters starts."""

    @property
    def parameters(self) -> Mapping[str, object]:
        """The parameters by name."""
        return asdict(self.params)

    @property
    def state(self) -> S:
        """The state now, as the solver gives it."""
        state: S = self._solver.state
        return state

    @property
    def step(self) -> int:
        """Steps done."""
        return self.state.step

    @property
    def device(self) -> str:
        """What it runs on."""
        device: str = self._solver.device
        return device

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in nodes."""
        return self.params.width, self.params.height

    def run(self, steps: int) -> None:
        """Advance."""
        self._solver.run(steps)

    @abstractmethod
    def patches(self) -> list[tuple[Floats, Floats]]:
        """For every droplet: its fraction (h, w) in 0..1, and the [y, x] of that array's corner."""

    @abstractmethod
    def shade(self) -> Floats:
        """Brightness (H, W) in 0..1, y up."""

    @abstractmethod
    def unstable(self) -> str | None:
        """What has gone wrong, if anything; cheap, asked every few steps."""

    @abstractmethod
    def checks(self) -> dict[str, float]:
        """Values to watch."""

    def finished(self) -> bool:
        """Whether the run may end before its last step."""
        return False

    def outcome(self) -> str:
        """What a summary should say of the end, if anything."""
        return ""

    def arrays(self) -> dict[str, Any]:
        """The state, for a checkpoint."""
        return dict(vars(self.state))

    def load(self, arrays: Mapping[str, Any]) -> None:
        """Resume from a checkpoint's state."""
        values = dict(arrays) | {"step": int(arrays["step"])}
        self._solver = self._make_solver(self.params, type(self.state)(**values))


AnySimulation = Simulation[Any, Any]
