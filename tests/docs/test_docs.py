"""The documentation names files, options, make targets and public names that are there."""

import re
from importlib import import_module
from pathlib import Path

import pytest
import typer

import droptrack

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = re.compile(r"```.*?```|`[^`]+`", re.DOTALL)
FILE = re.compile(r"`((?:droptrack|data_gen|darknet_cfg|tests|bench|docs)/[\w./-]*)`")
COMMAND = re.compile(r"\b((?:droptrack|data_gen|bench)(?:\.\w+)?|make_dataset)\b([^\n`#]*)")


def code(page: Path) -> str:
    """What a page has in code, a line for each command."""
    return "\n".join(CODE.findall(page.read_text(encoding="utf-8"))).replace("\\\n", " ")


def options(module: str) -> set[str]:
    """The options of a command, or of all commands of a module."""
    name = {"make_dataset": "data_gen.make_dataset", "bench": "bench.__main__"}.get(module, module)
    command = typer.main.get_command(import_module(name).app)
    commands = [command, *getattr(command, "commands", {}).values()]
    return {
        option
        for one in commands
        for parameter in one.params
        for option in (*parameter.opts, *parameter.secondary_opts)
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_are_there(page: Path) -> None:
    named = FILE.findall(page.read_text(encoding="utf-8"))
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_have_their_options(page: Path) -> None:
    wrong = []
    for name, rest in COMMAND.findall(code(page)):
        if named := re.findall(r"(?<![\w-])--[a-z][\w-]*", rest):
            module = name if name != "droptrack" else f"droptrack.{rest.split()[0]}"
            wrong += [f"{module} {option}" for option in set(named) - options(module)]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_make_has_its_targets_and_variables(page: Path) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target, variable in re.findall(r"\bmake ([a-z-]+)(?: ([A-Z]+)=)?", code(page)):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
        assert not variable or f"\n{variable} ?=" in makefile, variable


def test_the_page_of_the_python_api_has_every_public_name() -> None:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    shown = {line.split(".")[-1] for line in page.splitlines() if line.startswith("::: ")}
    assert shown == set(droptrack.__all__) - {"__version__"}
