"""All commands in one: ``droptrack track``, ``train``, ``evaluate`` and so on."""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

COMMANDS = (
    *("track", "batch", "detect", "train", "adapt", "convert", "evaluate", "events", "analyse"),
    *("calibrate", "export", "anchors"),
)


class _Commands(TyperGroup):
    """The commands, each imported when it is asked for: together they take a second."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Their names."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by its name."""
        if cmd_name not in COMMANDS:
            return None
        command = typer.main.get_command(import_module(f"droptrack.{cmd_name}").app)
        command.name = cmd_name
        return command


app = typer.Typer(cls=_Commands, add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def main() -> None:
    """Find and track droplets in videos of flowing emulsions."""


if __name__ == "__main__":
    app()
