"""Draws the figures of a reproduction, each as PNG and PDF."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke

from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from droptrack.data.files import replacing
from droptrack.data.frames import Frame
from droptrack.data.trajectories import Trajectories
from droptrack.evaluation.trajectory_scores import match

STYLE: dict[Any, Any] = {"font.size": 9, "savefig.dpi": 150}
BLUE = "#1f5fd0"  # of the paper's boxes
COLOURS = mpl.colormaps["tab20"]
MAX_DISTINCT = 20  # colours; more droplets share a rainbow
ROOM = 0.07  # of an image's height, for a number above a box


def save(folder: Path, name: str, figure: Figure) -> None:
    """Write a figure as PNG and PDF."""
    with mpl.rc_context(STYLE):
        for suffix in ("png", "pdf"):
            with replacing(folder / f"{name}.{suffix}") as partial:
                figure.savefig(partial)


def new(width: float, height: float, rows: int, columns: int) -> tuple[Figure, list[Axes]]:
    """A figure of a size in inches, and its axes, row by row."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
    return figure, [one for row in axes for one in row]


def scenes(images: Sequence[tuple[str, Frame, Detections]], label: str) -> Figure:
    """An image of each scene with its boxes, and what a label file says (the paper's figure 14)."""
    figure, axes = new(9.5, 5.4, 2, 2)
    for one, (scene, image, truth), letter in zip(axes, images, "abc", strict=False):
        one.imshow(image[..., ::-1])
        _boxes(one, truth.boxes)
        one.set_title(f"({letter}) scene {scene}", loc="left")
        one.set_axis_off()
    axes[3].set_axis_off()
    axes[3].set_title("(d) the label file of (b): class, then x, y, w, h of the box", loc="left")
    axes[3].text(0, 0.9, label, family="monospace", fontsize=8, va="top")
    return figure


