"""A thousand droplets in a large image: each is found once, and hardly anything else."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from droptrack.data.arrays import Floats
from droptrack.data.sources.image_files import write_image_file
from droptrack.pipeline.config import ImagesConfig
from droptrack.pipeline.detect_images import detect_images

N = 1000


def lattice(size: tuple[int, int], radius: tuple[float, float]) -> Floats:
    """x, y and radius of each disc (N, 3), moved about on a lattice so that they do not touch."""
    rng = np.random.default_rng(0)
    columns = round(np.sqrt(N * size[0] / size[1]))
    rows = -(-N // columns)
    pitch = min(size[0] / columns, size[1] / rows)
    place = np.arange(N)
    centres = (np.column_stack([place % columns, place // columns]) + 0.5) * pitch
    radii = rng.uniform(*radius, N)
    free = pitch / 2 - radii - 2
    assert (free > 0).all()
    return np.column_stack([centres + rng.uniform(-1, 1, (N, 2)) * free[:, None], radii])


@pytest.mark.parametrize(
    ("size", "radius", "ring"),
    [((4000, 3000), (30.0, 50.0), False), ((8192, 4320), (40.0, 60.0), True)],
)
def test_each_of_a_thousand_droplets_is_found_once(
    tmp_path: Path, size: tuple[int, int], radius: tuple[float, float], ring: bool
) -> None:
    """Discs, and dark rings on grey. At too small a scale, one box stood for two, or beside one."""
    discs = lattice(size, radius)
    image = np.full(size[::-1], 150 if ring else 40, np.float32)
    for x, y, r in discs:
        centre = (round(x * 16), round(y * 16))
        cv2.circle(image, centre, round(r * 16), 60 if ring else 200, -1, cv2.LINE_AA, 4)
        if ring:
            cv2.circle(image, centre, round((r - 3) * 16), 170, -1, cv2.LINE_AA, 4)
    image += np.random.default_rng(1).normal(0, 3, image.shape)
    path = tmp_path / "discs.png"
    write_image_file(path, np.clip(image, 0, 255).astype(np.uint8))
    out = tmp_path / "out"
    detect_images(
        ImagesConfig(sources=(str(path),), out=out, annotated=False, shape=False),
        lambda _: None,
        progress=False,
    )
    table = np.genfromtxt(out / "detections.csv", delimiter=",", names=True, dtype=None)
    found = np.column_stack([table["x"], table["y"]])
    apart = np.hypot(*(discs[:, None, :2] - found).transpose(2, 0, 1))
    near = apart < discs[:, 2:] / 2
    assert (near.sum(axis=1) == 1).all()
    # the network takes some gaps between discs, and between them and the edge, for droplets
    assert len(found) <= 1.01 * N
