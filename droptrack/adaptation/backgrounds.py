"""What is behind the droplets: a median over time of each pixel, where no droplet covers it."""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from droptrack.adaptation.trust import Seen
from droptrack.data.arrays import Bools, Floats, Pixels
from droptrack.data.frames import grey_plane
from droptrack.data.samples import spread
from droptrack.data.set_up import outline_distance, part_of

MAX_STACKED = 40  # images that a median is taken over
MARGIN = 0.06  # of a box's size, around it, that its droplet may reach
MARGIN_PX = 3.0
THUMBNAIL = 48  # px, the sides of what images are compared by
ALIKE = 12.0  # grey levels: the typical difference of images of one view
ROWS_AT_ONCE = 64
MIN_KNOWN = 0.35  # share of the pixels, of a background that has details
SMOOTH_SHARE = 8  # of an image's side, over which others vary
FILL_PX = 4  # what no image shows is filled at so many times fewer px


def channels_of(seen: Seen) -> int:
    """1 where an image is grey, else 3."""
    return 3 if grey_plane(seen.shot.frame) is None else 1


def pixels_of(seen: Seen, channels: int) -> Pixels:
    """An image as (H, W, C), with 1 or 3 channels."""
    frame = seen.shot.frame
    if channels == 3:
        return frame
    plane = grey_plane(frame)
    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if plane is None else plane
    return np.asarray(grey, np.uint8)[..., None]


def views_of(seen: Sequence[Seen], *, related: bool) -> list[list[int]]:
    """Which images show the same view: groups of their places in the list.

    Images of one view differ by the droplets only, so that most of their pixels are alike: half
    of them where the images are `related`, frames of a video, else three quarters.
    """
    if len(seen) < 2:
        return [list(range(len(seen)))]
    size = (THUMBNAIL, THUMBNAIL)
    small = [
        cv2.resize(one.shot.frame.mean(axis=2, dtype=np.float32), size, None, 0, 0, cv2.INTER_AREA)
        for one in seen
    ]
    flat = np.stack(small).reshape(len(seen), -1)
    percent = 50 if related else 75
    apart = [
        np.percentile(np.abs(flat[i] - flat[i + 1 :]), percent, axis=1) for i in range(len(flat))
    ]
    condensed = np.concatenate(apart)
    groups = fcluster(linkage(condensed, "average"), ALIKE, "distance")
    return [np.flatnonzero(groups == group).tolist() for group in np.unique(groups)]


def background(seen: Sequence[Seen], channels: int) -> Pixels:
    """The background (H, W, C) of images of one view; what no image shows is filled from around."""
    chosen = [seen[place] for place in spread(len(seen), MAX_STACKED)]
    images = [pixels_of(one, channels) for one in chosen]
    hidden = np.stack(
        [mask_of(image.shape[:2], one) for image, one in zip(images, chosen, strict=True)]
    )
    height, width = images[0].shape[:2]
    found = np.zeros((height, width, channels), np.uint8)
    known = np.zeros((height, width), bool)
    for top in range(0, height, ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        stack = np.stack([image[rows] for image in images]).astype(np.int16)
        stack[hidden[:, rows]] = np.iinfo(np.int16).max
        n = (~hidden[:, rows]).sum(axis=0)
        stack.sort(axis=0)
        middle = np.maximum(n - 1, 0) // 2
        picked = np.take_along_axis(stack, middle[None, ..., None], axis=0)[0]
        found[rows] = np.where(n[..., None] > 0, picked, 0)
        known[rows] = n > 0
    return _filled(found, known)


def mask_of(shape: tuple[int, ...], seen: Seen) -> Bools:
    """Where (H, W) droplets, or what may be one, cover an image."""
    return covered_by(np.concatenate([seen.trusted, seen.doubtful]), (shape[1], shape[0]))


def covered_by(boxes: Floats, size: tuple[int, int]) -> Bools:
    """Where (H, W) an image of a size is covered by droplets in boxes (N, 4), rims included."""
    mask = np.zeros(size[::-1], bool)
    for box in boxes:
        wider = box * [1, 1, 1 + 2 * MARGIN, 1 + 2 * MARGIN] + [0, 0, 2 * MARGIN_PX, 2 * MARGIN_PX]
        rows, columns, x, y = part_of(wider, size)
        mask[rows, columns] |= outline_distance(wider, 1.0, x, y) < 0
    return mask


def _filled(image: Pixels, known: Bools) -> Pixels:
    """An image whose unknown pixels continue those around them.

    Where hardly any are known, as between droplets that fill the image, all of it becomes smooth.
    """
    if known.all():
        return image
    if not known.any():
        return np.full_like(image, 128)
    if known.mean() < MIN_KNOWN:
        return _smooth(image, known)
    height, width = known.shape
    small = (max(1, width // FILL_PX), max(1, height // FILL_PX))
    weight = cv2.resize(known.astype(np.float32), small, None, 0, 0, cv2.INTER_AREA)
    filled = image.copy()
    for channel in range(image.shape[2]):
        levels = np.where(known, image[..., channel], 0).astype(np.float32)
        mean = cv2.resize(levels, small, None, 0, 0, cv2.INTER_AREA) / np.maximum(weight, 1e-3)
        holes = (weight < 0.25).astype(np.uint8)
        whole = cv2.inpaint(np.clip(mean, 0, 255).astype(np.uint8), holes, 3, cv2.INPAINT_TELEA)
        large = cv2.resize(whole, (width, height), None, 0, 0, cv2.INTER_LINEAR)
        filled[..., channel] = np.where(known, image[..., channel], large)
    return filled


def _smooth(image: Pixels, known: Bools) -> Pixels:
    """What the known pixels have in common, slowly varying."""
    sigma = max(known.shape) / SMOOTH_SHARE
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma)
    smooth = np.empty_like(image)
    for channel in range(image.shape[2]):
        levels = np.where(known, image[..., channel], 0).astype(np.float32)
        mean = cv2.GaussianBlur(levels, (0, 0), sigma) / np.maximum(weight, 1e-6)
        smooth[..., channel] = np.clip(np.round(mean), 0, 255)
    return smooth


def painted_over(image: Pixels, boxes: Floats, background: Pixels) -> Pixels:
    """An image (H, W, C) with the background instead of what is in some boxes (N, 4)."""
    if not len(boxes):
        return image
    mask = covered_by(boxes, (image.shape[1], image.shape[0])).astype(np.float32)
    soft = cv2.GaussianBlur(mask, (0, 0), 2.0)[..., None]
    mixed = image * (1 - soft) + background * soft
    return np.asarray(np.round(mixed), np.uint8)
