"""What droplets look like, apart from where they lie: rims, fillings, lens effects, shading.

A `Look` is drawn once for an image, since droplets of one video look alike. It says how a
droplet's grey levels follow from the signed distance to its outline (`distances`).
"""

from dataclasses import dataclass, replace

import numpy as np

from data_gen.scenes.outlines import Outline
from data_gen.scenes.surroundings import log_uniform, texture
from droptrack.data.arrays import Float32s

PARTS = ("fill", "rim", "second", "core", "texture")  # of a look, in grey levels
CELLS = 0.12  # share of images whose droplets have cells inside


@dataclass(frozen=True, kw_only=True)
class Look:
    """The appearance of an image's droplets; grey levels are relative to the background.

    `fill`: level of the inside. `rim`: level of the ring along the outline, whose width is
    `rim_px` and `rim_share` of the droplet's radius. `second`: level of a ring inside that one,
    at `second_at` rim widths from the outline. `core`: level of a spot in the middle, as a lens
    makes it, `core_size` of the radius wide. `shading`: how much stronger the rim is on the side
    of `light`, an angle in radians. `soft`: width, px, of the edge. `texture`: level of the random
    variation inside. `inclusions`: probability that a droplet has small things inside it;
    `cell_px`: their radius where they are cells, of one size in all droplets, else 0.
    """

    fill: float
    rim: float
    rim_px: float
    rim_share: float
    second: float
    second_at: float
    core: float
    core_size: float
    shading: float
    light: float
    soft: float
    texture: float
    inclusions: float
    cell_px: float = 0.0

    @property
    def contrast(self) -> float:
        """The most grey levels by which a droplet differs from the background."""
        return max(abs(self.fill), abs(self.rim))

    def faint(self, levels: float) -> "Look":
        """The same droplets with so many grey levels of contrast, and nothing inside."""
        share = levels / self.contrast
        parts = {name: share * getattr(self, name) for name in PARTS}
        return replace(self, **parts, inclusions=0.0)

    def rim_width(self, radius: float) -> float:
        """Width, px, of the rim of a droplet."""
        return self.rim_px + self.rim_share * radius


def random_look(rng: np.random.Generator, background: float) -> Look:
    """A look that is visible on a background of a grey level: rim, filled, or both."""
    kind = rng.choice(["rim", "filled", "both"], p=[0.55, 0.2, 0.25])
    room = {-1: background, 1: 255 - background}

    def level(least: float, most: float, sign: int) -> float:
        return sign * float(min(rng.uniform(least, most), max(room[sign], least)))

    brighter = 1 if room[1] > room[-1] else -1
    fill_sign = int(rng.choice([brighter, -brighter], p=[0.75, 0.25]))
    if room[fill_sign] < 40:
        fill_sign = brighter
    fill = rng.normal(0, 10) if kind == "rim" else level(40, 200, fill_sign)
    # most rims are dark: light that is refracted misses the lens
    rim_sign = -1 if room[-1] > 60 and rng.random() < 0.8 else brighter
    rim = 0.0 if kind == "filled" else level(25, 190, rim_sign)
    second = rng.random() < 0.5
    core = rng.random() < 0.33
    cells = rng.random() < CELLS
    return Look(
        fill=float(fill),
        rim=rim,
        rim_px=float(rng.uniform(0.8, 4.5)),
        rim_share=float(rng.uniform(0, 0.09))
        if rng.random() < 0.8
        else float(rng.uniform(0.1, 0.5)),
        second=-rim * float(rng.uniform(0.15, 0.6)) if second else 0.0,
        second_at=float(rng.uniform(1.0, 1.8)),
        core=float(rng.normal(0, 50)) if core else 0.0,
        core_size=float(rng.uniform(0.1, 0.6)),
        shading=float(rng.uniform(0.2, 0.9)) if rng.random() < 0.35 else 0.0,
        light=float(rng.uniform(0, 2 * np.pi)),
        soft=float(rng.uniform(0.8, 2)),
        texture=float(rng.uniform(0, 14)) if rng.random() < 0.5 else 0.0,
        inclusions=0.9 if cells else float(rng.choice([0.0, 0.15, 0.7], p=[0.6, 0.25, 0.15])),
        cell_px=log_uniform(rng, 1.5, 14) if cells else 0.0,
    )


def paint(canvas: Float32s, outline: Outline, look: Look, rng: np.random.Generator) -> None:
    """Draw a droplet onto the canvas (H, W) of grey levels, in place."""
    patch, distance, radius = outline.patch, outline.distance, outline.radius
    soft = np.float32(look.soft + outline.defocus)
    inside = np.clip(np.float32(0.5) - distance / soft, 0, 1)
    width = np.float32(look.rim_width(radius))
    vary = 1 + rng.normal(0, 0.06)
    levels = inside * np.float32(look.fill * vary)
    ring = np.clip((width / 2 - np.abs(distance + width / 2)) / soft + np.float32(0.5), 0, 1)
    ring *= outline.rim * (width / (width + np.float32(outline.defocus)))
    strength: Float32s | float = 1.0
    middle_x, middle_y = patch.x.mean(), patch.y.mean()
    if look.shading:
        x = (patch.x - middle_x) * np.float32(np.cos(look.light) / radius)
        y = (patch.y - middle_y) * np.float32(np.sin(look.light) / radius)
        strength = 1 + np.float32(look.shading) * np.clip(np.add.outer(y, x), -1, 1)
    levels = levels * (1 - ring) + ring * strength * np.float32(look.rim * vary)
    if look.second:
        at = np.float32(look.second_at) * width + width / 2
        bump = np.exp(-(((distance + at) / (width * np.float32(0.6))) ** 2))
        levels += inside * bump * np.float32(look.second)
    if look.core:
        size = np.float32(look.core_size * radius)
        x, y = (patch.x - middle_x) / size, (patch.y - middle_y) / size
        spot = np.exp(-np.add.outer(y * y, x * x))
        levels += inside * spot * np.float32(look.core)
    view = canvas[patch.rows, patch.columns]
    if look.texture and min(view.shape) > 8:
        levels += inside * texture(rng, view.shape, 12) * np.float32(look.texture)
    view += levels
