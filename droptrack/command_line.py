"""What the commands share: how they report problems."""

import functools
import sys
from collections.abc import Callable, Iterable
from types import ModuleType
from typing import ParamSpec, TypeVar

import typer

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


def refuse_given(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Raise DroptrackError where an option was given that would change nothing.

    `names`: the command's parameters; `why`: what ends the sentence.
    """
    options = {parameter.name: parameter for parameter in context.command.params}
    for name in names:
        if was_given(context, name):
            raise DroptrackError(f"{options[name].opts[0]} {why}")


def was_given(context: typer.Context, name: str) -> bool:
    """Whether an option stands on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name in ("COMMANDLINE", "ENVIRONMENT")


def new_app() -> typer.Typer:
    """A Typer application with the project's settings."""
    return typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def also_call(module: str, function: Callable[..., object]) -> None:
    """Let a command's module be called like the function of its name in the public API.

    ``droptrack.track`` is that function until somebody imports the module ``droptrack.track``,
    which Python then puts in its place.
    """

    class CallableModule(ModuleType):
        __call__ = staticmethod(function)

    sys.modules[module].__class__ = CallableModule
