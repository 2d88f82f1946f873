"""The images that a network is trained on: drawn, pasted, seen, labelled, and some it knows."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from droptrack.adaptation.appearance import Measured
from droptrack.adaptation.backgrounds import painted_over, pixels_of
from droptrack.adaptation.crops import Crop, cut_out, paste
from droptrack.adaptation.trust import Seen
from droptrack.data.arrays import Floats, Pixels
from droptrack.data.darknet_dataset import image_name, label_text, write_data_file, write_scenes
from droptrack.data.files import write_text
from droptrack.data.sources.image_files import write_image_file
from droptrack.detection.scale import Canvas
from droptrack.training.config import DrawImage

N_TRAIN, N_VALID = 640, 40
# shares of the images, without and with labels
SHARES = {"seen": 0.3, "pasted": 0.25, "drawn": 0.25, "known": 0.2}
LABELLED_SHARES = {"labelled": 0.45, "seen": 0.1, "pasted": 0.15, "drawn": 0.15, "known": 0.15}
SIZES_PX = (8.0, 240.0)  # of droplets in the network's input that are taught
MIN_SIDE_PX = 6.0  # the smaller side
JPEG_QUALITY = 95
KNOWN_SCALE = (0.3, 1.1)  # of the images that the network knows: px of its input for one of theirs
EMPTY = 0.06  # share of the pasted images that are background alone

Image = tuple[Pixels, Floats]  # (H, W, C) and boxes (N, 4) px


@dataclass(frozen=True, kw_only=True)
class Ingredients:
    """What images are made of.

    `draw_own` draws the set-up, `draw_known` what the network learned before; `canvas`: how the
    network sees an image of the video.
    """

    measured: Measured
    draw_own: DrawImage
    draw_known: DrawImage
    canvas: Canvas


def write_training_set(folder: Path, ingredients: Ingredients, seed: int) -> Iterator[int]:
    """Write a Darknet data set into a folder; yields the number of images so far.

    obj.data is written last, as a sign that all is there. An image depends on the seed, its number
    and the ingredients only.
    """
    crops = cut_out(ingredients.measured, np.random.default_rng([seed, 1]))
    makers = _makers(ingredients, crops)
    labelled = any(one.labelled for one in ingredients.measured.seen)
    shares = LABELLED_SHARES if labelled else SHARES
    shares = {kind: share for kind, share in shares.items() if makers[kind] is not None}
    counts = {"train": N_TRAIN, "valid": N_VALID}
    scenes = {}
    done = 0
    for split, count in counts.items():
        (folder / split).mkdir(parents=True, exist_ok=True)
        kinds = _in_turn(shares, count)
        for number, kind in enumerate(kinds):
            rng = np.random.default_rng([seed, 2 + (split == "valid"), number])
            make = makers[kind]
            assert make is not None
            image, boxes = make(rng, kinds[:number].count(kind))
            if kind != "known":
                image = _extended(image, ingredients.canvas)
            name = image_name(split, number)
            write_image_file(folder / name, image, JPEG_QUALITY)
            height, width = image.shape[:2]
            text = label_text(boxes, width, height)
            write_text((folder / name).with_suffix(".txt"), text)
            scenes[name] = kind
            done += 1
            yield done
    write_scenes(folder, scenes)
    write_data_file(folder, ("droplet",), counts)


def _extended(image: Pixels, canvas: Canvas) -> Pixels:
    """An image (H, W, C) on a canvas, so that its shape is that of the network's input."""
    right, below = canvas.size[0] - image.shape[1], canvas.size[1] - image.shape[0]
    wider = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return np.asarray(wider, np.uint8).reshape(*wider.shape[:2], -1)


def _in_turn(shares: dict[str, float], count: int) -> list[str]:
    """So many kinds, in their shares, evenly mixed."""
    total = sum(shares.values())
    owed = dict.fromkeys(shares, 0.0)
    kinds = []
    for _ in range(count):
        for kind, share in shares.items():
            owed[kind] += share / total
        most = max(owed, key=lambda kind: owed[kind])
        owed[most] -= 1
        kinds.append(most)
    return kinds


