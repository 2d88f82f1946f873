"""What is in an image beside its droplets: background, channels, dirt, text, the field stop."""

from string import ascii_letters

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from droptrack.data.arrays import Bools, Float32s, Floats


def background(rng: np.random.Generator, shape: tuple[int, int]) -> tuple[Float32s, float]:
    """Grey levels (H, W), unevenly lit and with a coarse texture, and their mean level."""
    level = float(rng.uniform(15, 245))
    height, width = shape
    x = np.linspace(-0.5, 0.5, width, dtype=np.float32)
    y = np.linspace(-0.5, 0.5, height, dtype=np.float32)
    slope = rng.normal(0, 20, 2) if rng.random() < 0.7 else np.zeros(2)
    if rng.random() < 0.15:  # lit from one side
        slope *= rng.uniform(1, 5)
    canvas = np.add.outer(y * np.float32(slope[1]), x * np.float32(slope[0])) + np.float32(level)
    if rng.random() < 0.5:
        canvas += texture(rng, shape, float(rng.uniform(20, 200))) * np.float32(rng.uniform(2, 14))
    if rng.random() < 0.25:
        canvas += texture(rng, shape, float(rng.uniform(3, 12))) * np.float32(rng.uniform(1, 7))
    return canvas, level


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A random number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def texture(rng: np.random.Generator, shape: tuple[int, int], period: float) -> Float32s:
    """Smooth random values (H, W) of about unit size that change within `period` px."""
    coarse = (max(2, round(shape[0] / period)), max(2, round(shape[1] / period)))
    values = rng.standard_normal(coarse).astype(np.float32)
    return np.asarray(cv2.resize(values, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


def draw_line(canvas: Float32s, start: Floats, end: Floats, width: float, level: float) -> None:
    """Add a straight line of a width, px, and a level relative to what is below, in place."""
    mask = np.zeros(canvas.shape, np.uint8)
    points = [tuple(np.round(16 * p).astype(int).tolist()) for p in (start, end)]
    cv2.line(mask, points[0], points[1], 255, max(1, round(width)), cv2.LINE_AA, shift=4)
    canvas += mask * np.float32(level / 255)


def add_dirt(rng: np.random.Generator, canvas: Float32s) -> None:
    """Dust, hairs and scratches, in place; none of it looks like a droplet."""
    height, width = canvas.shape
    if rng.random() < 0.5:
        layer = np.zeros_like(canvas)
        for _ in range(rng.integers(1, 40)):
            place = (int(rng.integers(width)), int(rng.integers(height)))
            axes = tuple(int(v) for v in rng.integers(1, 4, 2))
            cv2.ellipse(layer, place, axes, float(rng.uniform(0, 180)), 0, 360, 1.0, -1)
        soft = cv2.GaussianBlur(layer, (0, 0), float(rng.uniform(0.6, 2)))
        canvas += soft * np.float32(rng.normal(0, 60))
    for _ in range(rng.integers(0, 4) if rng.random() < 0.3 else 0):
        start = rng.uniform(0, 1, 2) * [width, height]
        turn = np.cumsum(rng.normal(0, 0.15, 30)) + rng.uniform(0, 2 * np.pi)
        steps = np.column_stack([np.cos(turn), np.sin(turn)]) * rng.uniform(2, 20)
        points = np.round((start + np.cumsum(steps, axis=0)) * 16).astype(np.int32)
        layer = np.zeros(canvas.shape, np.uint8)
        cv2.polylines(layer, [points], False, 255, int(rng.integers(1, 3)), cv2.LINE_AA, shift=4)
        canvas += layer * np.float32(rng.normal(0, 50) / 255)


def add_text(rng: np.random.Generator, canvas: Float32s, *, anywhere: bool) -> None:
    """What cameras write into their images: time stamps, scale bars, some in a box; in place.

    At the upper or the lower edge in most cases, if not `anywhere`.
    """
    height, width = canvas.shape
    n_words = int(rng.integers(2, 9)) if rng.random() < 0.35 else 1
    n_lines = 1 if rng.random() < 0.8 else int(rng.integers(2, 5))
    lines = [" ".join(_caption(rng) for _ in range(n_words)) for _ in range(n_lines)]
    written = _written(rng, lines)[: height - 8, : width - 8]
    rows, columns = (n - m - 4 for n, m in zip(canvas.shape, written.shape, strict=True))
    at_edge = 0.0 if anywhere else 0.35
    places = [4, rows, rng.integers(4, rows + 1)]
    top = int(rng.choice(places, p=[at_edge, at_edge, 1 - 2 * at_edge]))
    left = int(rng.integers(4, columns + 1))
    place = canvas[top : top + written.shape[0], left : left + written.shape[1]]
    dark = bool(rng.random() < 0.5)
    if rng.random() < 0.25:  # in a box of the other colour
        place[:] = np.float32(255 if dark else 0)
    place += (np.float32(0 if dark else 255) - place) * written


def _caption(rng: np.random.Generator) -> str:
    digits = "".join(str(d) for d in rng.integers(0, 10, 9))
    letters = "".join(rng.choice(list(ascii_letters), 8))
    return str(
        rng.choice(
            [
                f"{digits[:2]}:{digits[2:4]}.{digits[4:6]}",
                f"{digits[:4]} {rng.choice(['ms', 'fps', 'um', 'x', 's'])}",
                f"-{digits[0]}.{digits[1:4]} s  {digits[4:]}",
                f"{rng.choice(['Frame', 'Cam', 'Exp', 'Sample', 'Oil', 'Co'])} {digits[:3]}",
                f"20{digits[:2]}-{digits[2:4]}-{digits[4:6]}",
                letters[: rng.integers(2, 9)],
                digits[: rng.integers(1, 7)],
                f"({rng.choice(list('abcdefgo'))}) {letters[:5]} = {digits[0]}.{digits[1:3]}",
            ]
        )
    )


def _written(rng: np.random.Generator, lines: list[str]) -> Float32s:
    """Lines of text, and in two of five cases a scale bar below, as ink (H, W) from 0 to 1."""
    size = log_uniform(rng, 10, 60)  # px
    longest = max(map(len, lines))
    page = np.zeros(
        (int(1.5 * size * (len(lines) + 1)) + 8, int(0.8 * longest * size) + 220), np.uint8
    )
    if rng.random() < 0.5:
        font = int(rng.integers(0, 8)) + (cv2.FONT_ITALIC if rng.random() < 0.2 else 0)
        stroke = int(rng.integers(1, 2 + round(size / 15)))
        style = cv2.LINE_8 if rng.random() < 0.5 else cv2.LINE_AA
        for k, line in enumerate(lines):  # OpenCV 5 writes on bytes only
            place = (4, int((1.5 * k + 1.1) * size))
            cv2.putText(page, line, place, font, size / 30, 255, stroke, style)
    else:
        thick = int(rng.integers(0, 1 + round(size / 20)))
        sheet, font_of_pillow = Image.fromarray(page), ImageFont.load_default(size)
        ImageDraw.Draw(sheet).multiline_text(
            (4, 2), "\n".join(lines), 255, font_of_pillow, spacing=size / 3, stroke_width=thick
        )
        page = np.array(sheet)
    if rng.random() < 0.4:
        y, length = page.shape[0] - 6, int(rng.integers(40, 200))
        cv2.line(page, (4, y), (4 + length, y), 255, int(rng.integers(2, 7)))
    rows, columns = np.nonzero(page)
    ink = page[max(0, rows.min() - 4) : rows.max() + 5, : columns.max() + 5]
    return np.asarray(ink / np.float32(255), np.float32)


def field_stop(rng: np.random.Generator, shape: tuple[int, int]) -> Bools:
    """Where (H, W) a round opening lets light through; some of it lies beyond the image."""
    height, width = shape
    radius = rng.uniform(0.5, 1.1) * width / 2
    cx = width / 2 + rng.normal(0, 0.1) * width
    cy = height / 2 + rng.normal(0, 0.15) * height
    y, x = np.ogrid[:height, :width]
    return np.asarray((x - cx) ** 2 + (y - cy) ** 2 < radius**2)


def vignette(rng: np.random.Generator, canvas: Float32s) -> None:
    """Darker towards the corners, in place."""
    height, width = canvas.shape
    x = np.linspace(-1, 1, width, dtype=np.float32) + np.float32(rng.normal(0, 0.15))
    y = np.linspace(-1, 1, height, dtype=np.float32) + np.float32(rng.normal(0, 0.15))
    canvas *= 1 - np.float32(rng.uniform(0.1, 0.45)) * np.minimum(np.add.outer(y * y, x * x) / 2, 1)
