"""Command: compare trajectories with the truth, ``python -m droptrack.evaluate``."""

import re
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.report import Report, Value
from droptrack.track_metrics import DropletScore, match, score_droplets
from droptrack.trajectories import Trajectories, read_trajectories

MSE_NAMES = [field.name for field in fields(DropletScore) if field.name.startswith("mse")]


def evaluate(truth: Trajectories, result: Trajectories, height: float) -> Report:
    """Score trajectories against the truth, per droplet and in all.

    In all, errors are means over every frame in which a droplet was found (Eq. 1 of the paper, over
    all droplets). `height` of the picture in px; NaN leaves the errors in heights undefined.
    """
    matching = match(truth, result)
    scores = score_droplets(truth, result, matching, height)
    n_required = sum(score.n_frames for score in scores)
    counts = {
        key: sum(getattr(score, key) for score in scores)
        for key in ("n_missed", "n_switches", "n_fragments")
    }
    n_errors = counts["n_missed"] + counts["n_switches"] + matching.n_false
    found = np.array([score.n_frames - score.n_missed for score in scores], float)
    summary: dict[str, Value] = {
        "n_droplets": len(scores),
        "n_droplets_found_in_every_frame": sum(score.n_missed == 0 for score in scores),
        "n_tracks": len(np.unique(result.track_id)),
        "n_positions": n_required,
        **counts,
        "n_false": matching.n_false,
        "mota": 1 - n_errors / n_required if n_required else float("nan"),
    }
    seen = found > 0
    for name in MSE_NAMES:
        values = np.array([getattr(score, name) for score in scores], float)[seen]
        summary[name] = float(np.average(values, weights=found[seen])) if len(values) else np.nan
    return Report("Droplets of the truth", {}, summary, [_row(score) for score in scores])


def _row(score: DropletScore) -> dict[str, Value]:
    return dict(asdict(score))


def height_of(*abouts: dict[str, str]) -> float:
    """The picture's height in px as the files' ``# video:`` lines have it, or NaN."""
    for about in abouts:
        if size := re.search(r"(\d+) x (\d+) px", about.get("video", "")):
            return float(size[2])
    return float("nan")


app = new_app()


@app.command()
@one_line_errors
def main(
    truth: Annotated[Path, typer.Argument(metavar="TRUTH.csv", help="What is known.")],
    trajectories: Annotated[
        Path, typer.Argument(metavar="TRAJECTORIES.csv", help="What was found.")
    ],
    json: Annotated[Path | None, typer.Option(help="Write the report here too.")] = None,
) -> None:
    """Compare trajectories with the truth: errors, identity switches, missed and false ones."""
    expected, about_truth = read_trajectories(truth)
    found, about = read_trajectories(trajectories)
    report = evaluate(expected, found, height_of(about_truth, about))
    others = [name for name in MSE_NAMES if not name.endswith("_px2")]
    report.print(without=others)
    if json is not None:
        report.write_json(json)
    else:
        typer.echo("each droplet's errors in all units: --json FILE")


if __name__ == "__main__":
    app()
