"""Trajectories against the ground truth: the report of ``droptrack.evaluate``."""

import re
from collections.abc import Sequence
from dataclasses import asdict, fields
from os import PathLike
from pathlib import Path
from typing import TypeAlias

import numpy as np

from droptrack.data.report import Report, Value
from droptrack.data.trajectories import Trajectories, read_trajectories
from droptrack.evaluation.trajectory_scores import DropletScore, Matching, match, score_droplets

Source: TypeAlias = Trajectories | str | PathLike[str]

ERRORS = [field.name for field in fields(DropletScore) if field.name.startswith("mse")]
OTHER_UNITS = [name for name in ERRORS if not name.endswith("_px2")]


def evaluate(ground_truth: Source, result: Source, height_px: float | None = None) -> Report:
    """Score trajectories against the ground truth, for each droplet and in all.

    Both are `Trajectories`, M positions each, or paths of trajectories files. The summary has the
    errors as means over every frame in which a droplet was found (Eq. 1 of the paper, over all
    droplets), and CLEAR MOT's counts and MOTA; a row has the same of one droplet. Units stand in
    the keys; NaN is undefined. `height_px` of the image is needed for the errors in image heights,
    `mse_y_heights2` and `mse_position_heights2`: without, it is what a file's ``# video:`` line
    says, or these are NaN. Raises DroptrackError for a file that is missing or cannot be
    understood.

    One droplet moves 3 px a frame to the right; it is found 0.5 px too low, and missed once:

    >>> import numpy as np
    >>> from droptrack.data.trajectories import Trajectories
    >>> def lane(frames, y):
    ...     n = len(frames)
    ...     x, y = 20.0 + 3 * np.array(frames), np.full(n, y)
    ...     return Trajectories(
    ...         frame=np.array(frames),
    ...         track_id=np.ones(n, np.int64),
    ...         x=x,
    ...         y=y,
    ...         boxes=np.column_stack([x, y, np.full((n, 2), 10.0)]),
    ...         scores=np.ones(n),
    ...         observed=np.ones(n, bool),
    ...     )
    >>> report = evaluate(lane([0, 1, 2, 3], 50.0), lane([0, 1, 3], 50.5))
    >>> [report.summary[key] for key in ("n_missed", "n_switches", "mota", "mse_y_px2")]
    [1, 0, 0.75, 0.25]
    """
    (expected, about), (found, about_result) = _load(ground_truth), _load(result)
    height = height_of(about, about_result) if height_px is None else height_px
    matching = match(expected, found)
    scores = score_droplets(expected, found, matching, height)
    summary = _summary(scores, matching, n_tracks=len(np.unique(found.track_id)))
    return Report("Droplets of the ground truth", {}, summary, [_row(score) for score in scores])


def height_of(*abouts: dict[str, str]) -> float:
    """The image's height in px as the files' ``# video:`` lines have it, or NaN."""
    for about in abouts:
        if size := re.search(r"(\d+) x (\d+) px", about.get("video", "")):
            return float(size[2])
    return float("nan")


def _load(source: Source) -> tuple[Trajectories, dict[str, str]]:
    """Trajectories, and what their file says of itself."""
    if isinstance(source, Trajectories):
        return source, {}
    return read_trajectories(Path(source))


def _summary(scores: Sequence[DropletScore], matching: Matching, n_tracks: int) -> dict[str, Value]:
    n_required = sum(score.n_frames for score in scores)
    counts = {
        key: sum(getattr(score, key) for score in scores)
        for key in ("n_missed", "n_switches", "n_fragments")
    }
    n_errors = counts["n_missed"] + counts["n_switches"] + matching.n_false
    summary: dict[str, Value] = {
        "n_droplets": len(scores),
        "n_droplets_found_in_every_frame": sum(score.n_missed == 0 for score in scores),
        "n_tracks": n_tracks,
        "n_positions": n_required,
        **counts,
        "n_false": matching.n_false,
        "mota": 1 - n_errors / n_required if n_required else float("nan"),
    }
    n_found = np.array([score.n_frames - score.n_missed for score in scores], float)
    once = n_found > 0
    for name in ERRORS:
        values = np.array([getattr(score, name) for score in scores], float)[once]
        summary[name] = float(np.average(values, weights=n_found[once])) if len(values) else np.nan
    return summary


def _row(score: DropletScore) -> dict[str, Value]:
    return {**asdict(score), "found_as": list(score.found_as)}
