"""Images of droplets as laboratories film them: named scenes, each an arrangement.

scattered   droplets of one or of many sizes, apart or overlapping
packing     droplets of about one size, close together, with a free surface
foam        droplets of many sizes pressed into polygons
confined    a foam or a packing between the walls of a channel
suspension  droplets of many sizes at many depths, over others and out of focus
plugs       plugs in a channel with walls, junctions and surroundings
stream      droplets in a channel wider than they are, in one file or two, or anywhere in it
empty       all that surrounds droplets, without any

What the droplets look like is drawn apart from where they lie (`appearance`); surroundings, optics
and sensor follow. A droplet has a label where at least MIN_VISIBLE of it can be seen; its box is
that of its outline, the outside of its rim, cut where the image or the field stop cuts it.
"""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from data_gen.scenes.appearance import paint, random_look
from data_gen.scenes.channels import empty, plugs
from data_gen.scenes.confined import confined
from data_gen.scenes.distances import box_of
from data_gen.scenes.inclusions import paint_inside
from data_gen.scenes.outlines import SHAPE, Outline, foam, packing, scattered, suspension
from data_gen.scenes.scene_kinds import Scene
from data_gen.scenes.streams import stream
from data_gen.scenes.surroundings import (
    add_dirt,
    add_text,
    background,
    field_stop,
    log_uniform,
    vignette,
)
from data_gen.scenes.windings import draw_winding
from droptrack.data.arrays import Bools, Float32s, Floats, Pixels
from droptrack.data.degradation import add_noise, blur, to_pixels
from droptrack.data.frames import grey_frame
from droptrack.data.normalisation import GENTLE, normalisation_for

MIN_VISIBLE = 0.3
MIN_SIDE = 6.0  # px, of a box: smaller droplets cannot be told from dust
LEAST_LEFT = 0.25  # of the contrast of a droplet, for one that is hidden or blurred to have a label
LEAST_LEVELS = 4  # that an image must show of a droplet: what is all white or black has no label
FAINT = 0.1  # share of images whose droplets are much fainter than their surroundings


Arrangement = Callable[[np.random.Generator, Float32s], Iterator[Outline]]


def footage_scene(name: str, rng: np.random.Generator) -> Scene:
    """An image (H, W) of a scene by its name, and the boxes of the droplets in it."""
    canvas, level = background(rng, SHAPE)
    look = random_look(rng, level)
    is_faint = name != "empty" and rng.random() < FAINT
    if is_faint:
        look = look.faint(log_uniform(rng, 8, 40))
    stop = field_stop(rng, SHAPE) if rng.random() < (0.25 if name == "plugs" else 0.1) else None
    if rng.random() < (0.25 if name == "empty" else 0.08):
        draw_winding(rng, canvas)
    drawn = []
    for outline in ARRANGEMENTS[name](rng, canvas):
        drawn.append((outline, paint(canvas, outline, look, rng)))
        if rng.random() < look.inclusions:
            paint_inside(canvas, outline, look.cell_px, rng)
    least = LEAST_LEFT * look.contrast
    seen = [outline for outline, levels in drawn if _span(canvas, outline, levels) >= least]
    boxes = [box for outline in seen if (box := visible_box(outline, stop)) is not None]
    add_dirt(rng, canvas)
    if rng.random() < 0.3:
        vignette(rng, canvas)
    if stop is not None:
        dark = np.float32(rng.uniform(0, 40))
        canvas[~stop] = dark
    if rng.random() < (0.5 if name == "empty" else 0.25):
        many = name == "empty" and rng.random() < 0.5  # most of an image is far from its caption
        for _ in range(int(rng.integers(3, 16)) if many else 1):
            add_text(rng, canvas, anywhere=many)
    if is_faint:
        image = _photograph_faint(rng, canvas, look.contrast)
    else:
        image = _photograph(rng, canvas, faint=0.4 if name == "empty" else 0.12)
    image = _as_shown(image)
    boxes = [box for box in boxes if np.ptp(_around(image, box)) >= LEAST_LEVELS]
    return Scene(image, np.array(boxes).reshape(-1, 4))


