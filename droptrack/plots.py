"""Pictures of results."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from droptrack.drawing import colour_of
from droptrack.trajectories import Trajectories

mpl.rcParams["savefig.dpi"] = 130


def plot_paths(path: Path, rows: Trajectories, width: int, height: int) -> None:
    """The paths of all droplets in the picture's frame, as the paper's figures 8 and 10."""
    figure = Figure(figsize=(10, 10 * height / width + 0.8), layout="constrained")
    axes = figure.subplots()
    for track_id in np.unique(rows.track_id):
        mine = rows.track_id == track_id
        colour = np.array(colour_of(int(track_id)))[::-1] / 255 * 0.85
        axes.plot(rows.x[mine], rows.y[mine], color=colour, linewidth=1.2)
        last = np.flatnonzero(mine)[-1]
        axes.plot(rows.x[last], rows.y[last], "o", color=colour, markersize=4)
        axes.annotate(str(track_id), (rows.x[last], rows.y[last]), fontsize=7)
    axes.set(xlim=(0, width), ylim=(height, 0), xlabel="x / px", ylabel="y / px", aspect="equal")
    axes.set_title(f"{len(np.unique(rows.track_id))} droplets")
    figure.savefig(path)
