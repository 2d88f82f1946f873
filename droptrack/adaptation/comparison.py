"""Whether an adaptation helped: two networks on frames that it did not use."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np

from droptrack.adaptation.footage import LabelledShot, Shot
from droptrack.adaptation.looking import Looks, seen_once
from droptrack.adaptation.trust import track
from droptrack.data.detections import Detections, iou_matrix
from droptrack.data.report import Value
from droptrack.evaluation.average_precision import average_precision

AGREE_IOU = 0.5
MIN_COUNT = 0.7  # share of the droplets an image before, of which fewer is a loss
# how much a measure has to change to count as better (its sign) or worse
MARGINS = {
    "agreement_percent": 0.5,
    "droplets_seen_once_percent": -0.5,
    "frames_bridged_percent": -0.2,
    "mean_track_frames": 0.5,
    "average_precision_50_percent": 0.2,
}


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What a network does on images, NaN where that cannot be said.

    `mean_track_frames`: how long tracks are; `droplets_seen_once_percent`: tracks of one frame, of
    all tracks; `frames_bridged_percent`: of all frames of the tracks, those in which the droplet
    was missed; `agreement_percent`: of the droplets seen at one scale or another, those seen at
    both. `average_precision_50_percent`: against labels.
    """

    n_images: int
    droplets_per_image: float
    n_tracks: int
    mean_track_frames: float
    droplets_seen_once_percent: float
    frames_bridged_percent: float
    agreement_percent: float
    average_precision_50_percent: float


def quality(
    looks: Looks,
    shots: Sequence[Shot],
    labelled: Sequence[LabelledShot],
    score: float,
    *,
    tracked: bool,
) -> Quality:
    """The quality of a network on images kept back, with a minimum score of a droplet."""
    by_scale = [
        [_above(seen_once(looks, shot, which), score) for shot in shots]
        for which in range(len(looks.detectors))
    ]
    found = by_scale[0]
    lengths, n_bridged = np.zeros(0), 0
    if tracked:
        numbered = zip((shot.number for shot in shots), found, strict=True)
        rows = track(numbered, n_init=1)
        lengths = np.unique(rows.track_id[rows.observed], return_counts=True)[1].astype(float)
        n_bridged = int((~rows.observed).sum())
    return Quality(
        n_images=len(shots),
        droplets_per_image=float(np.mean([len(one) for one in found])),
        n_tracks=len(lengths),
        mean_track_frames=float(lengths.mean()) if len(lengths) else np.nan,
        droplets_seen_once_percent=_percent((lengths == 1).sum(), len(lengths)),
        frames_bridged_percent=_percent(n_bridged, n_bridged + lengths.sum()),
        agreement_percent=_agreement(by_scale),
        average_precision_50_percent=_precision(looks, labelled),
    )


def _above(found: Detections, score: float) -> Detections:
    return found[np.flatnonzero(found.scores >= score)]


def _percent(part: float, whole: float) -> float:
    return 100 * float(part) / float(whole) if whole else np.nan


def _agreement(by_scale: Sequence[Sequence[Detections]]) -> float:
    """Twice the droplets seen at the first scale and another one, of those seen at each, %."""
    both, all_ = 0, 0
    for others in by_scale[1:]:
        for one, other in zip(by_scale[0], others, strict=True):
            both += 2 * n_alike(one, other)
            all_ += len(one) + len(other)
    return _percent(both, all_)


def n_alike(one: Detections, other: Detections) -> int:
    """How many droplets two sets of detections have in common: boxes that are each other's best."""
    if not len(one) or not len(other):
        return 0
    iou = iou_matrix(one.boxes, other.boxes)
    best = iou.argmax(axis=1)
    mine = np.arange(len(one))
    return int(((iou.argmax(axis=0)[best] == mine) & (iou[mine, best] >= AGREE_IOU)).sum())


def _precision(looks: Looks, labelled: Sequence[LabelledShot]) -> float:
    if not labelled:
        return np.nan
    pairs = [(seen_once(looks, one.shot), one.truth) for one in labelled]
    return 100 * average_precision(pairs).average_precision


def verdict(before: Quality, after: Quality) -> tuple[bool, str]:
    """Whether the new network is better, and why.

    Against labels, where some were kept back; else where more measures are better than worse. One
    that finds far fewer droplets is not.
    """
    old, new = asdict(before), asdict(after)
    names = list(MARGINS)
    if not np.isnan(new["average_precision_50_percent"]):
        names = ["average_precision_50_percent"]
    better, worse = [], []
    for name in names:
        margin = MARGINS[name]
        change = (new[name] - old[name]) * np.sign(margin)
        if np.isnan(old[name]) and not np.isnan(new[name]):
            continue
        if change >= abs(margin):
            better.append(name)
        elif change <= -abs(margin):
            worse.append(name)
    if not np.isnan(old["droplets_per_image"]):
        few = new["droplets_per_image"] < MIN_COUNT * old["droplets_per_image"]
        if few and names != ["average_precision_50_percent"]:
            return False, "far fewer droplets are found"
    if len(better) > len(worse):
        return True, "better: " + ", ".join(_words(name) for name in better)
    if worse:
        return False, "worse: " + ", ".join(_words(name) for name in worse)
    return False, "no measure got better"


def _words(name: str) -> str:
    return name.removesuffix("_percent").replace("_", " ")


def table(before: Quality, after: Quality) -> list[dict[str, Value]]:
    """One row a measure, before and after."""
    old, new = asdict(before), asdict(after)
    return [
        {"measure": field.name, "before": old[field.name], "after": new[field.name]}
        for field in fields(Quality)
    ]
