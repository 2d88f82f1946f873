"""Progress bars, and plain lines where there is no terminal."""

import sys
import threading
import time
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

LINE_S = 30.0  # seconds between two plain lines
T = TypeVar("T")


class _Note(ProgressColumn):
    """What a task has to say, if anything."""

    def render(self, task: Task) -> Text:
        return Text(task.fields.get("note", ""))


class _Lines(Progress):
    """Says how far tasks are in a line of plain text now and then, as files and logs want it."""

    def __init__(self, unit: str) -> None:
        super().__init__(disable=True, auto_refresh=False)
        self._unit = unit
        self._ended = threading.Event()
        self._began: dict[TaskID, tuple[float, float]] = {}  # when, and how many there were then

    def add_task(
        self,
        description: str,
        start: bool = True,
        total: float | None = 100.0,
        completed: int = 0,
        visible: bool = True,
        **fields: Any,
    ) -> TaskID:
        """Add a task, see `Progress`."""
        task = super().add_task(description, start, total, completed, visible, **fields)
        self._began[task] = time.monotonic(), completed
        return task

    def start(self) -> None:
        """Begin to say it."""
        self._ended.clear()
        threading.Thread(target=self._say_now_and_then, name="progress", daemon=True).start()

    def stop(self) -> None:
        """Say no more."""
        self._ended.set()

    def _say_now_and_then(self) -> None:
        while not self._ended.wait(LINE_S):
            for task in self.tasks:
                if not task.finished and task.id in self._began:
                    began, before = self._began[task.id]
                    rate = (task.completed - before) / (time.monotonic() - began)
                    print(plain_line(task, self._unit, rate), file=sys.stderr, flush=True)


def plain_line(task: Task, unit: str, rate: float) -> str:
    """How far a task is: what is done, at which rate (in `unit` a second), and the time left."""
    total = "" if task.total is None else f" of {task.total:.0f}"
    parts = [f"{task.completed:.0f}{total} {unit}".rstrip()]
    note = str(task.fields.get("note", ""))
    if rate > 0 and "/s" not in note:
        per = (rate, "s") if rate >= 0.1 else (60 * rate, "min")
        parts.append(f"{per[0]:.3g} {unit or 'items'}/{per[1]}")
    if note:
        parts.append(note)
    if rate > 0 and task.total is not None:
        parts.append(f"{in_words((task.total - task.completed) / rate)} left")
    return f"{task.description}: {', '.join(parts)}"


def in_words(seconds: float) -> str:
    """A time as one says it.

    >>> in_words(42), in_words(95), in_words(8000)
    ('42 s', '1 min 35 s', '2 h 13 min')
    """
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def progress_bar(unit: str, *, shown: bool = True) -> Progress:
    """A progress bar with counts and time left, on a terminal's stderr or in a notebook.

    Elsewhere a plain line each half minute; nothing where it is not to be `shown`.
    """
    console = Console(stderr=True)
    notebook = console.is_jupyter and find_spec("ipywidgets") is not None  # which rich needs there
    if not shown:
        return Progress(disable=True)
    if not (console.is_terminal or notebook):
        return _Lines(unit)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        _Note(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


def with_progress(items: Iterable[T], total: int, task: str, unit: str) -> Iterator[T]:
    """The items, one after the other, counted on the progress bar of a task."""
    with progress_bar(unit) as progress:
        yield from progress.track(items, total=total, description=task)
