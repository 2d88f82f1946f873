"""Plots of results."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from droptrack.data.files import replacing

mpl.rcParams["savefig.dpi"] = 130


def plot_sizes(path: Path, diameters: Sequence[float], unit: str) -> None:
    """A histogram of diameters in a unit."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.hist(diameters, bins="auto" if np.ptp(diameters) else 1, color="tab:blue")
    mean, deviation = np.mean(diameters), np.std(diameters)
    axes.set(xlabel=f"diameter / {unit}", ylabel="droplets")
    axes.set_title(f"{len(diameters)} droplets, {mean:.4g} ± {deviation:.2g} {unit}")
    with replacing(path) as partial:
        figure.savefig(partial)
