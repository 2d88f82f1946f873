"""Plots of trainings."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from droptrack.data.files import replacing
from droptrack.training.log import Step


def plot_training(path: Path, steps: Sequence[Step]) -> None:
    """Loss and mAP against the iteration, as the paper's figure 6."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    left = figure.subplots()
    right = left.twinx()
    iterations = np.array([step.iteration for step in steps], float)
    loss = np.array([step.average_loss for step in steps], float)
    mean_ap = np.array([step.mean_ap for step in steps], float)
    measured = np.isfinite(mean_ap)
    left.plot(iterations, loss, color="tab:blue", linewidth=1)
    right.plot(iterations[measured], mean_ap[measured], "o-", color="tab:red", markersize=3)
    shown = loss[np.isfinite(loss)]
    # the first iterations' loss is hundreds of times the last's
    top = 2 * float(np.quantile(shown, 0.8)) if len(shown) else 1.0
    left.set(xlabel="iteration", ylim=(0, top or 1.0))
    left.set_ylabel("average loss", color="tab:blue")
    right.set(ylim=(0, 1.02))
    right.set_ylabel("mAP@0.50", color="tab:red")
    left.grid(alpha=0.3)
    if measured.any():
        figure.suptitle(f"mAP@0.50 {mean_ap[measured][-1]:.4f}, best {mean_ap[measured].max():.4f}")
    with replacing(path) as partial:
        figure.savefig(partial)


def plot_anchors(path: Path, sizes: NDArray[np.float64], anchors: NDArray[np.float64]) -> None:
    """Sizes (N, 2) px of boxes, as a density, and anchors (K, 2)."""
    figure = Figure(figsize=(6, 5.5), layout="constrained")
    axes = figure.subplots()
    top = 1.05 * float(max(np.quantile(sizes, 0.999), anchors.max()))
    cells = axes.hexbin(
        *sizes.T, gridsize=50, extent=(0, top, 0, top), bins="log", mincnt=1, cmap="Blues"
    )
    axes.plot(*anchors.T, "o", color="tab:red", markersize=5)
    for width, height in anchors:
        axes.annotate(f"{width:g} x {height:g}", (width, height), fontsize=7)
    axes.set(
        xlim=(0, top), ylim=(0, top), aspect="equal", xlabel="width / px", ylabel="height / px"
    )
    figure.colorbar(cells, label="boxes")
    with replacing(path) as partial:
        figure.savefig(partial)
