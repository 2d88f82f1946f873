"""The tracker made for droplets: DeepSORT's skeleton, its constants in diameters and frames.

Each frame: predict all tracks (`motion`), those whose velocity is not known by the flow around them
(`flow`); weigh each track against the detections near its prediction; assign all at once; start
tracks for what is left. A droplet lost for some frames is looked for again from both ends.
"""

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from droptrack.data.arrays import Floats, Rows
from droptrack.tracking import motion_filter as motion
from droptrack.tracking import neighbour_velocity as flow
from droptrack.tracking.association import assign_sparse, take_in_turn
from droptrack.tracking.droplet_noise import FEWEST_FALSE, Noise, median
from droptrack.tracking.droplet_tracks import new_tracks
from droptrack.tracking.motion_filter import squares
from droptrack.tracking.tracker import Update

CANDIDATES = 8  # detections that a track is weighed against
MISS_COST = 15.0  # -2 log likelihood of a miss and FEWEST_FALSE false ones a squared diameter
ENOUGH_EVIDENCE = 25.0  # 2 log likelihood ratio that makes a droplet
JUMP = 0.3  # diameters, standard deviation where a box is wrong,
JUMP_FROM = 12.0  # squared standard deviations
JUMP_COST = 9.0  # which happens to one in a hundred: -2 log 0.01
WRONG_SIZE = 0.3  # standard deviation of the logarithm of width and height of a wrong box
ANY_SIZE = 0.4  # the same of boxes that are not the droplet's
SIZE_GAIN = 0.2  # of a new size in a track's mean size,
AREA_GAIN = 0.02  # and in its mean area over a long time
LEAST_SPREAD = 0.08  # diameters; no prediction is surer
JOIN_GATE = 11.8  # chi-square of two degrees of freedom, 99.7 %
HALF_COVERED = 0.4  # share of a box, from which it may be a second one of the droplet it lies on
TWO_HALVES = 1.5  # areas of two boxes of one droplet, in areas of its box before
SECOND_BOX_FRAMES = 15  # after which it is a droplet of its own
LEAST_RATE = 0.6  # detections a frame of a new track


@dataclass(frozen=True)
class DropletParameters:
    """Lengths are in droplet diameters, times in frames. The switches are there to be measured."""

    max_step: float = 2.5  # how far a droplet may move in the first frame it is followed
    unknown_step: float = 0.5  # standard deviation of the first step where there is no flow
    noise: float = 0.04  # standard deviation of a box's centre, at first; it is learned
    acceleration: float = 0.05  # standard deviation, at first; it is learned
    size_noise: float = 0.15  # of the logarithm of width and height, at first; it is learned
    max_age: int = 20  # frames that a droplet may be missed
    short_gap: int = 6  # of them, those after which one detection is enough to find it again
    n_init: int = 3  # detections that make a droplet
    appearance: float = 0.0  # cost of a cosine distance of one
    flow: bool = True  # velocities that are not known are those of the neighbours
    size: bool = True  # sizes count
    jointly: bool = True  # one assignment of all; else each pair in turn, the best first
    both_ways: bool = True  # lost droplets are joined to new ones looking from both ends
    learn_noise: bool = True
    second_boxes: bool = True  # a new box on a droplet that has one waits