def _span(canvas: Float32s, outline: Outline, levels: Float32s) -> float:
    """The grey levels that a droplet spans where others, black or white, lie over it and below."""
    if not levels.size:
        return 0.0
    view = canvas[outline.patch.rows, outline.patch.columns]
    return float(np.ptp(np.clip(view, 0, 255) - np.clip(view - levels, 0, 255)))


def _around(image: Pixels, box: Floats) -> Pixels:
    """What an image (H, W) shows in a box and two pixels around it."""
    low = np.maximum((box[:2] - box[2:] / 2).astype(int) - 2, 0)
    x, y = (box[:2] + box[2:] / 2).astype(int) + 3
    return image[low[1] : y, low[0] : x]


def visible_box(outline: Outline, stop: Bools | None) -> Floats | None:
    """The box [cx, cy, w, h] of what can be seen of a droplet, or None where that is too little."""
    if not outline.labelled or outline.patch.is_empty:
        return None
    distance = outline.distance
    if stop is not None:
        hidden = ~stop[outline.patch.rows, outline.patch.columns]
        distance = np.where(hidden, np.float32(1), distance)
    if (distance < 0).sum() < MIN_VISIBLE * outline.area:
        return None
    edges = box_of(outline.patch, distance)
    if edges is None or (edges[2:] - edges[:2]).min() < MIN_SIDE:
        return None
    return np.concatenate([(edges[:2] + edges[2:]) / 2, edges[2:] - edges[:2]])


def _as_shown(image: Pixels) -> Pixels:
    """What a network is shown of an image (H, W): faint ones are stretched, and their noise."""
    frame = grey_frame(image)
    shown = normalisation_for([frame], stretching=GENTLE).shown(frame)
    return np.ascontiguousarray(shown[..., 0])


def _photograph(rng: np.random.Generator, canvas: Float32s, *, faint: float) -> Pixels:
    """Optics and sensor: focus, motion, contrast, brightness, noise, compression.

    `faint`: share of images of a low contrast.
    """
    levels = np.asarray(canvas, np.float64)
    if rng.random() < 0.7:
        levels = blur(levels, rng.uniform(0.4, 2.4))
    if rng.random() < 0.15:  # motion, along the lines or the columns
        n = int(rng.integers(3, 10))
        kernel = np.full((1, n), 1 / n)
        levels = np.asarray(
            cv2.filter2D(levels, -1, kernel if rng.random() < 0.7 else kernel.T), np.float64
        )
    contrast = rng.uniform(0.35, 1.1) if rng.random() < 0.6 else 1.0
    if rng.random() < faint:
        contrast = rng.uniform(0.08, 0.35)
    middle = float(np.clip(levels.mean(), 40, 215))
    levels = (levels - middle) * contrast + middle
    if rng.random() < 0.2:  # so that much is clipped, white or black
        levels += rng.choice([-1, 1]) * rng.uniform(20, 90)
    if rng.random() < 0.7:
        sigma = rng.uniform(0.5, 12) * min(1.0, contrast + 0.2)
        levels = np.asarray(add_noise(levels, rng.standard_normal(levels.shape), sigma), float)
    pixels = to_pixels(levels)
    if rng.random() < 0.4:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 98))]
        decoded = cv2.imdecode(cv2.imencode(".jpg", pixels, quality)[1], cv2.IMREAD_GRAYSCALE)
        return np.asarray(decoded, np.uint8)
    return pixels


def _photograph_faint(rng: np.random.Generator, canvas: Float32s, contrast: float) -> Pixels:
    """Optics and sensor of droplets that differ by few grey levels, and yet can be seen."""
    levels = np.asarray(canvas, np.float64)
    if rng.random() < 0.7:
        levels = blur(levels, rng.uniform(0.4, 1.2))
    sigma = contrast * rng.uniform(0.02, 0.25)
    return to_pixels(add_noise(levels, rng.standard_normal(levels.shape), sigma))


ARRANGEMENTS: dict[str, Arrangement] = {
    "scattered": scattered,
    "packing": packing,
    "foam": foam,
    "confined": confined,
    "suspension": suspension,
    "plugs": plugs,
    "stream": stream,
    "empty": empty,
}
