"""Progress bars."""

from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

T = TypeVar("T")


class _Note(ProgressColumn):
    """What a task has to say, if anything."""

    def render(self, task: Task) -> Text:
        return Text(task.fields.get("note", ""))


def progress_bar(unit: str, *, shown: bool = True) -> Progress:
    """A progress bar with counts and time left, on a terminal's stderr or in a notebook.

    Silent elsewhere, and where it is not to be `shown`.
    """
    console = Console(stderr=True)
    notebook = console.is_jupyter and find_spec("ipywidgets") is not None  # which rich needs there
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        _Note(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not (shown and (console.is_terminal or notebook)),
        transient=True,
    )


def with_progress(items: Iterable[T], total: int, task: str, unit: str) -> Iterator[T]:
    """The items, one after the other, counted on the progress bar of a task."""
    with progress_bar(unit) as progress:
        yield from progress.track(items, total=total, description=task)
