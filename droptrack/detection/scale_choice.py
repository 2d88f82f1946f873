"""The scale that suits a video, chosen from some of its frames; or two, or one for each image.

The best scale is the one whose detections have the most evidence (`scale_evidence`); each counts by
its diameter, and what is much smaller than most has to be seen more surely, since cells and dirt
are no droplets. Where droplets are of so many sizes that no scale shows all, there are two, one for
the smaller and one for the larger ones.
"""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from droptrack.data.arrays import Floats
from droptrack.data.frames import Frame
from droptrack.detection.detector import Detector
from droptrack.detection.pyramid import Sizes
from droptrack.detection.scale import DIAMETER_PX
from droptrack.detection.scale_evidence import (
    DOUBT,
    MARGIN_PX,
    MAX_AREA_PX,
    SURE,
    Seen,
    look_for_droplets,
)

SMALL = 0.4  # of most droplets' diameter, below which that evidence is
SMALL_DOUBT = 0.65
CLEAR = 0.6  # evidence that one droplet at least has to have: dust and digits have less
MOST = 2 / 3  # of the frames that have one of that; otherwise one has to have
SURELY = 0.9
MIN_QUALITY = 0.7  # of a scale that is chosen by it: real videos' mostly have 0.85 and more
MIN_CUT = 0.2  # weight of evidence that a scale's tiles show, but do not show whole
TOLERANCE = 0.06  # between the qualities of scales that are as good
FINER = 0.15  # the same, where droplets are of many sizes: their 90th percentile is more than
SPREAD = 2.5  # times their 10th
ENOUGH = 0.96  # quality of the best scale, and share of the clear droplets, as one shows them all
MANY = 20  # clear droplets, from which on there may be two scales otherwise
WIDE = 4.5  # of the largest 5 % of them, or FEW, to the smallest 5 %, where there are
FEW = 5
MIDDLE_PX = 64.0  # of the input, that half of the clear droplets have at most at the finer scale
ALONE_PX = 150.0  # of that input; where the large ones have no more, one scale is enough
LARGE_PX = 110.0  # up to which it is for; that the large ones have at the coarser scale
TOO_LARGE_PX = 240.0  # of an input: the network has learned to be silent about it
UNSURE_PX = 180.0  # of an input, from which on it is less and less sure
PLENTY_PX = DIAMETER_PX  # of nine in ten clear droplets, which need no finer input
SMALLEST_PX = 16.0  # of the coarser input, from which on it is for, where all scales are in doubt
DIFFER = 1.8  # ratio of typical diameters, from which on images get a scale each


@dataclass(frozen=True)
class ScaleChoice:
    """A scale, and how much of the evidence its detections have: `quality` at each scale tried.

    None where no droplet is clear, and the scale is the default one. `diameters` (N,) px of the
    frames: sqrt(w h) of the droplets seen at several scales. `levels`: where one scale is too few,
    the sizes that each is for, the smallest first; `scale` is what one alone would be. `differ`:
    whether the frames' droplets are of different sizes, as in images of different lenses.
    """

    scale: float
    quality: dict[float, float] = field(default_factory=dict)
    diameters: Floats = field(default_factory=lambda: np.zeros(0))
    levels: tuple[tuple[Sizes, float], ...] = ()
    differ: bool = False


def choose_scale(frames: Iterable[Frame], detector: Detector, default: float) -> ScaleChoice:
    """The best scale for frames (H, W, 3) of one size; the default where nothing is clear.

    `detector`: on inputs of TILE x TILE px, without a canvas, with a threshold of MIN_SCORE. Of
    neighbouring scales as good as the best, within TOLERANCE, it is the finest, which draws tighter
    boxes and finds smaller droplets, but none finer than the coarsest with PLENTY_PX for these; or
    the one that suits most of the clear droplets, if these are of many sizes, and it is finer and
    about as good. Where detections of all scales are in doubt, it is that one, if half of the
    frames have any.
    """
    seen = [look_for_droplets(frame, detector, default) for frame in frames]
    clear = [one.diameters[one.evidence >= CLEAR] for one in seen]
    surest = max((float(one.evidence.max(initial=0)) for one in seen), default=0.0)
    if surest < (CLEAR if _share(clear) >= MOST else SURELY):
        return ScaleChoice(default)
    diameters = np.concatenate([one.diameters[one.evidence > DOUBT] for one in seen])
    quality = _qualities(seen, SMALL * typical_diameter(diameters))
    scale = _one_scale(quality, seen, clear)
    if scale is None:
        return ScaleChoice(default)
    levels: tuple[tuple[Sizes, float], ...] = ()
    if max(quality.values()) < ENOUGH or _shown(seen, scale) < ENOUGH:
        levels = _two_levels(np.concatenate(clear), seen[0].size)
    if not levels and max(quality.values()) < MIN_QUALITY:
        levels = _levels_in_doubt(scale, np.concatenate(clear))
    return ScaleChoice(scale, quality, diameters, levels, _differ(seen))


