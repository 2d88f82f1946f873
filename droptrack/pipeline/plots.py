"""Plots of results."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from droptrack.pipeline.drawing import colour_of

mpl.rcParams["savefig.dpi"] = 130


def plot_paths(
    path: Path, lines: Mapping[int, NDArray[np.float32]], width: int, height: int
) -> None:
    """The paths (K, 2) px of all droplets in the image's frame, as the paper's figures 8, 10."""
    figure = Figure(figsize=(10, 10 * height / width + 0.8), layout="constrained")
    axes = figure.subplots()
    for track_id, points in lines.items():
        colour = np.array(colour_of(track_id))[::-1] / 255 * 0.85
        axes.plot(*points.T, color=colour, linewidth=1.2)
        axes.plot(*points[-1], "o", color=colour, markersize=4)
        axes.annotate(str(track_id), points[-1].tolist(), fontsize=7)
    axes.set(xlim=(0, width), ylim=(height, 0), xlabel="x / px", ylabel="y / px", aspect="equal")
    axes.set_title(f"{len(lines)} droplets")
    figure.savefig(path)


def plot_sizes(path: Path, diameters: Sequence[float]) -> None:
    """A histogram of diameters, px."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.hist(diameters, bins="auto" if np.ptp(diameters) else 1, color="tab:blue")
    mean, deviation = np.mean(diameters), np.std(diameters)
    axes.set(xlabel="diameter / px", ylabel="droplets")
    axes.set_title(f"{len(diameters)} droplets, {mean:.1f} ± {deviation:.1f} px")
    figure.savefig(path)
