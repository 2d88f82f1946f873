"""One image to look at: what was learned from, and what is found before and after."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from droptrack.adaptation.appearance import Measured
from droptrack.data.arrays import Floats, Pixels
from droptrack.data.darknet_dataset import DataSet, read_ground_truth, read_image, read_scenes
from droptrack.data.frames import Frame
from droptrack.data.samples import spread
from droptrack.data.sources.image_files import write_image_file

COLUMNS = 4
TILE_PX = 400  # wide
TITLE_PX = 22
GREEN, RED = (60, 200, 60), (60, 60, 255)  # BGR, of droplets
WHITE = (255, 255, 255)


def write_contact_sheet(
    path: Path,
    measured: Measured,
    data: DataSet,
    found: Sequence[tuple[Frame, Floats, Floats]],
) -> None:
    """Write the sheet as an image file.

    `found`: images kept back, and the boxes (N, 4) px found before and after. Raises DroptrackError
    where it cannot be written.
    """
    rows = [_row("background", [view.background for view in measured.set_up.views])]
    scenes = read_scenes(data)
    for kind in dict.fromkeys(scenes[image] for image in data.train):
        images = [image for image in data.train if scenes[image] == kind]
        rows.append(
            _row(
                f"learned from: {kind}",
                [_labelled(images[i]) for i in spread(len(images), COLUMNS)],
            )
        )
    some = [found[i] for i in spread(len(found), COLUMNS)]
    rows.append(_row("kept back, before", [_with_boxes(image, old, RED) for image, old, _ in some]))
    rows.append(
        _row("kept back, after", [_with_boxes(image, new, GREEN) for image, _, new in some])
    )
    write_image_file(path, np.vstack(rows))


def _labelled(path: Path) -> Pixels:
    """An image of a data set, and its labels."""
    image = read_image(path)
    return _with_boxes(image, read_ground_truth(path, image.shape[1], image.shape[0]).boxes, GREEN)


def _with_boxes(image: Frame, boxes: Floats, colour: tuple[int, int, int]) -> Pixels:
    """A tile with boxes (N, 4) px of the image."""
    tile, factor = _tile(image)
    for cx, cy, w, h in (boxes * factor).tolist():
        corners = [(round(cx - w / 2), round(cy - h / 2)), (round(cx + w / 2), round(cy + h / 2))]
        cv2.rectangle(tile, corners[0], corners[1], colour, 1)
    return tile


def _tile(image: Frame) -> tuple[Pixels, float]:
    """An image (H, W, C) as wide as a tile, in colour, and how much smaller it became."""
    factor = TILE_PX / image.shape[1]
    size = (TILE_PX, max(1, round(image.shape[0] * factor)))
    shown = np.ascontiguousarray(image) if image.shape[2] == 3 else np.repeat(image, 3, axis=2)
    interpolation = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(shown, size, None, 0, 0, interpolation), np.uint8), factor


def _row(title: str, images: Sequence[Pixels]) -> Pixels:
    """A title, and up to COLUMNS images beside one another."""
    tiles = [image if image.shape[1] == TILE_PX else _tile(image)[0] for image in images[:COLUMNS]]
    height = max(tile.shape[0] for tile in tiles)
    row = np.zeros((TITLE_PX + height, COLUMNS * TILE_PX, 3), np.uint8)
    for place, tile in enumerate(tiles):
        left = place * TILE_PX
        row[TITLE_PX : TITLE_PX + tile.shape[0], left : left + TILE_PX] = tile
    cv2.putText(row, title, (6, TITLE_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, WHITE, 1, cv2.LINE_AA)
    return row