def _one_scale(
    quality: dict[float, float], seen: Sequence[Seen], clear: Sequence[Floats]
) -> float | None:
    """The best of the scales, as `choose_scale` says; None where frames are in doubt.

    `clear`: the diameters of each frame's clear droplets.
    """
    small, middle, large = np.quantile(np.concatenate(clear), [0.1, 0.5, 0.9]).tolist()
    wanted = DIAMETER_PX / middle
    suiting = min(quality, key=lambda scale: abs(math.log(scale / wanted)))
    if max(quality.values()) < MIN_QUALITY:
        return suiting if _share(clear) >= 0.5 else None
    whole = [scale for scale in quality if all(one.looks[scale].is_whole for one in seen)]
    sure = {k: value for k, value in quality.items() if k * large <= UNSURE_PX}
    if max(sure.values(), default=0.0) < max(quality.values()) - TOLERANCE:
        sure = quality
    scale = _finest_of_the_best(sure, whole, PLENTY_PX / small)
    as_good = quality[suiting] >= max(quality.values()) - FINER
    if large > SPREAD * small and suiting > scale and as_good:
        return suiting  # the largest droplets count most for the quality
    return scale


def _share(clear: Sequence[Floats]) -> float:
    """The share of the frames that have a clear droplet."""
    return sum(len(one) > 0 for one in clear) / max(1, len(clear))


def _shown(seen: Sequence[Seen], scale: float) -> float:
    """The share of the clear droplets that a user would get at a scale, of those in its tiles.

    What is too large there counts wherever it is.
    """
    n_there = n_shown = 0
    for one in seen:
        nearest = min(one.looks, key=lambda tried: abs(math.log(tried / scale)))
        there = one.looks[nearest].covers(one.boxes, one.size, MARGIN_PX / nearest)
        there |= one.diameters * nearest > TOO_LARGE_PX
        there &= one.evidence >= CLEAR
        n_there += int(there.sum())
        n_shown += int((one.scores[list(one.looks).index(nearest)][there] >= SURE).sum())
    return n_shown / max(1, n_there)


def _two_levels(clear: Floats, size: tuple[int, int]) -> tuple[tuple[Sizes, float], ...]:
    """Two scales for clear droplets of diameters (N,) px, if one is too few for these.

    `size`: width and height of the frames, px.

    >>> _two_levels(np.repeat([20.0, 80.0, 200.0], 20), (1200, 600))
    ((Sizes(smallest=0.0, largest=137.5), 0.8), (Sizes(smallest=137.5, largest=inf), 0.55))
    >>> _two_levels(np.repeat([40.0, 80.0, 120.0], 20), (1200, 600))
    ()
    """
    if len(clear) < MANY:
        return ()
    small, middle, large = np.quantile(clear, [0.05, 0.5, 0.95]).tolist()
    large = max(large, float(np.sort(clear)[-FEW]))  # of a thousand, few large ones count as well
    fine = min(MIDDLE_PX / middle, math.sqrt(MAX_AREA_PX / math.prod(size)))
    if large < WIDE * small or large * fine <= ALONE_PX:
        return ()
    limit = LARGE_PX / fine
    return (Sizes(0.0, limit), fine), (Sizes(limit, math.inf), LARGE_PX / large)


