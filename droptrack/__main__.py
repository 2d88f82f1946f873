"""All commands in one: ``droptrack track``, ``train``, ``evaluate`` and so on."""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

# the first lines of their own helps, which would take seconds to import
COMMANDS = {
    "track": "Track the droplets of a video: trajectories.csv, tracked.mp4, paths.png, "
    "report.json.",
    "batch": "Track many videos: a folder a video, summary.csv, trajectories/ and index.html.",
    "detect": "Find the droplets of images: detections.csv, annotated images, sizes.png, "
    "report.json.",
    "train": "Train a network on a Darknet data set, with Darknet or PyTorch, and write its "
    "weights.",
    "adapt": "Train the network on for the droplets of your own video, without a label.",
    "convert": "Convert trajectories to other programs' formats, and back.",
    "evaluate": "Compare trajectories with the ground truth, or a network's detections with "
    "labels.",
    "events": "Coalescence, break-up, entering, leaving, passages of lines, stays in regions.",
    "analyse": "Quantities that papers report, of any trajectories, with errors and null models.",
    "calibrate": "Prune a network, measure what 8 bits need, check that it costs little, and keep "
    "it.",
    "narrow": "Write a network with fewer filters, which Darknet reads, too, to train it on.",
    "export": "Write a network as an ONNX model, which nearly every inference engine reads.",
    "anchors": "Find the anchors that suit a data set's droplets best.",
}


class _Commands(TyperGroup):
    """The commands, each imported when it is asked for: together they take seconds."""

    _only_told = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Their names."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by its name."""
        if cmd_name not in COMMANDS:
            return None
        if self._only_told:
            return TyperCommand(cmd_name, help=COMMANDS[cmd_name])
        command = typer.main.get_command(import_module(f"droptrack.{cmd_name}").app)
        command.name = cmd_name
        return command

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Tell what each command does, without importing it."""
        self._only_told = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._only_told = False


app = typer.Typer(cls=_Commands, add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def main() -> None:
    """Find and track droplets in videos of flowing emulsions."""


if __name__ == "__main__":
    app()
