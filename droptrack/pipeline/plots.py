"""Plots of results."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from droptrack.data.files import replacing

mpl.rcParams["savefig.dpi"] = 130


def plot_sizes(path: Path, diameters: Sequence[float]) -> None:
    """A histogram of diameters, px."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.hist(diameters, bins="auto" if np.ptp(diameters) else 1, color="tab:blue")
    mean, deviation = np.mean(diameters), np.std(diameters)
    axes.set(xlabel="diameter / px", ylabel="droplets")
    axes.set_title(f"{len(diameters)} droplets, {mean:.1f} ± {deviation:.1f} px")
    with replacing(path) as partial:
        figure.savefig(partial)
