"""The analyses of a video that a study asks for, and what its summary has of them."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from droptrack.data.files import read_text
from droptrack.data.report import Value
from droptrack.errors import DroptrackError
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.notes import Say
from droptrack.studies.tables import read_table

if TYPE_CHECKING:  # it takes longer to import than all else here
    from droptrack.analysis.choice import Asked

FOLDER = "analysis"  # in a video's folder
NAMES = ("flock", "motion", "structure", "flow", "size")
OF_EVENTS = ("line_", "region_")  # what begins keys of events/report.json that are no counts


def told_of(asked: "Asked") -> str:
    """What a study keeps of an analysis: the options that are given."""
    given = {key: value for key, value in asdict(asked.config).items() if value not in (None, 0)}
    region = str(given.get("region", ""))
    if region and os.path.isfile(region):  # noqa: PTH113  any text may come
        given["region"] = f"sha256 {sha256_of(Path(region))}"
    return ", ".join(f"{key} {value}" for key, value in given.items()) or "plain"


def analyse_video(folder: Path, analyses: "tuple[Asked, ...]", note: Say) -> tuple[str, ...]:
    """Analyse the trajectories in a video's folder; returns the names of what was written.

    Nothing of a video without droplets. Results of earlier analyses, of other rows or options, are
    removed. `note` is told what is odd. Raises DroptrackError for options that cannot be.
    """
    remove_analyses(folder)
    if not analyses:
        return ()
    from droptrack.analysis.writing import write_analysis

    table = read_table(folder / "trajectories.csv")
    if not len(table.rows):
        note("no droplets: nothing to analyse")
        return ()
    for asked in analyses:
        try:
            found = asked.of(table)
        except DroptrackError as error:
            raise DroptrackError(f"analyse {asked.name}: {error}") from None
        settings: dict[str, Value] = {"trajectories": "trajectories.csv", **found.settings}
        write_analysis(folder / FOLDER, asked.name, replace(found, settings=settings), table.units)
        for text in found.notes:
            note(f"analyse {asked.name}: {text}")
    return tuple(asked.name for asked in analyses)


def remove_analyses(folder: Path) -> None:
    """Remove the results of analyses from a video's folder."""
    for name in NAMES:
        for path in (folder / FOLDER).glob(f"{name}[._]*"):
            path.unlink()


def numbers_of(folder: Path, analysed: tuple[str, ...], *, events: bool) -> Mapping[str, Value]:
    """The main numbers that analyses, and events where there are any, found of a video.

    By keys such as ``size_mean_diameter_px``. Raises DroptrackError where results are gone.
    """
    found: dict[str, Value] = {}
    for name in analysed:
        content = _read(folder / FOLDER / f"{name}.json")
        errors = {key for key in content if key.endswith("_error")}
        found |= {f"{name}_{key}": content[key] for key in content if key not in errors}
    if events:
        summary: Any = _read(folder / "events" / "report.json").get("summary", {})
        found |= {key: value for key, value in summary.items() if key.startswith(OF_EVENTS)}
    return {
        key: value
        for key, value in found.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def _read(path: Path) -> dict[str, Value]:
    try:
        content: dict[str, Value] = json.loads(read_text(path))
    except ValueError as error:
        raise DroptrackError(f"{path}: {error}") from None
    return content