class DropletTracker:
    """Follows droplets; call `update` with each frame's detections, also when there are none."""

    def __init__(self, parameters: DropletParameters) -> None:
        self.parameters = parameters
        self.noise = Noise(parameters.noise, parameters.acceleration, parameters.size_noise)
        self.tracks = new_tracks(np.zeros((0, 4)), np.zeros((0, 0)), 1)
        self._next_id = 1

    @property
    def max_age(self) -> int:
        """Frames that a droplet may be missed and still be the same."""
        return self.parameters.max_age

    @property
    def n_init(self) -> int:
        """Detections that make a droplet."""
        return self.parameters.n_init

    @property
    def delay(self) -> int:
        """Frames until a new droplet is known to be one."""
        return SECOND_BOX_FRAMES + 1

    def update(self, boxes: Floats, descriptors: Floats) -> Update:
        """Go one frame on with its boxes (M, 4) and their unit descriptors (M, D)."""
        if len(boxes) != len(descriptors):
            raise ValueError(f"{len(boxes)} boxes with {len(descriptors)} descriptors")
        looks = descriptors if self.parameters.appearance else np.zeros((len(boxes), 0))
        if not len(self.tracks.ids):
            self.tracks = new_tracks(boxes[:0], looks[:0], self._next_id)
        diameters = self.tracks.diameters
        self._predict(boxes, diameters)
        rows, columns, evidence = self._match(boxes, looks, diameters)
        self.tracks.evidence[rows] += evidence
        track_ids = np.zeros(len(boxes), np.int64)
        track_ids[columns] = self.tracks.ids[rows]
        free = np.flatnonzero(track_ids == 0)
        seconds = self._second_boxes(boxes, rows, columns, free)
        self._correct(rows, boxes[columns], looks[columns], diameters)
        track_ids[free] = self._start(boxes[free], looks[free], seconds)
        joined = self._join()
        confirmed = self._confirm()
        for young, old in joined:
            track_ids[track_ids == young] = old
        ended = self._drop_lost()
        return Update(track_ids, confirmed, ended, joined)

    def _predict(self, boxes: Floats, diameters: Floats) -> None:
        """All tracks one frame on, those of unknown velocity with the flow."""
        tracks = self.tracks
        if self.parameters.flow:
            self._take_flow(boxes, diameters)
        tracks.state = motion.predict(tracks.state, self.noise.acceleration * diameters)
        tracks.missed += 1
        tracks.frames += 1

    def _take_flow(self, boxes: Floats, diameters: Floats) -> None:
        """Learn from the flow how new tracks move, and those that are lost."""
        tracks = self.tracks
        new, seen = tracks.hits == 1, tracks.missed == 0
        if seen.all() and not new.any():
            return
        places, velocity, covariance = vars(tracks.state).values()
        unknown, lost = np.flatnonzero(new), np.flatnonzero(~seen & ~new)
        both = np.concatenate([unknown, lost])
        known = (tracks.hits >= 3) & seen
        mean, variance = flow.velocity_of_neighbours(
            places[both], diameters[both], places[known], velocity[known]
        )
        k = len(unknown)
        told = np.isfinite(variance[:k])
        rows = unknown[told]
        velocity[rows] = mean[:k][told]
        covariance[rows, 2] = variance[:k][told] + (0.15 * diameters[rows]) ** 2
        rest = unknown[~told & seen[unknown]]
        step, share = flow.displacement_of_pattern(
            places[seen],
            diameters[seen],
            np.searchsorted(np.flatnonzero(seen), rest),
            boxes[:, :2],
            self.parameters.max_step,
        )
        sure = rest[share > 0.5]
        velocity[sure] = step[share > 0.5]
        covariance[sure, 2] = (0.2 * diameters[sure]) ** 2
        # the flow is one more measurement of the velocity of those that are lost
        told = np.isfinite(variance[k:])
        rows = lost[told]
        noise = variance[k:][told] + (0.1 * diameters[rows]) ** 2
        gain = covariance[rows, 2] / (covariance[rows, 2] + noise)
        velocity[rows] += gain[:, None] * (mean[k:][told] - velocity[rows])
        covariance[rows, 2] *= 1 - gain
        covariance[rows, 1] *= 1 - gain

    def _match(
        self, boxes: Floats, descriptors: Floats, diameters: Floats
    ) -> tuple[Rows, Rows, Floats]:
        """Rows of tracks, rising, and detections that belong together, and the evidence for it."""
        tracks, p = self.tracks, self.parameters
        none = np.zeros(0, np.int64)
        if not len(tracks.ids) or not len(boxes):
            return none, none, np.zeros(0)
        spread = self._spread(diameters) / diameters**2
        wide = spread + JUMP**2
        rarity, rarity_wrong = 2 * np.log(2 * np.pi * spread), 2 * np.log(2 * np.pi * wide)
        narrow, broad = self.noise.size**2, self.noise.size**2 + WRONG_SIZE**2
        same_size, wrong_size = (
            (2 * log(narrow / ANY_SIZE**2), 2 * log(broad / ANY_SIZE**2)) if p.size else (0.0, 0.0)
        )
        most = MISS_COST - 2 * log(self.noise.false_density / FEWEST_FALSE)
        # what is further away costs more than `most`, whatever its size and its looks
        square = np.maximum(
            spread * (most - rarity - same_size),
            wide * (most - rarity_wrong - JUMP_COST - wrong_size),
        )
        reach = np.minimum(p.max_step, np.sqrt(np.maximum(square, 0)) * (1 + 1e-9)) * diameters
        recent = tracks.missed <= (p.short_gap + 1 if p.both_ways else p.max_age)
        rows, columns, distance = flow.nearest_within(
            tracks.state.position, np.where(recent, reach, -1), boxes[:, :2], CANDIDATES
        )
        square = (distance / diameters[rows]) ** 2
        cost = square / spread[rows] + rarity[rows]
        wrong = square / wide[rows] + rarity_wrong[rows] + JUMP_COST
        if p.size:
            change = squares(np.log(boxes[:, 2:])[columns] - tracks.log_sizes[rows])
            cost += change / narrow + same_size
            wrong += change / broad + wrong_size
        cost = np.minimum(cost, wrong) + np.minimum(tracks.missed[rows] - 1, 10) * 0.5
        if p.appearance:
            likeness = (tracks.looks[rows] * descriptors[columns]).sum(axis=1)
            cost += p.appearance * (1 - likeness)
        good = cost < most
        choose = assign_sparse if p.jointly else take_in_turn
        rows, columns, cost = rows[good], columns[good], cost[good]
        chosen, taken = choose(rows, columns, cost, most)
        if len(chosen) == len(rows):  # there was no choice
            return rows, columns, most - cost
        pairs, wanted = rows * len(boxes) + columns, np.sort(chosen * len(boxes) + taken)
        order = np.argsort(pairs)
        at = order[np.searchsorted(pairs, wanted, sorter=order)]
        return rows[at], columns[at], most - cost[at]

    def _spread(self, diameters: Floats) -> Floats:
        """Variance (N,) px² of a detection about its prediction."""
        spread = self.tracks.state.covariance[:, 0] + (self.noise.centre * diameters) ** 2
        return np.asarray(np.maximum(spread, (LEAST_SPREAD * diameters) ** 2))

    def _correct(self, seen: Rows, boxes: Floats, descriptors: Floats, diameters: Floats) -> None:
        """Take in the detections of some tracks, rising; `diameters` (N,) are those of all."""
        tracks = self.tracks
        rows = slice(None) if len(seen) == len(tracks.ids) else seen  # takes less time
        mine = diameters[rows]
        innovation = (boxes[:, :2] - tracks.state.position[rows]) / mine[:, None]
        change = np.log(boxes[:, 2:]) - tracks.log_sizes[rows]
        if self.parameters.learn_noise:
            self._learn(rows, innovation, change, mine)
        spread = self._spread(diameters)[rows] / mine**2  # with what has just been learned
        jumped = squares(innovation) > JUMP_FROM * spread
        expected = tracks.state[rows]
        corrected = motion.update(expected, boxes[:, :2], self.noise.centre * mine)
        if jumped.any():
            corrected[jumped] = motion.jump(expected[jumped], boxes[jumped, :2])
        tracks.state[rows] = corrected
        tracks.innovation[rows] = innovation
        tracks.hits[rows] += 1
        tracks.missed[rows] = 0
        tracks.seen[rows] = boxes[:, :2]
        share = 1 / tracks.hits[rows]
        gain = np.maximum(SIZE_GAIN, share)[:, None]
        tracks.log_sizes[rows] += gain * change
        area = np.log(boxes[:, 2] * boxes[:, 3])
        slow = np.maximum(AREA_GAIN, share)
        tracks.log_area[rows] += slow * (area - tracks.log_area[rows])
        if self.parameters.appearance:
            looks = (1 - gain) * tracks.looks[rows] + gain * descriptors
            tracks.looks[rows] = looks / np.linalg.norm(looks, axis=1, keepdims=True)

    def _learn(
        self, rows: Rows | slice, innovation: Floats, change: Floats, diameters: Floats
    ) -> None:
        """Learn the noise from the tracks that have been seen for some frames without a gap."""
        tracks = self.tracks
        steady = (tracks.hits[rows] >= 4) & (tracks.missed[rows] == 1)
        if steady.sum() < 3:
            return
        before = tracks.innovation[rows][steady]
        variance = tracks.state.covariance[rows, 0][steady] / diameters[steady] ** 2
        self.noise.learn(innovation[steady], before, variance, change[steady])

    def _start(self, boxes: Floats, descriptors: Floats, seconds: Rows) -> Rows:
        """Start a track for each of the F detections that have none; returns their identities.

        `seconds` (F,): the tracks on whose droplets the boxes lie.
        """
        if not len(boxes):
            return seconds
        born = new_tracks(boxes, descriptors, self._next_id)
        d = born.diameters
        born.state.covariance[:, 0] = (self.noise.centre * d) ** 2
        born.state.covariance[:, 2] = (self.parameters.unknown_step * d) ** 2
        born.second_of[:] = seconds
        self._next_id += len(boxes)
        self.tracks = self.tracks.and_these(born)
        return born.ids

    def _second_boxes(self, boxes: Floats, rows: Rows, columns: Rows, free: Rows) -> Rows:
        """The droplet (F,) on which each box lies that was given to no track, 0 where none.

        Either it covers the place where a droplet was expected, or it lies beside the box that a
        droplet was given and both are together no larger than it was: half a droplet.
        """
        tracks = self.tracks
        none = np.zeros(len(free), np.int64)
        if not len(free) or not self.parameters.second_boxes:
            return none
        sure = np.flatnonzero(tracks.confirmed & (tracks.missed <= self.parameters.short_gap + 1))
        if not len(sure):
            return none
        k = min(4, len(sure))
        _, near = flow.nearest(cKDTree(tracks.state.position[sure]), boxes[free, :2], k)
        near = sure[near]  # (F, k)
        box, place = boxes[free][:, None], tracks.state.position[near]
        size = np.exp(tracks.log_sizes[near])
        low = np.maximum(place - size / 2, box[..., :2] - box[..., 2:] / 2)
        high = np.minimum(place + size / 2, box[..., :2] + box[..., 2:] / 2)
        overlap = np.prod(np.maximum(high - low, 0), axis=2)
        area, area_before = box[..., 2:].prod(axis=2), np.exp(tracks.log_area[near])
        covers = overlap > HALF_COVERED * np.minimum(size.prod(axis=2), area)
        given = np.full((len(tracks.ids), 4), np.inf)
        given[rows] = boxes[columns]
        other = given[near]
        beside = np.hypot(*np.moveaxis(other[..., :2] - box[..., :2], 2, 0)) < np.sqrt(area_before)
        half = beside & (other[..., 2:].prod(axis=2) + area < TWO_HALVES * area_before)
        lies = covers | half
        owner = tracks.ids[near[np.arange(len(free)), lies.argmax(axis=1)]]
        return np.where(lies.any(axis=1), owner, 0)

    def _ripe(self) -> NDArray[np.bool_]:
        """New tracks (N,) that have been seen often enough, in this frame too."""
        t = self.tracks
        often = (t.hits >= self.parameters.n_init) & (t.hits >= LEAST_RATE * t.frames)
        often &= t.evidence >= ENOUGH_EVIDENCE
        return np.asarray(~t.confirmed & (t.missed == 0) & often)

    def _join(self) -> tuple[tuple[int, int], ...]:
        """Give new tracks the identities of the lost ones that they continue."""
        if not self.parameters.both_ways:
            return ()
        tracks = self.tracks
        lost = tracks.confirmed & (tracks.missed > 0)
        if not lost.any():
            return ()
        ripe = self._ripe() & (tracks.second_of == 0)
        second = ~tracks.confirmed & (tracks.missed == 0) & (tracks.second_of > 0)
        if not (ripe | second).any():
            return ()
        pairs: list[tuple[int, int]] = []
        # the other box of a droplet that had two is the one that is left
        for new in np.flatnonzero(second).tolist():
            match = np.flatnonzero(lost & (tracks.ids == tracks.second_of[new]))
            if len(match):
                pairs.append((new, int(match[0])))
                lost[match[0]] = False
        pairs += self._meet(np.flatnonzero(ripe), np.flatnonzero(lost))
        if not pairs:
            return ()
        joined = tuple((int(tracks.ids[n]), int(tracks.ids[o])) for n, o in pairs)
        rows = np.array(pairs)
        tracks.ids[rows[:, 0]] = tracks.ids[rows[:, 1]]
        tracks.confirmed[rows[:, 0]] = True
        tracks.second_of[rows[:, 0]] = 0
        tracks.hits[rows[:, 0]] += tracks.hits[rows[:, 1]]
        self.tracks = tracks[np.delete(np.arange(len(tracks.ids)), rows[:, 1])]
        return joined

    def _meet(self, young: Rows, lost: Rows) -> list[tuple[int, int]]:
        """Pairs of new and lost tracks that meet, seen from both ends of the gap.

        With constant acceleration, a droplet goes its gap at the mean of the velocities at both
        ends; white acceleration leaves a variance of gap³ / 12, a fourth of that seen from one.
        """
        if not len(young) or not len(lost):
            return []
        tracks, p = self.tracks, self.parameters
        k = min(CANDIDATES, len(lost))
        places = tracks.state.position
        _, near = flow.nearest(cKDTree(places[lost]), places[young], k)
        new, old = np.repeat(young, k), lost[near.ravel()]
        gap = tracks.missed[old] - tracks.frames[new] + 1
        new, old, gap = new[gap > 0], old[gap > 0], gap[gap > 0]
        velocity = (tracks.state.velocity[new] + tracks.state.velocity[old]) / 2
        off = tracks.first[new] - tracks.seen[old] - gap[:, None] * velocity
        d = tracks.diameters[old]
        ends = (tracks.state.covariance[new, 2] + tracks.state.covariance[old, 2]) / d**2
        spread = (
            self.noise.acceleration**2 * gap**3 / 12 + ends * gap**2 / 4 + 2 * self.noise.centre**2
        )
        spread = np.maximum(spread, LEAST_SPREAD**2)
        square = (off**2).sum(axis=1) / d**2 / spread
        cost = square + 2 * np.log(2 * np.pi * spread)
        if p.size:
            change = (tracks.log_sizes[new] - tracks.log_sizes[old]) / self.noise.size
            cost += (change**2).sum(axis=1) + 4 * np.log(self.noise.size / ANY_SIZE)
        good = (square < JOIN_GATE) & (cost < MISS_COST)
        rows, columns = assign_sparse(new[good], old[good], cost[good], MISS_COST)
        return list(zip(rows.tolist(), columns.tolist(), strict=True))

    def _confirm(self) -> tuple[int, ...]:
        """New tracks that are droplets from now on."""
        tracks = self.tracks
        if tracks.confirmed.all():
            return ()
        rows = np.flatnonzero(self._ripe())
        if not len(rows):
            return ()
        alone = ~np.isin(tracks.second_of[rows], tracks.ids)
        rows = rows[alone | (tracks.frames[rows] >= SECOND_BOX_FRAMES)]
        tracks.confirmed[rows] = True
        return tuple(tracks.ids[rows].tolist())

    def _drop_lost(self) -> tuple[int, ...]:
        """A new track ends with its second miss in a row, a droplet after more than max_age."""
        tracks = self.tracks
        lost = tracks.missed > np.where(tracks.confirmed, self.parameters.max_age, 1)
        lost |= ~tracks.confirmed & (tracks.frames > SECOND_BOX_FRAMES + 1)
        n_false = np.count_nonzero(lost & ~tracks.confirmed)
        if self.parameters.learn_noise and tracks.confirmed.any():
            area = 1.0
            if n_false:
                span = np.ptp(tracks.seen[tracks.confirmed], axis=0)
                area = max(area, float(span.prod()) / median(tracks.diameters) ** 2)
            self.noise.learn_false(n_false / area)
        if not lost.any():
            return ()
        self.tracks = tracks[~lost]
        return tuple(tracks.ids[lost].tolist())
