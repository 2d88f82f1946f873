"""The stage ``flock``: whether droplets of the dense emulsion go the way of their neighbours."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.reproduction.folder import Reproduction
from bench.reproduction.simulations import Clip
from bench.reproduction.tracking import OURS, result_folder
from droptrack.analysis.flock.report import FlockConfig, analyse_flock
from droptrack.analysis.plots import draw
from droptrack.analysis.writing import in_units, write_analysis
from droptrack.data.files import read_text
from droptrack.data.formats.tables import read_csv

DIAMETERS = (1.0, 1.25, 1.5, 2.0)  # radii R that are tried
DRAWN = ("neighbourhood", "scatter")  # the two panels of the paper's figure 13


def analyse(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Analyse our trajectories and the ground truth, at several radii of the neighbourhood."""
    clip = Clip("constriction", degraded=False, folder=of.folder("simulations") / "constriction")
    ours = result_folder(of, clip, OURS) / "run" / "trajectories.csv"
    found: dict[str, Any] = {"radii": []}
    for diameters in DIAMETERS:
        found["radii"].append(
            {
                "radius_diameters": diameters,
                "ours": _share(ours, diameters, of.settings.seed),
                "truth": _share(clip.truth, diameters, of.settings.seed),
            }
        )
    table = read_csv(ours)
    result = analyse_flock(table, FlockConfig(seed=of.settings.seed))
    folder = of.folder("flock")
    write_analysis(folder, "flock", result, table.units)
    found["captions"] = {}
    for figure in result.figures:
        if figure.name in DRAWN:
            found["captions"][figure.name] = figure.caption
            shown = in_units(figure, table.units)
            for suffix in ("png", "pdf"):
                draw(folder / f"{figure.name}.{suffix}", shown, table.units)
    content = json.loads(read_text(folder / "flock.json"))
    keys = ("share", "share_error", "share_shuffled", "n_pairs", "n_excluded")
    found["main"] = {key: content.get(key) for key in keys}
    found["main"]["radius_px"] = content["settings"]["radius_px"]
    found["main"]["radius_diameters"] = content["settings"]["radius_diameters"]
    found["quantities"] = [
        {key: one[key] for key in ("label", "value", "error", "null", "null_model", "reason")}
        for one in content["quantities"]
    ]
    say(f"flock: share {content['share']}, shuffled {content['share_shuffled']}")
    return found


def _share(path: Path, diameters: float, seed: int) -> dict[str, float]:
    result = analyse_flock(read_csv(path), FlockConfig(radius_diameters=diameters, seed=seed))
    values = {one.stem: one for one in result.quantities}
    return {
        "share": values["share"].value,
        "error": values["share"].error,
        "shuffled": values["share_shuffled"].value,
    }
