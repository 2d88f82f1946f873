"""What droplets look like, apart from where they lie: rims, fillings, lens effects, shading.

A `Look` is drawn once for an image, since droplets of one video look alike. It says how a
droplet's grey levels follow from the signed distance to its outline (`distances`).
"""

from dataclasses import dataclass, replace

import numpy as np

from data_gen.scenes.outlines import Outline, margin_of
from data_gen.scenes.surroundings import log_uniform, texture
from droptrack.data.arrays import Float32s

PARTS = ("fill", "tilt", "rim", "second", "halo", "core", "texture")  # of a look, in grey levels
CELLS = 0.12  # share of images whose droplets have cells inside
SHADINGS = (0.65, 0.25, 0.1)  # shares of images without shading, with little, with much


@dataclass(frozen=True, kw_only=True)
class Look:
    """The appearance of an image's droplets; grey levels are relative to the background.

    `fill`: level of the inside, and `tilt`: by how much it is more on the side of `light`, an angle
    in radians. `rim`: level of the ring along the outline, whose width is `rim_px` and `rim_share`
    of the droplet's radius; `shading`: how much stronger it is on the side of the light: above 1 it
    is the reverse on the other side, as in oblique light and differential interference contrast.
    `second`: level of a ring inside that one, at `second_at` rim widths from the outline. `halo`:
    level of the fringe outside the outline, as phase contrast makes it, or focus. `core`: level of
    a spot in the middle, as a lens makes it, or `core_at` of the radius towards the light, a
    reflection; it is `core_size` of the radius wide. `soft`: width, px, of the edge. `texture`:
    level of the random variation inside. `inclusions`: probability that a droplet has small things
    inside it; `cell_px`: their radius where they are cells, of one size in all droplets, else 0.
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
    tilt: float = 0.0
    halo: float = 0.0
    core_at: float = 0.0

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
    core, core_size, core_at = _random_core(rng)
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
        core=core,
        core_size=core_size,
        core_at=core_at,
        shading=float(rng.choice([0.0, rng.uniform(0.2, 0.9), rng.uniform(1, 2.5)], p=SHADINGS)),
        light=float(rng.uniform(0, 2 * np.pi)),
        soft=float(rng.uniform(0.8, 2)),
        texture=float(rng.uniform(0, 14)) if rng.random() < 0.5 else 0.0,
        inclusions=0.9 if cells else float(rng.choice([0.0, 0.15, 0.7], p=[0.6, 0.25, 0.15])),
        cell_px=log_uniform(rng, 1.5, 14) if cells else 0.0,
        tilt=float(rng.normal(0, 35)) if rng.random() < 0.15 else 0.0,
        halo=-(rim or fill) * float(rng.uniform(0.15, 0.6)) if rng.random() < 0.2 else 0.0,
    )


def _random_core(rng: np.random.Generator) -> tuple[float, float, float]:
    """The level of a spot in a droplet, its size, and where it is: in two of three, none."""
    kind = rng.random()
    if kind > 0.4:
        return 0.0, 0.5, 0.0
    if kind < 0.3:
        return float(rng.normal(0, 50)), float(rng.uniform(0.1, 0.6)), 0.0
    return float(rng.uniform(30, 150)), float(rng.uniform(0.06, 0.3)), float(rng.uniform(0.2, 0.7))


def paint(canvas: Float32s, outline: Outline, look: Look, rng: np.random.Generator) -> Float32s:
    """Draw a droplet onto the canvas (H, W) of grey levels, in place; what its patch got of it."""
    patch, distance, radius = outline.patch, outline.distance, outline.radius
    soft = np.float32(look.soft + outline.defocus)
    inside = np.clip(np.float32(0.5) - distance / soft, 0, 1)
    width = np.float32(look.rim_width(radius))
    vary = 1 + rng.normal(0, 0.06)
    levels = inside * np.float32(look.fill * vary)
    ring = np.clip((width / 2 - np.abs(distance + width / 2)) / soft + np.float32(0.5), 0, 1)
    ring *= outline.rim * (width / (width + np.float32(outline.defocus)))
    strength: Float32s | float = 1.0
    if look.shading or look.tilt:
        towards = _towards_light(outline, look)
        levels += inside * towards * np.float32(look.tilt)
        strength = 1 + np.float32(look.shading) * towards
    levels = levels * (1 - ring) + ring * strength * np.float32(look.rim * vary)
    if look.second:
        at = np.float32(look.second_at) * width + width / 2
        bump = np.exp(-(((distance + at) / (width * np.float32(0.6))) ** 2))
        levels += inside * bump * np.float32(look.second)
    if look.halo:
        reach = min(width, np.float32(margin_of(radius) / 2.5))
        fringe = (1 - inside) * np.exp(-((distance / reach) ** 2))
        levels += outline.rim * fringe * np.float32(look.halo)
    if look.core:
        levels += inside * _spot(outline, look) * np.float32(look.core)
    view = canvas[patch.rows, patch.columns]
    if look.texture and min(view.shape) > 8:
        levels += inside * texture(rng, view.shape, 12) * np.float32(look.texture)
    view += levels
    return np.asarray(levels, np.float32)


def _towards_light(outline: Outline, look: Look) -> Float32s:
    """How far towards the light (H, W) each pixel is, of the radius, from -1 to 1."""
    patch, (x, y) = outline.patch, outline.centre.astype(np.float32)
    along = (patch.x - x) * np.float32(np.cos(look.light) / outline.radius)
    up = (patch.y - y) * np.float32(np.sin(look.light) / outline.radius)
    return np.asarray(np.clip(np.add.outer(up, along), -1, 1), np.float32)


def _spot(outline: Outline, look: Look) -> Float32s:
    """A spot (H, W) in the middle of a droplet, or towards the light, up to 1."""
    patch, size = outline.patch, np.float32(look.core_size * outline.radius)
    away = look.core_at * outline.radius * np.array([np.cos(look.light), np.sin(look.light)])
    x, y = (outline.centre + away).astype(np.float32)
    apart = np.add.outer(((patch.y - y) / size) ** 2, ((patch.x - x) / size) ** 2)
    return np.asarray(np.exp(-apart), np.float32)
