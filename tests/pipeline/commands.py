"""The command that tracks, as the tests call it."""

from pathlib import Path

from typer.testing import CliRunner

from droptrack.__main__ import app

runner = CliRunner()


def track(video: Path | str, out: Path, *options: str) -> str:
    """Run ``droptrack track`` and return what it prints."""
    result = runner.invoke(app, ["track", str(video), "--out", str(out), *options])
    assert result.exit_code == 0, result.output
    return result.output


def fails(*arguments: str) -> str:
    """Run a command that must fail; returns its one line on stderr."""
    result = runner.invoke(app, list(arguments))
    assert result.exit_code == 1, result.output
    lines = [line for line in result.stderr.splitlines() if line]
    assert lines[-1].startswith("droptrack: ")
    assert "Traceback" not in result.output
    return lines[-1]
