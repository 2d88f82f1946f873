"""What the commands share: how they report problems and progress."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import typer
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

from droptrack.errors import DroptrackError

P = ParamSpec("P")
R = TypeVar("R")


def one_line_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Make a command report what its user can mend in one line on stderr and exit with 1."""

    @functools.wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except DroptrackError as error:
            message = str(error)
        except OSError as error:  # a full disk, a folder that may not be written
            place = f"{error.filename}: " if error.filename else ""
            message = f"{place}{error.strerror or error}"
        except KeyboardInterrupt:
            message = "interrupted"
        typer.echo(f"droptrack: {message}", err=True)
        raise typer.Exit(1)

    return wrapped


def new_app() -> typer.Typer:
    """A Typer application with the project's settings."""
    return typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class _Note(ProgressColumn):
    """What a task has to say, if anything."""

    def render(self, task: Task) -> Text:
        return Text(task.fields.get("note", ""))


def progress_bar(unit: str) -> Progress:
    """A progress bar on stderr with counts, rate and time left; silent when it is no terminal."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        _Note(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    )
