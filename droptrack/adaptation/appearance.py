"""What droplets look like: grey levels against the distance from the outline, sizes, noise."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from droptrack.adaptation.backgrounds import background, pixels_of, views_of
from droptrack.adaptation.trust import Seen, Trust
from droptrack.data.arrays import Float32s, Floats, Pixels
from droptrack.data.detections import iou_matrix
from droptrack.data.set_up import ELLIPSE, SetUp, View, outline_distance, part_of

STEP = 0.5  # px, of the distances
OUTSIDE = 6.0  # px from the outline, as far as a droplet changes what is around it
MAX_DEPTH = 60.0  # px inside, beyond which nothing changes
MIN_DROPLETS = 3  # that show a distance
MAX_MEASURED = 150  # droplets
SHAPES = (ELLIPSE, 1.0, 0.75, 0.5)  # see SetUp.corners
MIN_VIEW = 4  # images of a view that tell what belongs to it
SAME_PLACE = 0.6  # IoU of what is at the same place in two images
OFTEN = 0.5  # share of the images of a view
CLEARLY = 0.005  # share of the variance by which a shape has to be better than those before it
TOUCHING = 0.25  # share of the droplets that touch two others


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A set-up, and for each image the view that it shows; `diameters` (N,) px of whole droplets.

    `seen` are the images in the order of the views.
    """

    set_up: SetUp
    seen: tuple[Seen, ...]
    view_of: tuple[int, ...]
    diameters: Floats

    def background_of(self, number: int) -> Pixels:
        """What is behind the droplets of an image."""
        return self.set_up.views[self.view_of[number]].background


def measure(trust: Trust, labelled: Sequence[Seen]) -> Measured:
    """The look of droplets that are known, those of a user's labels included."""
    views: list[View] = []
    ordered: list[Seen] = []
    view_of: list[int] = []
    for group, related in ((list(trust.seen), trust.by_tracks), (list(labelled), False)):
        for places in views_of(group, related=related):
            if not places:
                continue
            mine = without_structures([group[place] for place in places])
            ordered += mine
            view_of += [len(views)] * len(mine)
            frames = tuple(one.trusted for one in mine)
            views.append(View(background=background(mine), frames=frames))
    channels = min(view.background.shape[2] for view in views)
    views = [View(background=v.background[..., :channels], frames=v.frames) for v in views]
    distances, profile, corners = _profile(ordered, view_of, views)
    whole = [np.zeros((0, 4)), *(one.trusted[one.whole] for one in ordered)]
    boxes = np.concatenate(whole)
    set_up = SetUp(
        views=tuple(views),
        distances=distances,
        profile=profile,
        corners=corners,
        noise=_noise(ordered, related=trust.by_tracks),
        dense=_is_dense(ordered),
    )
    return Measured(
        set_up=set_up,
        seen=tuple(ordered),
        view_of=tuple(view_of),
        diameters=np.sqrt(boxes[:, 2:].prod(axis=1)),
    )


def without_structures(seen: Sequence[Seen]) -> list[Seen]:
    """Images of one view, in which what is at the same place in most of them is not doubtful.

    It is a part of the view, and no droplet; unless the view is that of too few images.
    """
    if len(seen) < MIN_VIEW:
        return list(seen)
    kept = []
    for one in seen:
        often = np.zeros(len(one.doubtful))
        for other in seen:
            often += (iou_matrix(one.doubtful, other.doubtful) > SAME_PLACE).any(axis=1)
        kept.append(replace(one, doubtful=one.doubtful[often <= OFTEN * len(seen)]))
    return kept


