"""Images of droplets as one's own video shows them: drawn from what was measured on it."""

from pathlib import Path

import numpy as np

from data_gen.scenes.distances import cell_distance, patch_around
from data_gen.scenes.footage import visible_box
from data_gen.scenes.outlines import MAX_NEIGHBOURS, Outline
from droptrack.data.arrays import Float32s, Floats, Pixels
from droptrack.data.detections import iou_matrix
from droptrack.data.set_up import Profile, SetUp, View, outline_distance, read_set_up

SIZE_SPREAD = 0.08  # by which sizes vary beside those seen, standard deviation of the logarithm
PLACE_SPREAD = 0.05  # by which places vary, of the size
LEFT_OUT = 0.15  # share of the droplets of a frame
MAX_OVERLAP = 0.05  # IoU of droplets that do not press on one another
EDGE_PX = 2.0  # from the image's edge, where droplets may be cut
MARGIN_PX = 8.0  # around a droplet, for what its rim does outside


class OwnDroplets:
    """Draws images (H, W, 3) of a set-up, and boxes (N, 4) px of the droplets in them."""

    def __init__(self, set_up: SetUp) -> None:
        self.set_up = set_up

    @staticmethod
    def of_file(path: Path) -> "OwnDroplets":
        """Those of a file of ``droptrack adapt``; raises DroptrackError."""
        return OwnDroplets(read_set_up(path))

    def __call__(self, rng: np.random.Generator) -> tuple[Pixels, Floats]:
        """The next image, and its boxes."""
        set_up = self.set_up
        counts = np.array([sum(map(len, view.frames)) for view in set_up.views])
        view = set_up.views[rng.choice(len(counts), p=counts / counts.sum())]
        canvas = view.background.astype(np.float32)
        strength, stretch = rng.uniform(0.75, 1.25), rng.uniform(0.85, 1.2)
        boxes = []
        for outline in self._outlines(rng, view):
            own = strength * rng.normal(1, 0.06)
            _paint(canvas, outline, view.profile, stretch, own)
            box = visible_box(outline, None)
            if box is not None:
                boxes.append(box)
        canvas += np.float32(rng.normal(0, 5))
        sigma = set_up.noise * rng.uniform(0.7, 1.3)
        canvas += rng.standard_normal((*canvas.shape[:2], 1), np.float32) * np.float32(sigma)
        pixels = np.clip(canvas + np.float32(0.5), 0, 255).astype(np.uint8)
        if pixels.shape[2] == 1:
            pixels = np.repeat(pixels, 3, axis=2)
        return pixels, np.array(boxes).reshape(-1, 4)

    def _outlines(self, rng: np.random.Generator, view: View) -> list[Outline]:
        """The droplets of an image."""
        if self.set_up.dense:
            return _pressed(rng, view)
        shape = view.background.shape[:2]
        found = []
        for box in _apart(rng, view):
            patch = patch_around(shape, box[:2], float(box[2:].max()) / 2 + MARGIN_PX)
            if patch.is_empty:
                continue
            distance = outline_distance(box, view.profile.corners, patch.x, patch.y)
            found.append(
                Outline(
                    patch=patch,
                    distance=distance,
                    radius=float(box[2:].min()) / 2,
                    centre=box[:2],
                    area=float(np.pi / 4 * box[2:].prod()),
                )
            )
        return found


def _paint(
    canvas: Float32s, outline: Outline, profile: Profile, stretch: float, strength: float
) -> None:
    """Add a droplet's grey levels to a canvas (H, W, C), in place."""
    distance, patch = outline.distance * np.float32(stretch), outline.patch
    for channel in range(canvas.shape[2]):
        levels = np.interp(distance, profile.distances, profile.levels[:, channel], right=0.0)
        canvas[patch.rows, patch.columns, channel] += np.float32(strength) * levels


def _apart(rng: np.random.Generator, view: View) -> Floats:
    """Boxes (N, 4): places and sizes as they were seen in any of the frames, so many as in one."""
    n = len(view.frames[rng.integers(len(view.frames))])
    seen = _whole(np.concatenate(view.frames), view.background.shape[1::-1])
    placed = np.zeros((0, 4))
    for _ in range(10 * n):
        if len(placed) >= n or not len(seen):
            break
        box = _varied(rng, seen[rng.integers(len(seen))])
        if not (iou_matrix(box[None], placed) > MAX_OVERLAP).any():
            placed = np.vstack([placed, box])
    return placed


def _whole(boxes: Floats, size: tuple[int, ...]) -> Floats:
    """Those boxes (N, 4) that no edge of the image cuts; all where it cuts each."""
    low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
    whole = ((low > EDGE_PX) & (high < np.array(size) - EDGE_PX)).all(axis=1)
    return boxes[whole] if whole.any() else boxes


def _varied(rng: np.random.Generator, box: Floats) -> Floats:
    """A box of about the size, at about the place."""
    size = box[2:] * np.exp(rng.normal(0, SIZE_SPREAD) + rng.normal(0, SIZE_SPREAD / 2, 2))
    return np.concatenate([box[:2] + rng.normal(0, PLACE_SPREAD, 2) * box[2:].min(), size])


def _pressed(rng: np.random.Generator, view: View) -> list[Outline]:
    """The droplets of one frame, moved a little, flat where they meet."""
    seen = view.frames[rng.integers(len(view.frames))]
    seen = seen[rng.random(len(seen)) > LEFT_OUT]
    height, width = view.background.shape[:2]
    centres = seen[:, :2].copy()
    if rng.random() < 0.5:
        centres[:, 1] = height - centres[:, 1]
    if rng.random() < 0.5:
        centres[:, 0] = width - centres[:, 0]
    radii = np.sqrt(seen[:, 2:].prod(axis=1)) / 2
    centres += rng.normal(0, PLACE_SPREAD, centres.shape) * radii[:, None]
    radii = radii * np.exp(rng.normal(0, SIZE_SPREAD / 2, len(radii)))
    film = rng.uniform(0, 0.08) * float(np.median(radii)) if len(radii) else 0.0
    found = []
    for i in range(len(seen)):
        radius = float(radii[i])
        patch = patch_around((height, width), centres[i], radius + MARGIN_PX)
        if patch.is_empty:
            continue
        apart = np.hypot(*(centres - centres[i]).T)
        near = np.flatnonzero((apart > 0) & (apart < radii[i] + radii + film))
        near = near[np.argsort(apart[near])][:MAX_NEIGHBOURS]
        others = np.column_stack([centres[near], radii[near]])
        found.append(
            Outline(
                patch=patch,
                distance=cell_distance(patch, centres[i], radius, others, film),
                radius=radius,
                centre=centres[i],
                area=0.75 * np.pi * radius**2,
            )
        )
    return found
