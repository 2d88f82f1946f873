"""Who follows whom: headings of neighbours, one of them later.

M. Nagy et al., Nature 464, 890 (2010): the directional correlation C_ij(tau) = <cos(theta_i(t) -
theta_j(t + tau))> of two neighbours; where it is highest at tau > 0, j follows i.
"""

from dataclasses import dataclass

import numpy as np

from droptrack.analysis.flock.headings import Headings
from droptrack.analysis.neighbourhoods import blocks_with_pairs, shuffled, some_frames
from droptrack.data.arrays import Bools, Floats, Rows

MAX_LAG = 20  # frames, to either side
MAX_FRAMES = 1000  # in which neighbours are looked for, evenly over all
MIN_FRAMES = 20  # together, for a pair to be listed
MAX_PAIRS = 20_000  # listed


@dataclass(frozen=True, kw_only=True)
class Following:
    """Correlations over 2 L + 1 lags (2 L + 1,) frames.

    sums, counts, chance (N, 2 L + 1): of each droplet with neighbours ahead of it, which go `lag`
    frames earlier; chance: with others of the frame instead. pairs (P, 2): droplets (of the N), the
    first of which is `best` (P,) frames ahead in time at the highest correlation (P,), `now` (P,)
    is that at lag 0, over n (P,) frames.
    """

    lags: Rows
    sums: Floats
    counts: Floats
    chance: Floats
    chance_counts: Floats
    pairs: Rows
    best: Rows
    highest: Floats
    now: Floats
    n: Rows


def follow(headings: Headings, radius: float, rng: np.random.Generator) -> Following:
    """The correlations of neighbours within `radius` px, and which of each pair follows."""
    later = _Later(headings)
    lags = np.arange(-MAX_LAG, MAX_LAG + 1)
    n, width = headings.n_droplets, len(lags)
    sums, counts = np.zeros((n, width)), np.zeros((n, width))
    chance, chance_counts = np.zeros((n, width)), np.zeros((n, width))
    keys, totals, seen = [], [], []
    chosen = some_frames(headings.frames, MAX_FRAMES)
    some = headings[chosen]
    for block, first, second in blocks_with_pairs(
        some.frames, some.places, radius, "who follows whom"
    ):
        part, rows = some[block], chosen[block]
        random = rows[shuffled(part.frames, rng)]
        behind, ahead = _by_order(part, first, second)
        swap = part.owners[first] > part.owners[second]
        low, high = np.where(swap, second, first), np.where(swap, first, second)
        pair_keys, index = np.unique(part.owners[low] * n + part.owners[high], return_inverse=True)
        total, number = np.zeros((len(pair_keys), width)), np.zeros((len(pair_keys), width))
        for k, lag in enumerate(lags.tolist()):
            moved = later.angles(rows, lag)
            _add(
                sums[:, k], counts[:, k], part.owners[behind], later.of(rows[ahead]) - moved[behind]
            )
            _add(
                chance[:, k], chance_counts[:, k], part.owners[behind],
                later.of(random[ahead]) - moved[behind],
            )  # fmt: skip
            _add(total[:, k], number[:, k], index, later.of(rows[low]) - moved[high])
        keys.append(pair_keys)
        totals.append(total)
        seen.append(number)
    pairs, best, highest, now, together = _pairs(keys, totals, seen, n)
    return Following(
        lags=lags, sums=sums, counts=counts, chance=chance, chance_counts=chance_counts,
        pairs=pairs, best=best, highest=highest, now=now, n=together,
    )  # fmt: skip


class _Later:
    """Headings of the same droplets in other frames."""

    def __init__(self, headings: Headings) -> None:
        self._angles = headings.angles
        self._frames = int(headings.frames.max(initial=0)) + 1 + 2 * MAX_LAG
        keys = headings.owners * self._frames + headings.frames + MAX_LAG
        self._order = np.argsort(keys)
        self._keys, self._unsorted = keys[self._order], keys

    def of(self, rows: Rows) -> Floats:
        return np.asarray(self._angles[rows])

    def angles(self, rows: Rows, lag: int) -> Floats:
        """The headings of the droplets of rows, `lag` frames later; NaN where there is none."""
        wanted = self._unsorted[rows] + lag
        at = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        found = self._angles[self._order[at]]
        return np.where(self._keys[at] == wanted, found, np.nan)


def _by_order(part: Headings, first: Rows, second: Rows) -> tuple[Rows, Rows]:
    """Of each pair the one behind and the one ahead, along the sum of their velocities."""
    way = part.velocities[first] + part.velocities[second]
    offset = part.places[second] - part.places[first]
    swap: Bools = (way * offset).sum(axis=1) < 0
    return np.where(swap, second, first), np.where(swap, first, second)


def _add(sums: Floats, counts: Floats, at: Rows, differences: Floats) -> None:
    known = np.isfinite(differences)
    sums += np.bincount(at[known], np.cos(differences[known]), len(sums))
    counts += np.bincount(at[known], minlength=len(sums))


def _pairs(
    keys: list[Rows], totals: list[Floats], seen: list[Floats], n: int
) -> tuple[Rows, Rows, Floats, Floats, Rows]:
    """Pairs that are long enough together, the one that goes first before the other."""
    if not keys:
        none = np.zeros(0)
        return np.zeros((0, 2), np.int64), none.astype(np.int64), none, none, none.astype(np.int64)
    unique, index = np.unique(np.concatenate(keys), return_inverse=True)
    total, number = np.zeros((2, len(unique), 2 * MAX_LAG + 1))
    np.add.at(total, index, np.concatenate(totals))
    np.add.at(number, index, np.concatenate(seen))
    long = np.flatnonzero(number[:, MAX_LAG] >= MIN_FRAMES)
    long = np.sort(long[np.argsort(-number[long, MAX_LAG], kind="stable")][:MAX_PAIRS])
    enough = number[long] >= MIN_FRAMES
    mean = np.where(enough, total[long] / np.maximum(number[long], 1), -np.inf)
    best = mean.argmax(axis=1)
    highest, now = mean[np.arange(len(long)), best], mean[:, MAX_LAG]
    pairs = np.column_stack([unique[long] // n, unique[long] % n])
    lag = best - MAX_LAG
    pairs[lag < 0] = pairs[lag < 0][:, ::-1]
    return pairs, np.abs(lag), highest, now, number[long, MAX_LAG].astype(np.int64)
