"""How well sizes and shapes are measured, and how long it takes: ``python -m bench.sizes``."""

import time
from collections.abc import Iterator
from unittest.mock import patch

import numpy as np
import typer

from bench.drawn import DROPLETS, SIZE
from data_gen.scenes import scene_kinds
from data_gen.scenes.shapes import Canvas, draw_ellipses, ellipse_boxes
from droptrack.data import degradation
from droptrack.data.arrays import Floats
from droptrack.data.frames import grey_frame
from droptrack.measurement.droplets import load_loops, measure_droplets
from droptrack.measurement.shapes import COLUMNS

BOX_ERROR = 0.04  # of a box's size, standard deviation, as the int8 network's
GROUND, INSIDE, RING_PX = 120, 125, 3.0
app = typer.Typer(add_completion=False)


@app.command()
def main(images: int = 20, turns: int = 200) -> None:
    """A row a kind of image: error of the diameter, of the deformation, and what was measured."""
    load_loops()
    print("image | droplets | measured | rmse px | rmse % | bias % | rms of D")
    for kind in ("a", "b", "c"):
        _print(f"scene {kind}", list(_scenes(kind, images, degraded=False)))
        _print(f"scene {kind}, degraded", list(_scenes(kind, images, degraded=True)))
        with patch.object(degradation, "blur", lambda image, sigma_px: image):
            in_focus = list(_scenes(kind, images, degraded=True))
        _print(f"scene {kind}, degraded but in focus", in_focus)
    for gap in (1, 2, 4):
        _print(f"packing, {gap} px apart", [_packing(gap, ring=False)])
        _print(f"packing of rings, {gap} px apart", [_packing(gap, ring=True)])
    for level in (20, 230):
        for width in (RING_PX, 2.0, 1.5, 1.0):
            _print(f"rings of {level} grey levels, {width:g} px", [_rings(level, width)])
    for shape in (False, True):
        print(f"{DROPLETS} droplets, shape={shape}: {_milliseconds(turns, shape=shape):.2f} ms")


def _print(name: str, drawn: list[tuple[Canvas, Floats]]) -> None:
    rng = np.random.default_rng(0)
    rows = []
    for canvas, ellipses in drawn:
        boxes = ellipse_boxes(ellipses)
        boxes = boxes + rng.normal(0, BOX_ERROR, boxes.shape) * boxes[:, [2, 3, 2, 3]]
        found = measure_droplets(grey_frame(canvas), boxes).shapes
        a, b = np.maximum(*ellipses[:, 2:4].T), np.minimum(*ellipses[:, 2:4].T)
        diameter, deformation = 2 * np.sqrt(a * b), (a - b) / (a + b)
        off = found[:, COLUMNS.index("diameter_px")] - diameter
        rows.append([off, off / diameter, found[:, COLUMNS.index("deformation")] - deformation])
    pixels, share, deformation = np.concatenate(rows, axis=1)
    known = np.isfinite(pixels)
    rms = [np.sqrt((one[known] ** 2).mean()) for one in (pixels, share, deformation)]
    print(
        f"{name} | {len(known)} | {known.mean():.1%} | {rms[0]:.3f} | {rms[1]:.2%} | "
        f"{share[known].mean():+.2%} | {rms[2]:.4f}"
    )


def _scenes(kind: str, n: int, *, degraded: bool) -> Iterator[tuple[Canvas, Floats]]:
    """Images of a scene and the ellipses in them, which are caught while they are drawn."""
    for seed in range(n):
        caught: list[Floats] = []

        def draw(canvas: Canvas, some: Floats, level: int, into: list[Floats] = caught) -> None:
            if level:
                into.append(some)
            draw_ellipses(canvas, some, level)

        rng = np.random.default_rng([5, seed])
        with patch.object(scene_kinds, "draw_ellipses", draw):
            image = np.asarray(scene_kinds.SCENES[kind](rng).image)
        yield (degradation.degrade(image, rng) if degraded else image), np.concatenate(caught)


def _packing(gap: float, *, ring: bool) -> tuple[Canvas, Floats]:
    """A hexagonal packing of 19 discs of 15 px."""
    row, column = np.mgrid[-2:3, -3:4].reshape(2, -1)
    places = np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * (30.0 + gap)
    places = places[np.hypot(*places.T) < 75] + [120.3, 119.6]
    drawn = np.column_stack([places, np.full((len(places), 2), 15.0), np.zeros(len(places))])
    canvas = np.full((240, 240), GROUND if ring else 0, np.uint8)
    draw_ellipses(canvas, drawn, 20 if ring else 255)
    if ring:
        draw_ellipses(canvas, drawn - [0, 0, RING_PX, RING_PX, 0], INSIDE)
    return canvas, drawn


def _rings(level: int, width: float) -> tuple[Canvas, Floats]:
    rng = np.random.default_rng(1)
    places = np.column_stack([np.arange(36) % 6 * 90 + 60, np.arange(36) // 6 * 90 + 60])
    r, stretch = rng.uniform(6, 25, 36), np.sqrt(rng.uniform(1, 2.33, 36))
    drawn = np.column_stack([places, r * stretch, r / stretch, rng.uniform(0, np.pi, 36)])
    canvas = np.full((600, 600), GROUND, np.uint8)
    draw_ellipses(canvas, drawn, level)
    draw_ellipses(canvas, drawn - [0, 0, width, width, 0], INSIDE)
    return canvas, drawn


def _milliseconds(turns: int, *, shape: bool) -> float:
    """A frame's processor time, median."""
    row, column = np.divmod(np.arange(DROPLETS), 10)
    radii = np.random.default_rng(0).uniform(16, 30, DROPLETS)
    drawn = np.column_stack([60 + 116 * column, 70 + 115 * row, radii, radii, 0 * radii])
    canvas = np.zeros(SIZE[::-1], np.uint8)
    draw_ellipses(canvas, drawn, 255)
    boxes, taken = ellipse_boxes(drawn), []
    for _ in range(turns):
        start = time.thread_time()
        measure_droplets(grey_frame(canvas), boxes, shape=shape)
        taken.append(time.thread_time() - start)
    return 1e3 * float(np.median(taken))


if __name__ == "__main__":
    app()
