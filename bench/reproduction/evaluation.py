"""The stage ``evaluation``: every method on every video against the ground truth.

MOTA, IDF1 and HOTA by TrackEval; errors of each droplet by `droptrack.evaluate`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

import droptrack
from bench.reproduction.folder import Reproduction, defined
from bench.reproduction.simulations import CASES, Clip, clips
from bench.reproduction.tracking import OURS, result_folder
from bench.track_scores import score
from droptrack.data.trajectories import Trajectories, read_trajectories
from droptrack.data.video import Video
from droptrack.evaluation.trajectory_scores import match

PAPER_BEST_MSE_PX2 = 1.59e-2  # of the four cores of the paper's figure 11
SINE_MSE_PX2 = 2e-5
MIN_HOTA = 0.98
SUMMARY = (
    "n_droplets", "n_droplets_found_in_every_frame", "n_tracks", "n_positions", "n_missed",
    "n_switches", "n_false", "mse_y_px2", "mse_y_heights2", "mse_y_diameters2",
    "mse_position_px2", "mse_position_heights2", "mse_position_diameters2",
)  # fmt: skip
OF_DROPLET = ("track_id", "n_missed", "n_switches", "mse_y_px2", "mse_y_heights2",
              "mse_y_diameters2")  # fmt: skip


def evaluate_all(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Score every method on every video, and see whether what must be reached is."""
    found: dict[str, Any] = {}
    for clip in clips(of):
        methods = of.result("tracking")[clip.name]
        found[clip.name] = {}
        for name, about in methods.items():
            rows, _ = read_trajectories(result_folder(of, clip, name) / "trajectories.csv")
            found[clip.name][name] = {**scores_of(clip, rows), **about}
    gates = gates_of({clip: methods[OURS] for clip, methods in found.items()})
    for gate in gates:
        say(gate_line(gate))
    return {"methods": found, "gates": gates}


def scores_of(clip: Clip, rows: Trajectories) -> dict[str, Any]:
    """Counts, errors in three units, MOTA, IDF1 and HOTA of trajectories of a video."""
    truth, _ = read_trajectories(clip.truth)
    report = droptrack.evaluate(truth, rows, height_px=float(Video(str(clip.video)).info.height))
    counted_truth, counted = only_counted(truth, rows)
    scores = asdict(score(counted_truth, counted))
    return {
        **{key: report.summary[key] for key in SUMMARY},
        **{key: scores[key] for key in ("mota", "idf1", "hota")},
        "droplets": [{key: row[key] for key in OF_DROPLET} for row in report.droplets],
    }


def only_counted(truth: Trajectories, rows: Trajectories) -> tuple[Trajectories, Trajectories]:
    """Without droplets that need not be found (score 0), and without what is found there."""
    # as if all had to be found, since only pairs that count are told
    pairs = match(replace(truth, scores=np.ones(len(truth))), rows)
    kept = np.ones(len(rows), bool)
    kept[pairs.result[truth.scores[pairs.truth] == 0]] = False
    return truth[truth.scores > 0], rows[kept]


def gates_of(ours: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What must be reached on the clean videos: what it is, the value, the bound, whether it is.

    `ours`: the scores of droptrack by the video's name.
    """
    gates = []
    for flow in ("shear", "constriction"):
        one, title = ours[flow], CASES[flow]
        n = one["n_droplets"]
        gates += [
            _gate(f"{title}: found in every frame", one["n_droplets_found_in_every_frame"], "=", n),
            _gate(f"{title}: identity switches", one["n_switches"], "=", 0),
        ]
    for flow, bound in (("shear", PAPER_BEST_MSE_PX2), ("sine", SINE_MSE_PX2)):
        worst = max(_number(droplet["mse_y_px2"]) for droplet in ours[flow]["droplets"])
        gates.append(_gate(f"{CASES[flow]}: mean square error in y of the worst droplet, px²",
                           worst, "<", bound))  # fmt: skip
    gates.append(_gate("dense emulsion: HOTA", ours["constriction"]["hota"], ">", MIN_HOTA))
    return gates


def _gate(what: str, value: float, relation: str, bound: float) -> dict[str, Any]:
    reached = {"=": value == bound, "<": value < bound, ">": value > bound}[relation]
    return {"what": what, "value": value, "relation": relation, "bound": bound, "reached": reached}


def gate_line(gate: Mapping[str, Any]) -> str:
    """A gate as one reads it.

    >>> gate_line(_gate("HOTA", 0.9912, ">", 0.98))
    'reached: HOTA: 0.9912 (must be > 0.98)'
    """
    word = "reached" if gate["reached"] else "NOT reached"
    return (
        f"{word}: {gate['what']}: {gate['value']:.4g} (must be {gate['relation']} "
        f"{gate['bound']:g})"
    )


def not_reached(gates: Sequence[Mapping[str, Any]]) -> list[str]:
    """What must be reached and is not."""
    return [str(gate["what"]) for gate in gates if not gate["reached"]]


def _number(value: object) -> float:
    """Not defined is worse than any number."""
    return float(str(value)) if defined(value) else math.inf
