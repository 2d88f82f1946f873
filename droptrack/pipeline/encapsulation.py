"""Cells in droplets: their numbers beside those of a Poisson distribution.

Cells that get into droplets independently of one another are Poisson distributed (Collins et al.,
Lab Chip 15, 3439, 2015): a share exp(-m) m^k / k! of the droplets has k of them, m on average.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.data.report import Value
from droptrack.errors import DroptrackError

CELLS = re.compile(r"(\d{1,3})(\+?)")
NOT_COUNTED = "-"
MIN_EXPECTED = 5  # droplets of each number of cells, below which chi-square says nothing
MEANS = (1e-9, 1e4)  # among which the most likely one is sought


@dataclass(frozen=True, order=True)
class Cells:
    """How many cells a droplet of a class has, or at least, where it is open."""

    number: int
    is_open: bool = False

    def __str__(self) -> str:
        return f"{self.number}+" if self.is_open else str(self.number)


def parse_cells(text: str, n_classes: int) -> tuple[Cells | None, ...]:
    """How many cells each class has, as in ``0,1,2+``; None where it is not to count.

    Raises DroptrackError for what does not say so of each of the classes, or says it twice over.

    >>> [str(cells) for cells in parse_cells("0,1,2+,-", 4)]
    ['0', '1', '2+', 'None']
    """
    parts = [part.strip() for part in text.split(",")]
    matches = [CELLS.fullmatch(part) for part in parts]
    if len(parts) != n_classes or not all(
        match or part == NOT_COUNTED for match, part in zip(matches, parts, strict=True)
    ):
        raise DroptrackError(
            f"--cells {text}: should say how many cells droplets of each of the {n_classes} "
            "classes have, such as 0,1,2+; - where a class does not count"
        )
    found = tuple(Cells(int(one[1]), bool(one[2])) if one else None for one in matches)
    counted = sorted({one for one in found if one is not None})
    if len(counted) < 2:
        raise DroptrackError(f"--cells {text}: two classes at least should have other numbers")
    if any(one.is_open and one != counted[-1] for one in counted) or (
        len({one.number for one in counted}) < len(counted)
    ):
        raise DroptrackError(f"--cells {text}: only the largest number may be open, once")
    return found


def compared(cells: Sequence[Cells | None], counts: Sequence[int]) -> dict[str, Value]:
    """Droplets with each number of cells, of `counts` of each class, beside a Poisson distribution.

    `cells_per_droplet` is its mean, the most likely one for these counts; p is the chance that
    chance alone makes them differ so much or more (chi-square), NaN where fewer than MIN_EXPECTED
    droplets are expected of a number, or nothing is left to compare.

    >>> found = compared([Cells(0), Cells(1), Cells(2, is_open=True)], [90, 9, 1])
    >>> found["cells_expected"], round(found["cells_per_droplet"], 3)
    (['0 89.5', '1 9.9', '2+ 0.6'], 0.11)
    """
    kinds = sorted({one for one in cells if one is not None})
    numbers = np.array(
        [sum(n for one, n in zip(cells, counts, strict=True) if one == kind) for kind in kinds]
    )
    mean = most_likely_mean(kinds, numbers)
    expected = numbers.sum() * shares(kinds, mean)
    beyond = numbers.sum() - expected.sum()  # of numbers that no class has
    said: dict[str, Value] = {
        "cells_per_droplet": mean,
        "cells_observed": [f"{kind} {n}" for kind, n in zip(kinds, numbers, strict=True)],
        "cells_expected": [f"{kind} {n:.1f}" for kind, n in zip(kinds, expected, strict=True)],
    }
    freedom = len(kinds) - 2 + (beyond > MIN_EXPECTED)
    p = math.nan
    if freedom > 0 and expected.min() >= MIN_EXPECTED:
        from scipy.stats import chi2  # takes longer to import than all of a short run

        square = ((numbers - expected) ** 2 / expected).sum()
        square += beyond if beyond > MIN_EXPECTED else 0.0
        p = float(chi2.sf(square, freedom))
    return {**said, "poisson_p": p}


def shares(kinds: Sequence[Cells], mean: float) -> Floats:
    """The share of droplets with each number of cells, in a Poisson distribution of a mean."""
    from scipy.stats import poisson

    return np.array(
        [
            poisson.sf(one.number - 1, mean) if one.is_open else poisson.pmf(one.number, mean)
            for one in kinds
        ]
    )


def most_likely_mean(kinds: Sequence[Cells], numbers: Rows) -> float:
    """The mean of the Poisson distribution under which the numbers of droplets are most likely.

    NaN without any droplet, and where all of them are in the open class. Without an open class it
    is the mean of what was counted.
    """
    cells = np.array([one.number for one in kinds])
    is_open = np.array([one.is_open for one in kinds])
    n_exact, n_cells = numbers[~is_open].sum(), (numbers * cells)[~is_open].sum()
    n_open, least = numbers[is_open].sum(), int(cells[-1])
    if not n_exact:
        return math.nan
    if not n_open:
        return float(n_cells / n_exact)
    from scipy.optimize import brentq
    from scipy.stats import poisson

    def slope(mean: float) -> float:
        """Of the likelihood's logarithm."""
        rise = poisson.pmf(least - 1, mean) / poisson.sf(least - 1, mean)
        return float(n_cells / mean - n_exact + n_open * rise)

    return float(brentq(slope, *MEANS))