def _levels_in_doubt(fine: float, clear: Floats) -> tuple[tuple[Sizes, float], ...]:
    """Two scales, the finer one given, for clear droplets of diameters (N,) px of many sizes.

    >>> _levels_in_doubt(2.5, np.repeat([10.0, 16.0, 32.0], 20))
    ((Sizes(smallest=0.0, largest=12.8), 2.5), (Sizes(smallest=12.8, largest=inf), 1.25))
    >>> _levels_in_doubt(2.5, np.repeat([14.0, 16.0, 32.0], 20))
    ()
    """
    small, large = np.quantile(clear, [0.1, 0.9]).tolist()
    if len(clear) < MANY or large < SPREAD * small or DIAMETER_PX / large >= fine:
        return ()
    coarse = DIAMETER_PX / large
    limit = SMALLEST_PX / coarse
    return (Sizes(0.0, limit), fine), (Sizes(limit, math.inf), coarse)


def _differ(seen: Sequence[Seen]) -> bool:
    """Whether what most of the area is of differs so much between frames that no scale suits.

    Not where fewer than half of the frames have a droplet that is surely one.
    """
    typical = [
        typical_diameter(one.diameters[one.evidence >= CLEAR])
        for one in seen
        if one.evidence.max(initial=0) >= SURELY
    ]
    if 2 * len(typical) < len(seen):
        return False
    low, high = np.quantile(typical, [0.1, 0.9])
    return bool(high > DIFFER * low)


def _qualities(seen: Sequence[Seen], tiny: float) -> dict[float, float]:
    """How much of the evidence of frames the detections of each scale have, up to 1.

    `tiny`: px, below which a droplet takes more evidence.
    """
    gained: dict[float, float] = {}
    possible: dict[float, float] = {}
    there: dict[float, float] = {}  # whole, or cut by the tiles' edges
    for one in seen:
        worth = one.evidence - np.where(one.diameters < tiny, SMALL_DOUBT, DOUBT)
        worth *= one.diameters
        for k, (scale, look) in enumerate(one.looks.items()):
            counted = look.covers(one.boxes, one.size, MARGIN_PX / scale)
            sure = counted & (one.scores[k] >= SURE)
            gained[scale] = gained.get(scale, 0.0) + float(worth[sure].sum())
            real = counted & (worth > 0)
            possible[scale] = possible.get(scale, 0.0) + float(worth[real].sum())
            cut = look.reaches(one.boxes) & (worth > 0)
            there[scale] = there.get(scale, 0.0) + float(worth[real | cut].sum())
    return {
        scale: gained[scale] / ((1 - MIN_CUT) * possible[scale] + MIN_CUT * there[scale] or 1.0)
        for scale in gained
    }


def _finest_of_the_best(
    quality: dict[float, float], whole: Collection[float], plenty: float = math.inf
) -> float:
    """The finest of the best scale and its neighbours that are as good: for small droplets, too.

    Of those of at least `plenty` it is the coarsest: there the small ones are large enough.
    Where it is not `whole`, but looked at in some tiles only, half of the way to it, or the best if
    that is coarser: such inputs are large, and take long.

    >>> quality = {0.5: 0.98, 0.7: 0.6, 1.0: 0.98, 1.4: 0.99, 2.0: 0.98, 2.8: 0.98}
    >>> _finest_of_the_best(quality, quality), _finest_of_the_best(quality, [0.5])
    (2.8, 1.4)
    >>> _finest_of_the_best({1.0: 1.0, 1.4: 0.98, 2.0: 0.98}, [])
    1.0
    >>> _finest_of_the_best(quality, quality, plenty=1.2)
    1.4
    """
    scales = list(quality)
    good = [quality[scale] >= max(quality.values()) - TOLERANCE for scale in scales]
    best = max(range(len(scales)), key=lambda k: (quality[scales[k]], k))
    first = best
    while first > 0 and good[first - 1]:
        first -= 1
    last = best
    while last < len(scales) - 1 and good[last + 1]:
        last += 1
    while last > first and scales[last - 1] >= plenty:
        last -= 1
    return scales[last if scales[last] in whole else min(best, first + (last - first) // 2)]


def typical_diameter(diameters: Floats) -> float:
    """The diameter up to which half of the area of all is; 0 of none.

    >>> typical_diameter(np.array([1.0, 1, 1, 1, 10, 10, 30]))
    30.0
    """
    ordered = np.sort(diameters)
    areas = np.cumsum(ordered**2)
    return float(ordered[np.searchsorted(areas, areas[-1] / 2)]) if len(ordered) else 0.0
