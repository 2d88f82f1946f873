"""What the commands share: how they report problems."""

import functools
import io
import os
import sys
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from types import ModuleType
from typing import ParamSpec, TypeVar

import typer

from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError
from droptrack.interrupts import ended_as_by_ctrl_c

P = ParamSpec("P")
R = TypeVar("R")


def _forget_missing_backend() -> None:
    """Forget a way to draw that Jupyter set for its own environment where this one lacks it.

    Matplotlib cannot be imported with it; plots are files here.
    """
    wanted = os.environ.get("MPLBACKEND", "")
    module = "matplotlib_inline" if wanted == "inline" else wanted.removeprefix("module://")
    if (wanted == "inline" or module != wanted) and find_spec(module.partition(".")[0]) is None:
        del os.environ["MPLBACKEND"]


_forget_missing_backend()  # before any module that draws is imported


def one_line_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Make a command report what its user can mend in one line on stderr and exit with 1."""

    @functools.wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        _print_anything()
        try:
            with ended_as_by_ctrl_c():
                return command(*args, **kwargs)
        except DroptrackError as error:
            message = printable(str(error))
        except OSError as error:  # a full disk, a folder that may not be written
            place = printable(f"{error.filename}: ") if error.filename else ""
            message = f"{place}{error.strerror or error}"
        except KeyboardInterrupt:
            message = "interrupted"
        typer.echo(f"droptrack: {message}", err=True)
        raise typer.Exit(1)

    return wrapped


def _print_anything() -> None:
    """Have output whose encoding lacks a character show another one in its place."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


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
