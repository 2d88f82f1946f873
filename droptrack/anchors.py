"""Command: anchors that suit a data set's droplets, ``python -m droptrack.anchors``."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from droptrack.command_line import new_app, one_line_errors
from droptrack.data.arrays import Floats
from droptrack.data.darknet_dataset import DataSet, read_data_file, read_labels
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import cfg_text, read_cfg, with_options, yolo_heads


def box_sizes(data: DataSet, width: int, height: int) -> Floats:
    """Sizes (N, 2) px of all training boxes in a network's input of width x height px."""
    sizes = [read_labels(image)[1][:, 2:] for image in data.train]
    return np.concatenate(sizes) * [width, height]


def shape_overlaps(sizes: Floats, anchors: Floats) -> Floats:
    """Overlap (N, K) of boxes (N, 2) and anchors (K, 2) laid on one centre."""
    shared = np.minimum(sizes[:, None], anchors[None]).prod(axis=2)
    return np.asarray(shared / (sizes.prod(axis=1)[:, None] + anchors.prod(axis=1)[None] - shared))


def mean_best_overlap(sizes: Floats, anchors: Floats) -> float:
    """How well the best anchor of each box overlaps it, on average."""
    return float(shape_overlaps(sizes, anchors).max(axis=1).mean())


def find_anchors(sizes: Floats, k: int, rng: np.random.Generator, starts: int = 5) -> Floats:
    """The best (k, 2) anchors by area of some k-means with the distance 1 - overlap.

    As section 2 of YOLO9000 (Redmon and Farhadi, 2017); started as k-means++. Raises ValueError for
    less than k different sizes.
    """
    if len(np.unique(sizes, axis=0)) < k:
        raise ValueError(f"{k} anchors need as many different boxes")
    found = [_k_means(sizes, k, rng) for _ in range(starts)]
    best = max(found, key=lambda anchors: mean_best_overlap(sizes, anchors))
    return best[np.argsort(best.prod(axis=1))]


def _k_means(sizes: Floats, k: int, rng: np.random.Generator) -> Floats:
    anchors = sizes[rng.integers(len(sizes), size=1)]
    while len(anchors) < k:
        distance = 1 - shape_overlaps(sizes, anchors).max(axis=1)
        following = rng.choice(len(sizes), p=distance / distance.sum())
        anchors = np.concatenate([anchors, sizes[following : following + 1]])
    nearest = np.full(len(sizes), -1)
    while True:
        before, nearest = nearest, shape_overlaps(sizes, anchors).argmax(axis=1)
        if (nearest == before).all():
            return anchors
        for cluster in np.unique(nearest):
            anchors[cluster] = np.median(sizes[nearest == cluster], axis=0)


app = new_app()


@app.command()
@one_line_errors
def main(
    data: Annotated[Path, typer.Option(help="Data set (obj.data).")],
    cfg: Annotated[Path, typer.Option(help="Network: its input size and number of anchors.")],
    figure: Annotated[Path | None, typer.Option(help="Draw boxes and anchors here.")] = None,
    write: Annotated[Path | None, typer.Option(help="Write a .cfg with the anchors here.")] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
) -> None:
    """Find the anchors that overlap a data set's droplets best."""
    network = read_cfg(cfg)
    sizes = box_sizes(read_data_file(data), network.width, network.height)
    present = yolo_heads(network)[0].all_anchors
    if write is not None and write.exists():
        raise DroptrackError(f"{write}: is there already; choose another name")
    try:
        anchors = np.round(find_anchors(sizes, len(present), np.random.default_rng(seed)), 1)
    except ValueError as error:
        raise DroptrackError(f"{data}: {error}") from None
    text = ", ".join(f"{w:g},{h:g}" for w, h in anchors.tolist())
    for name, shown in ((f"{cfg} has", present), ("found", anchors)):
        overlap = mean_best_overlap(sizes, shown)
        typer.echo(f"{name}: mean overlap {overlap:.4f} with the best of {len(shown)} anchors")
    typer.echo(f"anchors={text}")
    if figure is not None:
        from droptrack.training.plots import plot_anchors

        plot_anchors(figure, sizes, anchors)
    if write is not None:
        write.write_text(cfg_text(with_options(network, {}, {"anchors": text})), encoding="utf-8")


if __name__ == "__main__":
    app()