def training(logs: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Loss and mAP of each network as it was trained (the paper's figure 6)."""
    figure, axes = new(4.8 * max(len(logs), 1), 3.4, 1, max(len(logs), 1))
    for left, (name, log) in zip(axes, logs.items(), strict=False):
        loss = np.array([np.nan if one is None else one for one in log["loss"]], float)
        left.plot(log["iterations"], loss, color="tab:blue", linewidth=1)
        known = loss[np.isfinite(loss)]
        left.set(xlabel="iteration", title=name)
        left.set_ylim(0, 2 * float(np.quantile(known, 0.8)) if len(known) else 1)
        left.set_ylabel("average loss", color="tab:blue")
        right = left.twinx()
        right.plot(log["map_at"], log["map"], "o-", color="tab:red", markersize=3)
        right.set_ylim(0, 1.02)
        right.set_ylabel("mAP@0.50", color="tab:red")
    return figure


def flows(images: Mapping[str, Sequence[Frame]]) -> Figure:
    """The first, a middle and the last frame of each simulation."""
    figure, axes = new(9.5, 1.9 * len(images), len(images), 3)
    for row, (title, frames) in enumerate(images.items()):
        for column, frame in enumerate(frames):
            one = axes[3 * row + column]
            one.imshow(frame[..., ::-1])
            one.set(xticks=[], yticks=[])
            if not column:
                one.set_title(title, loc="left")
    return figure


def frames_with_boxes(images: Mapping[int, Frame], rows: Trajectories) -> Figure:
    """Frames with the boxes and identities of the droplets tracked in them."""
    figure, axes = new(9.5, 5.2, 2, 2)
    for one, (number, image), letter in zip(axes, images.items(), "abcd", strict=False):
        mine = rows[rows.frame == number]
        one.imshow(image[..., ::-1])
        _boxes(one, mine.boxes)
        many = len(mine) > 12
        for track_id, box in zip(mine.track_id.tolist(), mine.boxes, strict=True):
            _number(one, track_id, box, None if many else ROOM * image.shape[0])
        one.set_title(f"({letter}) N = {number}", loc="left")
        one.set(xticks=[], yticks=[])
        _zoom(one, rows[np.isin(rows.frame, list(images))].boxes, image)
    for one in axes[len(images) :]:
        one.set_axis_off()
    return figure


def paths(rows: Trajectories, size: tuple[int, int]) -> Figure:
    """The path of each droplet in the image's frame, a colour a droplet."""
    width, height = size
    figure, (axes,) = new(7.5, max(7.5 * height / width, 2.2) + 0.5, 1, 1)
    ids = np.unique(rows.track_id)
    many = len(ids) > MAX_DISTINCT
    colours = [
        mpl.colormaps["turbo"](k / len(ids)) if many else COLOURS(k) for k in range(len(ids))
    ]
    for track_id, colour in zip(ids, colours, strict=True):
        mine = rows.track_id == track_id
        axes.plot(rows.x[mine], rows.y[mine], "-", color=colour, linewidth=1)
        axes.plot(rows.x[mine][:1], rows.y[mine][:1], ".", color=colour, markersize=4)
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set(xlabel="x / px", ylabel="y / px", title=f"{len(ids)} droplets")
    return figure


def inferred_and_true(truth: Trajectories, rows: Trajectories, ids: Sequence[int]) -> Figure:
    """Places y of droplets over the frames, inferred and true, and their difference below."""
    pairs = match(truth, rows)
    figure, axes = new(9.5, 6.4, 4, 2)
    names = truth.track_id[pairs.truth]
    for k, track_id in enumerate(ids[:4]):
        top, below = axes[4 * (k // 2) + k % 2], axes[4 * (k // 2) + 2 + k % 2]
        mine = names == track_id
        frame, true = truth.frame[pairs.truth[mine]], truth.y[pairs.truth[mine]]
        found = rows.y[pairs.result[mine]]
        error = found - true
        mse = float(np.mean(error**2)) if len(error) else float("nan")
        top.plot(frame, true, "-", color="black", linewidth=2.2, label="true")
        top.plot(frame, found, "-", color="tab:red", linewidth=0.9, label="inferred")
        top.set_title(f"({'abcd'[k]}) droplet {track_id}: MSE = {mse:.3g} px²", loc="left")
        top.set(ylabel="y / px", xticklabels=[])
        below.plot(frame, error, color="tab:red", linewidth=0.7)
        below.axhline(0, color="black", linewidth=0.5)
        below.set(ylabel="difference / px", xlabel="frame")
        if not k:
            top.legend(frameon=False)
    for k in range(len(ids), 4):
        axes[4 * (k // 2) + k % 2].set_axis_off()
        axes[4 * (k // 2) + 2 + k % 2].set_axis_off()
    return figure


def methods(found: Mapping[str, Mapping[str, Mapping[str, Any]]], titles: Sequence[str]) -> Figure:
    """HOTA of each method on each video."""
    names = list(dict.fromkeys(name for rows in found.values() for name in rows))
    figure, (axes,) = new(8.5, 0.42 * len(names) + 1.6, 1, 1)
    marks = ("o", "o", "s", "s", "^", "^")
    for k, (clip, title) in enumerate(zip(found, titles, strict=True)):
        values: Floats = np.array(
            [_value(found[clip].get(name, {}).get("hota")) for name in names], float
        )
        degraded = clip.endswith("_degraded")
        axes.plot(
            values, np.arange(len(names)) + 0.07 * (k - len(found) / 2), marks[k % 6],
            markersize=6, color=COLOURS(2 * (k // 2) if degraded else 2 * (k // 2) + 1),
            markeredgecolor="black", markeredgewidth=0.4, label=title,
        )  # fmt: skip
    axes.set(yticks=np.arange(len(names)), yticklabels=names, xlim=(-0.02, 1.02))
    axes.set(xlabel="HOTA")
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.3)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))
    return figure


def _number(axes: Axes, track_id: int, box: Floats, room: float | None) -> None:
    """A droplet's number above its box, or below where there is no room of so many px above.

    In the box where `room` is None. With a white rim, to be read on white, black and lines.
    """
    cx, cy, _, h = box
    y, at = cy, "center"
    if room is not None:
        y, at = (cy - h / 2 - 2, "bottom") if cy - h / 2 > room else (cy + h / 2 + 2, "top")
    axes.text(
        cx, y, str(track_id), color=BLUE, fontsize=6 if room is None else 8, ha="center", va=at,
        clip_on=True, path_effects=[withStroke(linewidth=1.5, foreground="white")],
    )  # fmt: skip


def _zoom(axes: Axes, boxes: Floats, image: Frame) -> None:
    """Show where the boxes are, with room around them, and as much of the image as is there."""
    if not len(boxes):
        return
    room = 1.5 * float(np.median(boxes[:, 2:]))
    low = (boxes[:, :2] - boxes[:, 2:] / 2).min(axis=0) - room
    high = (boxes[:, :2] + boxes[:, 2:] / 2).max(axis=0) + room
    height, width = image.shape[:2]
    axes.set_xlim(max(low[0], 0), min(high[0], width))
    axes.set_ylim(min(high[1], height), max(low[1], 0))


def _value(value: object) -> float:
    return float("nan") if value is None else float(str(value))


def _boxes(axes: Axes, boxes: Floats) -> None:
    for cx, cy, w, h in boxes:
        axes.add_patch(
            Rectangle((cx - w / 2, cy - h / 2), w, h, fill=False, color=BLUE, linewidth=0.8)
        )
