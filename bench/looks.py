"""Sizes of droplets as laboratories film them, with exact truth: ``python -m bench.looks``.

Scenes of `data_gen.scenes.footage`, of moderate blur and noise, whose droplets have a rim, or are
filled, or both: what counts is how many are measured, and how many of these are wrong by more than
3 % and 1.5 px: mostly another edge was taken for the droplet's.
"""

from dataclasses import dataclass

import numpy as np
import typer

from bench.sizes import BOX_ERROR
from data_gen.scenes.appearance import Look, paint, random_look
from data_gen.scenes.footage import ARRANGEMENTS, visible_box
from data_gen.scenes.inclusions import paint_inside
from data_gen.scenes.outlines import SHAPE, Outline
from data_gen.scenes.surroundings import add_dirt, background, vignette
from droptrack.data.arrays import Bools, Floats, Pixels, Rows
from droptrack.data.degradation import add_noise, blur, to_pixels
from droptrack.data.frames import grey_frame
from droptrack.measurement.droplets import load_loops, measure_droplets
from droptrack.measurement.shapes import DIAMETER

MIN_CONTRAST = 30.0  # grey levels
MIN_SIDE_PX = 16.0
WRONG, WRONG_PX = 0.03, 1.5
FLAT = (0.8, 1.1)  # times as wide, and as high, as they should be: boxes of a network that is new
app = typer.Typer(add_completion=False)


@dataclass(frozen=True)
class _Drawn:
    """An image; boxes of all droplets, and which of them stand alone and whole; diameters px."""

    image: Pixels
    boxes: Floats
    counted: Bools
    diameters: Floats


@app.command()
def main(images: int = 80, seed: int = 0) -> None:
    """A row an arrangement, with boxes as good as a network's, and with flat ones.

    `seed`: of the first image; each of the others has the next one.
    """
    load_loops()
    print("droplets | boxes | images | measured | wrong of these | rmse of the others")
    for name in ("scattered", "packing", "plugs"):
        every = (_draw(name, seed + i) for i in range(images))
        drawn = [one for one in every if one.counted.any()]
        for boxes in ("off by 4 %", "off by a fifth"):
            _print(name, boxes, drawn, flat=boxes != "off by 4 %")


def _print(name: str, boxes: str, drawn: list[_Drawn], *, flat: bool) -> None:
    """Each image counts alike, however many droplets it has."""
    measured, wrong, good = [], [], []
    for seed, one in enumerate(drawn):
        off = _errors(one, np.random.default_rng([78, seed]), flat=flat)
        known = np.isfinite(off)
        far = (np.abs(off) > WRONG) & (np.abs(off) * one.diameters[one.counted] > WRONG_PX)
        measured.append(known.mean())
        wrong.append((far & known).mean())
        good += off[known & ~far].tolist()
    print(
        f"{name} | {boxes} | {len(drawn)} | {np.mean(measured):.1%} | "
        f"{np.mean(wrong) / np.mean(measured):.1%} | {np.sqrt(np.mean(np.square(good))):.2%}"
    )


def _errors(one: _Drawn, rng: np.random.Generator, *, flat: bool) -> Floats:
    """Of the diameters of the counted droplets, relative."""
    stretch = rng.uniform(*FLAT, (len(one.boxes), 2)) if flat else 1.0
    boxes = one.boxes.copy()
    boxes[:, 2:] *= stretch
    boxes += rng.normal(0, BOX_ERROR, boxes.shape) * one.boxes[:, [2, 3, 2, 3]]
    found = measure_droplets(grey_frame(one.image), boxes).shapes[one.counted, DIAMETER]
    return np.asarray(found / one.diameters[one.counted] - 1)


def _draw(name: str, seed: int) -> _Drawn:
    rng = np.random.default_rng([77, seed])
    canvas, level = background(rng, SHAPE)
    look = _clear_look(rng, level)
    outlines = list(ARRANGEMENTS[name](rng, canvas))
    covers = np.zeros(SHAPE, np.int64)
    for one in outlines:
        paint(canvas, one, look, rng)
        covers[one.patch.rows, one.patch.columns] += one.distance < 0.5
        if rng.random() < look.inclusions:
            paint_inside(canvas, one, look.cell_px, rng)
    add_dirt(rng, canvas)
    if rng.random() < 0.3:
        vignette(rng, canvas)
    levels = blur(np.asarray(canvas, np.float64), rng.uniform(0.4, 1.0))
    noisy = add_noise(levels, rng.standard_normal(levels.shape), rng.uniform(0.5, 6))
    shown = [(one, box) for one in outlines if (box := visible_box(one, None)) is not None]
    return _Drawn(
        to_pixels(noisy),
        np.array([box for _, box in shown]).reshape(-1, 4),
        np.array([_counts(*both, look, covers) for both in shown], np.bool_),
        np.array([_diameter(one, look) for one, _ in shown]),
    )


def _clear_look(rng: np.random.Generator, level: float) -> Look:
    """A look of which it is clear what the droplet's edge is: that of a rim, or of a filling."""
    while True:
        look = random_look(rng, level)
        rim, fill = look.rim, look.fill
        clear = rim == 0 or rim * fill < 0 or abs(rim) > 1.3 * abs(fill)
        seen = rim or fill
        if clear and MIN_CONTRAST <= abs(seen) <= (level if seen < 0 else 255 - level):
            return look


def _counts(one: Outline, box: Floats, look: Look, covers: Rows) -> bool:
    """Whether a droplet is whole, not small, and no other one covers a part of it.

    Nor is it filled up to two edges: where no rim is seen, to the outside of it, elsewhere not.
    """
    low, high = box[:2] - box[2:] / 2, box[:2] + box[2:] / 2
    whole = (low > 3).all() and (high < np.array(SHAPE[::-1]) - 3).all()
    own = covers[one.patch.rows, one.patch.columns][one.distance < 0.5]
    alone = whole and box[2:].min() >= MIN_SIDE_PX and (own <= 1).all()
    return bool(alone and (look.rim or (np.min(one.rim) == 1 and _diameter(one, look) > 0)))


def _diameter(one: Outline, look: Look) -> float:
    """Of the circle as large as what is painted: without the ring where there is none, px."""
    distance = one.distance + (0 if look.rim else np.float32(look.rim_width(one.radius)))
    return float(np.sqrt(4 / np.pi * np.clip(0.5 - distance, 0, 1).sum()))


if __name__ == "__main__":
    app()
