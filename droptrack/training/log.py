"""The record of a training, whichever program trains: training.csv, training.png, run.json."""

import csv
import json
import math
import os
import platform
import sys
import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from types import TracebackType

import numpy as np

from droptrack.data.files import read_text, write_text
from droptrack.errors import DroptrackError, UnwritableError
from droptrack.version import __version__

REDRAW_SECONDS = 30.0


@dataclass(frozen=True, kw_only=True)
class Step:
    """What one iteration did; NaN where a trainer does not say, `mean_ap` where none was measured.

    `loss` is the number that Darknet prints, whichever program trains: the squared gradients of the
    maps, summed over an image and averaged over images and heads. What PyTorch minimises is
    `regression` + `objectness` + `classes`, per image. `rewritten` is the share of ground truths
    whose cell and anchor another one took (Darknet: since its start).
    """

    iteration: int
    loss: float
    average_loss: float  # see running_average
    regression: float
    objectness: float
    classes: float
    rewritten: float
    learning_rate: float
    seconds: float
    images: int
    mean_ap: float


def running_average(average: float, loss: float) -> float:
    """Darknet's average of the loss; it starts with the first loss, and again after a NaN."""
    return loss if math.isnan(average) else 0.9 * average + 0.1 * loss


def diverged(folder: Path, step: Step) -> DroptrackError:
    """The error for a loss, or its gradient, that is no number any more."""
    return DroptrackError(
        f"{folder}: the loss or its gradient became NaN or infinite at iteration {step.iteration}, "
        f"at a rate of {step.learning_rate:g}; start again, in another --out, with a smaller "
        "--learning-rate"
    )


class TrainingLog:
    """training.csv, a row an iteration at once, and training.png (the paper's figure 6) beside it.

    A resumed training keeps the rows up to the iteration it resumes from. Raises DroptrackError for
    a training.csv that this program did not write.
    """

    def __init__(self, folder: Path, resumed_at: int) -> None:
        self.path, self._drawn = folder / "training.csv", time.monotonic()
        self.mean_aps: list[float] = []  # all that were measured
        self.average_loss = math.nan
        self._rewrite([s for s in read_log(self.path) if s.iteration <= resumed_at])

    def __enter__(self) -> "TrainingLog":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        self._draw()

    def append(self, step: Step) -> None:
        """Write a row, whole or not; every REDRAW_SECONDS, draw training.png again."""
        data = _row(step).encode()
        try:
            n_written = self._file.write(data) or 0
            if n_written < len(data):
                n_written += self._file.write(data[n_written:]) or 0
        except OSError as error:
            raise UnwritableError(
                f"{self.path}: cannot be written: {error.strerror}", error.errno
            ) from None
        self._remember(step)
        if time.monotonic() - self._drawn > REDRAW_SECONDS:
            self._draw()

    def set_mean_ap(self, iteration: int, mean_ap: float) -> None:
        """Enter the mAP of an iteration whose row is written already."""
        self._file.close()
        steps = read_log(self.path)
        self._rewrite(
            [replace(s, mean_ap=mean_ap) if s.iteration == iteration else s for s in steps]
        )

    def forget_after(self, iteration: int) -> None:
        """Drop the rows beyond an iteration: the training resumes from there."""
        self._file.close()
        self._rewrite([step for step in read_log(self.path) if step.iteration <= iteration])

    def is_stale(self, patience: int) -> bool:
        """Whether the last `patience` mAPs brought no new best; never for 0."""
        since_best = len(self.mean_aps) - 1 - int(np.argmax(self.mean_aps or [0]))
        return 0 < patience <= since_best

    def _rewrite(self, steps: list[Step]) -> None:
        _write_rows(self.path, steps)
        self._file = self.path.open("ab", buffering=0)
        self.mean_aps, self.average_loss = [], math.nan
        for step in steps:
            self._remember(step)

    def _remember(self, step: Step) -> None:
        self.average_loss = step.average_loss
        if not math.isnan(step.mean_ap):
            self.mean_aps.append(step.mean_ap)

    def _draw(self) -> None:
        from droptrack.training.plots import plot_training

        plot_training(self.path.with_suffix(".png"), read_log(self.path))
        self._drawn = time.monotonic()


def read_log(path: Path) -> list[Step]:
    """The rows of a training.csv; none where there is no file. Raises DroptrackError.

    A last row without its end is one that a kill or a full disk cut off: it is left out.
    """
    if not path.exists():
        return []
    names = [field.name for field in fields(Step)]
    steps = []
    whole = read_text(path).rpartition("\n")[0]
    rows = csv.reader(whole.splitlines())
    if next(rows, None) != names:
        raise DroptrackError(f"{path}: is of another program or version; choose another --out")
    for number, row in enumerate(rows, start=2):
        try:
            values = {f.name: f.type(v) for f, v in zip(fields(Step), row, strict=True)}  # type: ignore[operator]
            steps.append(Step(**values))
        except ValueError:
            raise DroptrackError(f"{path}:{number}: cannot be understood: {row}") from None
    return steps


def _row(step: Step) -> str:
    return ",".join(f"{v}" if isinstance(v, int) else f"{v:.6g}" for v in astuple(step)) + "\n"


def _write_rows(path: Path, steps: list[Step]) -> None:
    header = ",".join(field.name for field in fields(Step)) + "\n"
    write_text(path, header + "".join(map(_row, steps)))


def write_run_file(folder: Path, about: Mapping[str, object]) -> None:
    """Write run.json: the command, the versions, and what the trainer says about itself.

    A resumed run adds an entry to the list.
    """
    path = folder / "run.json"
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    entries.append(
        {
            "began": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "command": sys.argv,
            "folder": str(Path.cwd()),
            "droptrack": __version__,
            "python": platform.python_version(),
            "machine": f"{platform.platform()}, {os.cpu_count()} cores",
            **about,
        }
    )
    write_text(path, json.dumps(entries, indent=1) + "\n")
