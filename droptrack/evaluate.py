"""Command: how good trajectories or a network are, ``python -m droptrack.evaluate``."""

import hashlib
import re
from dataclasses import asdict, fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.darknet_dataset import DataSet, read_data_file, read_scenes
from droptrack.data.report import Report, Value
from droptrack.data.trajectories import Trajectories, read_trajectories
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.errors import DroptrackError
from droptrack.evaluation.average_precision import LEAST_SCORE, MAX_IOU
from droptrack.evaluation.trajectory_scores import DropletScore, match, score_droplets
from droptrack.evaluation.validation import darknet_detector, detect_images, network_report
from droptrack.network.bundled import BUNDLED_WEIGHTS, find_cfg
from droptrack.network.darknet_cfg import Cfg, read_cfg
from droptrack.progress import progress_bar

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


def evaluate_network(
    data: DataSet, cfg: Cfg, weights: Path, images: int, detector: Detector
) -> Report:
    """How good weights are on the first `images` validation images of a data set; 0: on all."""
    listing = data.valid[:images] if images else data.valid
    pairs = {}
    with progress_bar("images") as progress:
        task = progress.add_task(weights.name, total=len(listing), note="")
        for path, pair in zip(listing, detect_images(detector, listing), strict=True):
            pairs[path] = pair
            progress.advance(task)
    report = network_report(pairs, read_scenes(data))
    settings: dict[str, Value] = {
        "network": f"{cfg.path}, {weights}",
        "weights_sha256": hashlib.sha256(weights.read_bytes()).hexdigest(),
        "data": str(data.path),
        "engine": detector.engine.name,
        "least_score": LEAST_SCORE,
        "max_iou": MAX_IOU,
        "dark": detector.dark,
        "score_of_precision_recall_f1_iou": 0.25,
    }
    return replace(report, settings=settings)


app = new_app()


@app.command()
@one_line_errors
def main(
    truth: Annotated[
        Path | None, typer.Argument(metavar="TRUTH.csv", help="What is known.")
    ] = None,
    trajectories: Annotated[
        Path | None, typer.Argument(metavar="TRAJECTORIES.csv", help="What was found.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Instead: a data set (obj.data) to try weights on.")
    ] = None,
    weights: Annotated[
        Path | None, typer.Option(help="With --data; without, the network that ships.")
    ] = None,
    cfg: Annotated[
        Path | None, typer.Option(help="With --data: their .cfg; without, by the weights' name.")
    ] = None,
    images: Annotated[
        int, typer.Option(min=0, help="With --data: only so many validation images; 0: all.")
    ] = 0,
    backend: Annotated[
        Backend, typer.Option(help="With --data: what runs the network.")
    ] = Backend.opencv,
    precision: Annotated[
        Precision, typer.Option(help="With --data: auto is what tracks videos, pruned or not.")
    ] = Precision.fp32,
    dark: Annotated[
        bool, typer.Option("--dark", help="With --data: its droplets are darker than their ground.")
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Write the report here too.")] = None,
) -> None:
    """Compare trajectories with the truth, or a network's detections with a data set's labels.

    Of trajectories: errors, identity switches, missed and false ones. Of a network: mAP@0.50 as
    Darknet computes it, precision, recall, F1 and mean overlap above a score of 0.25, COCO's AP.
    """
    if data is not None and truth is None:
        weights = weights or BUNDLED_WEIGHTS
        network, pictures = read_cfg(cfg or find_cfg(weights)), read_data_file(data)
        detector = darknet_detector(
            network, weights, backend=backend, precision=precision, dark=dark
        )
        report = evaluate_network(pictures, network, weights, images, detector)
        report.print()
        if find_spec("hotcoco") is None:
            typer.echo("COCO's AP needs hotcoco: pip install 'droptrack[train]'", err=True)
    elif data is None and truth is not None and trajectories is not None:
        expected, about_truth = read_trajectories(truth)
        found, about = read_trajectories(trajectories)
        report = evaluate(expected, found, height_of(about_truth, about))
        report.print(without=[name for name in MSE_NAMES if not name.endswith("_px2")])
        if json is None:
            typer.echo("each droplet's errors in all units: --json FILE")
    else:
        raise DroptrackError("give TRUTH.csv and TRAJECTORIES.csv, or --data obj.data")
    if json is not None:
        report.write_json(json)


if __name__ == "__main__":
    app()
