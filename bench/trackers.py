"""How well and how fast droplets are tracked, ``python -m bench.trackers``, or one command of it.

The tables of docs/tracking.md. The motions are those of `data_gen.videos.motions`, seed 0.
"""

import statistics
import time
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from bench.track_scores import Score, only_images, score, track
from data_gen.videos.motion_kinds import MOTIONS, Kind, Motion
from data_gen.videos.motions import make
from droptrack.command_line import new_app, one_line_errors
from droptrack.data.detections import Detections
from droptrack.tracking.choice import APPEARANCE_COST
from droptrack.tracking.deepsort.tracker import DeepSortParameters, DeepSortTracker
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracker import DropletTracker
from droptrack.tracking.tracker import Tracker

app = new_app()
Action = Callable[[Detections, NDArray[np.float64]], object]
# of the speed table
LENGTH = 128  # of the descriptors, as DeepSORT's
SIZES = ((50, 20), (500, 16), (1000, 11))  # droplets, about, and their diameters in px
WARM_UP = 5  # frames that do not count
PARTS = {
    "everything": DropletParameters(),
    "no flow": DropletParameters(flow=False),
    "no size": DropletParameters(size=False),
    "greedy": DropletParameters(jointly=False),
    "one way": DropletParameters(both_ways=False),
    "noise fixed": DropletParameters(learn_noise=False),
    "duplicates kept": DropletParameters(duplicates=False),
}
HARD = ("uniform 1.5", "shear 2", "filled", "missing 30%", "false 20%", "jitter 10%", "jitter 20%",
        "missing 10% false 5%")  # fmt: skip


def judge(tracker: Tracker, motion: Motion) -> Score:
    """One tracker on one motion."""
    truth, frames = make(motion, 0)
    result = track(tracker, frames)
    if motion.images_missing:
        truth, result = only_images(truth, frames), only_images(result, frames)
    return score(truth, result)


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
            ("deepsort", DeepSortTracker(DeepSortParameters())),
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

    def update(found: Detections, descriptors: NDArray[np.float64]) -> object:
        return tracker.update(found.boxes, descriptors)

    return update


def deep_sort_realtime() -> Action | None:
    """One frame through deep-sort-realtime, or nothing where it is not installed."""
    try:
        from deep_sort_realtime.deepsort_tracker import DeepSort as Realtime
    except ImportError:
        return None
    tracker: Any = Realtime(embedder=None, nn_budget=100)

    def update(found: Detections, descriptors: NDArray[np.float64]) -> object:
        corners = np.hstack([found.boxes[:, :2] - found.boxes[:, 2:] / 2, found.boxes[:, 2:]])
        boxes = [(c, 1.0, "droplet") for c in corners.tolist()]
        return tracker.update_tracks(boxes, list(descriptors))

    return update


@app.command()
@one_line_errors
def speed(frames: int = 40) -> None:
    """Milliseconds a frame of the process, frame by frame in turn, medians; and the ratio."""
    rng = np.random.default_rng(0)
    typer.echo("| droplets | droplet | with descriptors | deepsort | deep-sort-realtime | ratio |")
    typer.echo("| --- | --- | --- | --- | --- | --- |")
    for n, diameter in SIZES:
        motion = Motion(
            kind=Kind.vortices,
            droplets=int(n * 1.25),
            diameter=diameter,
            frames=frames,
            jitter=0.01,
        )
        truth, found = make(motion, 0)
        actions = {
            "droplet": ours(DropletTracker(DropletParameters())),
            "with descriptors": ours(DropletTracker(DropletParameters(appearance=APPEARANCE_COST))),
            "deepsort": ours(DeepSortTracker(DeepSortParameters())),
        }
        if (realtime := deep_sort_realtime()) is not None:
            actions["realtime"] = realtime
        times: dict[str, list[float]] = {name: [] for name in actions}
        for detections in found:
            descriptors = rng.normal(0, 1, (len(detections), LENGTH)) + 1
            descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
            for name, action in actions.items():
                start = time.process_time()
                action(detections, descriptors)
                times[name].append(1e3 * (time.process_time() - start))
        ms = {name: statistics.median(values[WARM_UP:]) for name, values in times.items()}
        theirs = ms.get("realtime", float("nan"))
        typer.echo(
            f"| {len(truth) // frames} | {ms['droplet']:.2f} | {ms['with descriptors']:.2f} "
            f"| {ms['deepsort']:.2f} | {theirs:.1f} | {theirs / ms['with descriptors']:.0f} |"
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
