"""What droplets look like: grey levels against the distance from the outline, sizes, noise."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from droptrack.adaptation.backgrounds import background, channels_of, pixels_of, views_of
from droptrack.adaptation.trust import Seen, Trust
from droptrack.data.arrays import Float32s, Floats, Pixels
from droptrack.data.detections import iou_matrix
from droptrack.data.set_up import ELLIPSE, Profile, SetUp, View, outline_distance, part_of

STEP = 0.5  # px, of the distances
OUTSIDE = 6.0  # px from the outline, as far as a droplet changes what is around it
MAX_DEPTH = 60.0  # px inside, beyond which nothing changes
MIN_DROPLETS = 3  # that show a distance
MAX_MEASURED = 150  # droplets
SHAPES = (ELLIPSE, 1.0, 0.75, 0.5)  # see Profile.corners
MIN_OWN = 8  # droplets of a view that has a profile of its own
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
    groups = [
        without_structures([group[place] for place in places])
        for group, related in ((list(trust.seen), trust.by_tracks), (list(labelled), False))
        for places in views_of(group, related=related)
        if places
    ]
    channels = min(channels_of(one) for group in groups for one in group)  # all have as many
    behind = [background(group, channels) for group in groups]
    common = _profile(
        [one for group, image in zip(groups, behind, strict=True) for one in _parts(group, image)]
    )
    views = []
    for group, image in zip(groups, behind, strict=True):
        parts = _parts(group, image)
        profile = _profile(parts) if len(parts) >= MIN_OWN else common
        frames = tuple(one.trusted for one in group)
        views.append(View(background=image, frames=frames, profile=profile))
    ordered = [one for group in groups for one in group]
    whole = [np.zeros((0, 4)), *(one.trusted[one.whole] for one in ordered)]
    set_up = SetUp(
        views=tuple(views),
        noise=_noise(ordered, related=trust.by_tracks),
        dense=_is_dense(ordered),
    )
    return Measured(
        set_up=set_up,
        seen=tuple(ordered),
        view_of=tuple(v for v, group in enumerate(groups) for _ in group),
        diameters=np.sqrt(np.concatenate(whole)[:, 2:].prod(axis=1)),
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


@dataclass(frozen=True, kw_only=True)
class _Part:
    """A droplet: box (4,), pixels at x (W,), y (H,) around it, and how they change (H, W, C)."""

    box: Floats
    x: Float32s
    y: Float32s
    change: Float32s


def _parts(seen: Sequence[Seen], behind: Pixels) -> list[_Part]:
    """Up to MAX_MEASURED of the droplets of a view; those that no edge cuts, if there are any."""
    any_whole = any(one.whole.any() for one in seen)
    droplets = [
        (one, box) for one in seen for box in one.trusted[one.whole if any_whole else slice(None)]
    ]
    height, width = behind.shape[:2]
    parts = []
    for one, box in droplets[:: max(1, len(droplets) // MAX_MEASURED)]:
        rows, columns, x, y = part_of(box, (width, height), OUTSIDE)
        pixels = pixels_of(one, behind.shape[2])[rows, columns].astype(np.float32)
        parts.append(_Part(box=box, x=x, y=y, change=pixels - behind[rows, columns]))
    return parts


def _profile(parts: Sequence[_Part]) -> Profile:
    """Grey levels of droplets, for the shape that they follow best.

    That is the one of which the distance from the outline explains most of their variance.
    """
    best, most = None, -np.inf
    for corners in SHAPES:
        profile, explained = _levels(parts, corners)
        if best is None or explained > most + CLEARLY:
            best, most = profile, explained
    assert best is not None
    return best


def _levels(parts: Sequence[_Part], corners: float) -> tuple[Profile, float]:
    """The typical change of grey level at distances from droplets of a shape.

    Of each droplet, the mean at a distance; of all droplets, the median. It ends with nothing where
    the change does. Also the share of the changes' variance that the distance explains.
    """
    depth = min(MAX_DEPTH, max(float(one.box[2:].min()) / 2 for one in parts))
    n_inside = int(np.ceil(depth / STEP))
    edges = np.arange(-n_inside, round(OUTSIDE / STEP) + 1) * STEP
    n, channels = len(edges) - 1, parts[0].change.shape[2]
    means = np.full((len(parts), n, channels), np.nan)
    explained = np.zeros(len(parts))
    for i, one in enumerate(parts):
        distance = outline_distance(one.box, corners, one.x, one.y)
        place = np.floor((distance - edges[0]) / STEP).astype(int).ravel()
        inside = (place >= 0) & (place < n)
        place = place[inside]
        count = np.bincount(place, minlength=n)
        between = within = 0.0
        for channel in range(channels):
            values = one.change[..., channel].ravel()[inside]
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
    profile = Profile(distances=distances, levels=levels, corners=corners)
    return profile, float(np.median(explained))


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