Maker = Callable[[np.random.Generator, int], Image]


def _makers(given: Ingredients, crops: list[Crop]) -> dict[str, Maker | None]:
    """What makes the n-th image of a kind; None where there is nothing to make it of."""
    measured = given.measured
    everything = list(enumerate(measured.seen))
    seen = [(i, one) for i, one in everything if not one.labelled and len(one.trusted)]
    labelled = [(i, one) for i, one in everything if one.labelled]
    of_view = [
        (view, [crop for crop in crops if crop.view == v])
        for v, view in enumerate(measured.set_up.views)
    ]
    views = [(view, mine) for view, mine in of_view if mine]

    def real(images: list[tuple[int, Seen]]) -> Maker:
        def make(rng: np.random.Generator, n: int) -> Image:
            number, one = images[n % len(images)]
            return known_droplets(one, measured.background_of(number), given.canvas.scale)

        return make

    def pasted(rng: np.random.Generator, n: int) -> Image:
        view, mine = views[n % len(views)]
        if rng.random() < EMPTY:
            return view.background, np.zeros((0, 4))
        image, boxes = paste(rng, view, mine)
        return image, taught(boxes, given.canvas.scale)

    def drawn(rng: np.random.Generator, n: int) -> Image:
        image, boxes = given.draw_own(rng)
        return image, taught(boxes, given.canvas.scale)

    def known(rng: np.random.Generator, n: int) -> Image:
        image, boxes = given.draw_known(rng)
        return _window(rng, image, boxes, given.canvas.network)

    return {
        "seen": real(seen) if seen else None,
        "labelled": real(labelled) if labelled else None,
        "pasted": pasted if views and not measured.set_up.dense else None,
        "drawn": drawn,
        "known": known,
    }


def known_droplets(one: Seen, background: Pixels, scale: float) -> Image:
    """A real image with labels at its droplets, and the background over what may be one."""
    image = painted_over(pixels_of(one, background.shape[2]), one.doubtful, background)
    return image, taught(one.trusted, scale)


def taught(boxes: Floats, scale: float) -> Floats:
    """Those of the boxes (N, 4) px whose droplets have a size that networks learn."""
    size, smaller = np.sqrt(boxes[:, 2:].prod(axis=1)) * scale, boxes[:, 2:].min(axis=1) * scale
    keep = (size > SIZES_PX[0]) & (size < SIZES_PX[1]) & (smaller > MIN_SIDE_PX)
    return np.asarray(boxes[keep])


def _window(
    rng: np.random.Generator, image: Pixels, boxes: Floats, network: tuple[int, int]
) -> Image:
    """A window of an image, as large as a network's input, at a random scale.

    What the image lacks of it continues its edge. Of boxes that the window cuts, the part in it
    counts; those of which little is left do not.
    """
    low, high = np.log(KNOWN_SCALE)
    scale = float(np.exp(rng.uniform(low, high)))
    size = np.array(network, float)
    room = np.array(image.shape[1::-1]) * scale - size
    start = rng.uniform(np.minimum(room, 0), np.maximum(room, 0))
    matrix = np.array([[scale, 0, -start[0]], [0, scale, -start[1]]])
    matrix[:, 2] += 0.5 * scale - 0.5  # a pixel's centre is at c + 0.5, OpenCV counts from it
    part = np.asarray(cv2.warpAffine(image, matrix, network, borderMode=cv2.BORDER_REPLICATE))
    moved = boxes * scale - [*start, 0, 0]
    low_corner = np.clip(moved[:, :2] - moved[:, 2:] / 2, 0, size)
    high_corner = np.clip(moved[:, :2] + moved[:, 2:] / 2, 0, size)
    sides = high_corner - low_corner
    kept = sides.prod(axis=1) > 0.3 * moved[:, 2:].prod(axis=1)
    cut = np.column_stack([(low_corner + high_corner) / 2, sides])[kept]
    return part.astype(np.uint8), taught(cut, 1.0)