def _profile(
    seen: Sequence[Seen], view_of: Sequence[int], views: Sequence[View]
) -> tuple[Floats, Floats, float]:
    """Distances (K,), grey levels (K, C) there, and the corners of the shape that they follow best.

    The best shape is that along whose outline grey levels vary least, and so across it most.
    """
    any_whole = any(one.whole.any() for one in seen)
    droplets = [
        (one, view, box)
        for one, view in zip(seen, view_of, strict=True)
        for box in one.trusted[one.whole if any_whole else slice(None)]
    ]
    droplets = droplets[:: max(1, len(droplets) // MAX_MEASURED)]
    parts = []
    for one, view, box in droplets:
        height, width = one.shot.frame.shape[:2]
        rows, columns, x, y = part_of(box, (width, height), OUTSIDE)
        behind = views[view].background[rows, columns].astype(np.float32)
        change = pixels_of(one)[rows, columns, : behind.shape[2]] - behind
        parts.append((box, x, y, change))
    best: tuple[float, Floats, Floats, float] | None = None
    for corners in SHAPES:
        distances, levels, explained = _levels(parts, corners)
        if best is None or explained > best[0] + CLEARLY:
            best = (explained, distances, levels, corners)
    assert best is not None
    return best[1], best[2], best[3]


def _levels(
    parts: Sequence[tuple[Floats, Float32s, Float32s, Float32s]], corners: float
) -> tuple[Floats, Floats, float]:
    """Distances (K,) from droplets of a shape, the typical change of grey level (K, C) there.

    Of each droplet (box, x, y, change), the mean at a distance; of all droplets, the median. It
    ends with nothing where the change does. Also the share of the changes' variance that the
    distance explains.
    """
    depth = min(MAX_DEPTH, max(float(box[2:].min()) / 2 for box, *_ in parts))
    n_inside = int(np.ceil(depth / STEP))
    edges = np.arange(-n_inside, round(OUTSIDE / STEP) + 1) * STEP
    n, channels = len(edges) - 1, parts[0][3].shape[2]
    means = np.full((len(parts), n, channels), np.nan)
    explained = np.zeros(len(parts))
    for i, (box, x, y, change) in enumerate(parts):
        distance = outline_distance(box, corners, x, y)
        place = np.floor((distance - edges[0]) / STEP).astype(int).ravel()
        inside = (place >= 0) & (place < n)
        place = place[inside]
        count = np.bincount(place, minlength=n)
        between = within = 0.0
        for channel in range(channels):
            values = change[..., channel].ravel()[inside]
            total = np.bincount(place, values, n)
            means[i, count > 0, channel] = total[count > 0] / count[count > 0]
            rest = values - means[i, place, channel]
            within, between = within + float(rest @ rest), between + len(values) * values.var()
        explained[i] = 1 - within / max(between, 1e-9)
    distances = (edges[:-1] + edges[1:]) / 2
    known = np.isfinite(means[..., 0]).sum(axis=0) >= min(MIN_DROPLETS, len(parts))
    levels = np.zeros((n, channels))
    for channel in range(channels):
        typical = np.nanmedian(means[:, known, channel], axis=0)
        levels[:, channel] = np.interp(distances, distances[known], typical)
    outer = distances > 0
    levels[outer] *= np.clip(1.5 - 1.5 * distances[outer, None] / OUTSIDE, 0, 1)
    levels[-1] = 0
    return distances, levels, float(np.median(explained))


def _noise(seen: Sequence[Seen], *, related: bool) -> float:
    """Standard deviation of the grey levels of one pixel, from neighbours in time or space."""
    if related:
        pairs = [
            (one, two)
            for one, two in itertools.pairwise(seen)
            if two.shot.number == one.shot.number + 1
        ][:8]
        if pairs:
            changes = [
                np.abs(two.shot.frame.astype(np.int16) - one.shot.frame).ravel()[::7]
                for one, two in pairs
            ]
            return _deviation(np.concatenate(changes)) / math.sqrt(2)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # Immerkaer 1996
    changes = [
        np.abs(cv2.filter2D(one.shot.frame.mean(axis=2, dtype=np.float32), -1, kernel)).ravel()[::7]
        for one in seen[:8]
    ]
    return _deviation(np.concatenate(changes)) / 6


def _deviation(changes: Floats) -> float:
    """The standard deviation of noise from its absolute values.

    By the mean of the smaller half, 0.3247 of them; a median of whole numbers is coarse.
    """
    lower = np.sort(changes)[: max(1, len(changes) // 2)]
    return float(lower.mean()) / 0.3247


def _is_dense(seen: Sequence[Seen]) -> bool:
    """Whether droplets press on one another in most images."""
    shares = []
    for one in seen:
        if len(one.trusted) < MIN_DROPLETS:
            continue
        radii = np.sqrt(one.trusted[:, 2:].prod(axis=1)) / 2
        apart = np.hypot(*(one.trusted[:, None, :2] - one.trusted[None, :, :2]).transpose(2, 0, 1))
        near = apart < 1.12 * (radii[:, None] + radii[None])
        shares.append(((near.sum(axis=1) - 1) >= 2).mean())
    return bool(shares) and float(np.median(shares)) > TOUCHING
