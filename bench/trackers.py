"""How well and how fast droplets are followed, ``python -m bench.trackers``, or one command of it.

The tables of docs/tracking.md. The motions are those of `data_gen.videos.motions`, seed 0.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from bench.track_scores import Score, follow, score
from data_gen.videos.motions import MOTIONS, Kind, Motion, make
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.detections import Detections
from droptrack.tracking.deepsort import Parameters
from droptrack.tracking.deepsort import Tracker as DeepSort
from droptrack.tracking.droplet_tracker import DropletParameters, DropletTracker
from droptrack.tracking.tracker import Tracker

app = new_app()
Action = Callable[[Detections, NDArray[np.float64]], object]
LENGTH = 128  # of the descriptors in the speed table, as DeepSORT's
PARTS = {
    "everything": DropletParameters(),
    "no flow": DropletParameters(flow=False),
    "no size": DropletParameters(size=False),
    "greedy": DropletParameters(jointly=False),
    "one way": DropletParameters(both_ways=False),
    "noise fixed": DropletParameters(learn_noise=False),
    "second boxes kept": DropletParameters(second_boxes=False),
}
HARD = ("uniform 1.5", "shear 2", "filled", "missing 30%", "false 20%", "jitter 10%", "jitter 20%",
        "missing 10% false 5%")  # fmt: skip


def judge(tracker: Tracker, motion: Motion) -> Score:
    """One tracker on one motion."""
    truth, frames = make(motion, 0)
    return score(truth, *follow(tracker, frames))


@app.command()
@one_line_errors
def scores(
    names: Annotated[list[str] | None, typer.Argument(help="Of motions; without: all.")] = None,
) -> None:
    """Every motion, both trackers."""
    typer.echo(
        "| motion | tracker | MOTA | IDF1 | HOTA | switches | per 1,000 | error, diameters |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    for name in names or MOTIONS:
        for label, tracker in (
            ("droplet", DropletTracker(DropletParameters())),
            ("deepsort", DeepSort(Parameters())),
        ):
            s = judge(tracker, MOTIONS[name])
            typer.echo(
                f"| {name} | {label} | {s.mota:.4f} | {s.idf1:.4f} | {s.hota:.4f} | {s.switches} "
                f"| {s.switches_per_1000:.2f} | {s.position_rms:.4f} |"
            )


@app.command()
@one_line_errors
def parts() -> None:
    """IDF1 and identity switches with one part of the droplet tracker switched off at a time."""
    typer.echo("| | " + " | ".join(HARD) + " |\n|" + " --- |" * (len(HARD) + 1))
    for label, parameters in PARTS.items():
        found = [judge(DropletTracker(parameters), MOTIONS[name]) for name in HARD]
        cells = [f"{s.idf1:.4f}, {s.switches}" for s in found]
        typer.echo(f"| {label} | " + " | ".join(cells) + " |")


def ours(tracker: Tracker) -> Action:
    """One frame through a tracker."""

    def update(found: Detections, looks: NDArray[np.float64]) -> object:
        return tracker.update(found.boxes, looks)

    return update


def deep_sort_realtime() -> Action | None:
    """One frame through deep-sort-realtime, or nothing where it is not installed."""
    try:
        from deep_sort_realtime.deepsort_tracker import DeepSort as Realtime
    except ImportError:
        return None
    tracker: Any = Realtime(embedder=None, nn_budget=100)

    def update(found: Detections, looks: NDArray[np.float64]) -> object:
        corners = np.hstack([found.boxes[:, :2] - found.boxes[:, 2:] / 2, found.boxes[:, 2:]])
        return tracker.update_tracks([(c, 1.0, "droplet") for c in corners.tolist()], list(looks))

    return update


@app.command()
@one_line_errors
def speed(frames: int = 40) -> None:
    """Milliseconds a frame of the process, frame by frame in turn, medians; and the ratio."""
    rng = np.random.default_rng(0)
    typer.echo("| droplets | droplet | with descriptors | deepsort | deep-sort-realtime | ratio |")
    typer.echo("| --- | --- | --- | --- | --- | --- |")
    for n, diameter in ((50, 20), (500, 16), (1000, 11)):
        motion = Motion(Kind.vortices, droplets=int(n * 1.25), diameter=diameter, frames=frames)
        truth, found = make(replace(motion, jitter=0.01), 0)
        actions = {
            "droplet": ours(DropletTracker(DropletParameters())),
            "looking": ours(DropletTracker(DropletParameters(appearance=10.0))),
            "deepsort": ours(DeepSort(Parameters())),
        }
        if (realtime := deep_sort_realtime()) is not None:
            actions["realtime"] = realtime
        times: dict[str, list[float]] = {name: [] for name in actions}
        for detections in found:
            looks = rng.normal(0, 1, (len(detections), LENGTH)) + 1
            looks /= np.linalg.norm(looks, axis=1, keepdims=True)
            for name, action in actions.items():
                start = time.process_time()
                action(detections, looks)
                times[name].append(1e3 * (time.process_time() - start))
        ms = {name: statistics.median(values[5:]) for name, values in times.items()}
        last = [ms.get("realtime", float("nan")), ms.get("realtime", float("nan")) / ms["looking"]]
        cells = [f"{ms[name]:.2f}" for name in ("droplet", "looking", "deepsort")]
        typer.echo(
            f"| {len(truth) // frames} | "
            + " | ".join(cells)
            + f" | {last[0]:.1f} | {last[1]:.0f} |"
        )


@app.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Without a command: everything."""
    if context.invoked_subcommand is None:
        scores()
        parts()
        speed()


if __name__ == "__main__":
    app()
