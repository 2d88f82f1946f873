"""Cells in droplets beside a Poisson distribution: by hand, and drawn at random."""

import math

import numpy as np
import pytest

from droptrack.pipeline.encapsulation import Cells, compared, most_likely_mean

EMPTY, ONE, TWO, MORE = Cells(0), Cells(1), Cells(2), Cells(2, is_open=True)


def test_without_an_open_class_the_mean_is_that_of_what_was_counted() -> None:
    """20 cells in 100 droplets; 100 e^-0.2 (1, 0.2, 0.02) are expected."""
    found = compared([TWO, EMPTY, ONE], [2, 82, 16])
    assert found["cells_per_droplet"] == pytest.approx(0.2)
    assert found["cells_observed"] == ["0 82", "1 16", "2 2"]
    assert found["cells_expected"] == ["0 81.9", "1 16.4", "2 1.6"]
    assert math.isnan(float(str(found["poisson_p"])))  # 1.6 are too few for chi-square


def test_empty_and_not_empty_give_the_mean_by_the_share_of_the_empty() -> None:
    """Exp(-m) = 1/4; two classes leave nothing to compare."""
    found = compared([EMPTY, Cells(1, is_open=True)], [250, 750])
    assert found["cells_per_droplet"] == pytest.approx(np.log(4))
    assert math.isnan(float(str(found["poisson_p"])))


def test_classes_of_as_many_cells_count_together_and_others_not_at_all() -> None:
    found = compared([EMPTY, ONE, ONE, None], [5, 2, 3, 40])
    assert found["cells_observed"] == ["0 5", "1 5"]
    assert found["cells_per_droplet"] == pytest.approx(0.5)


def test_where_nothing_tells_a_mean_there_is_none() -> None:
    assert math.isnan(most_likely_mean([EMPTY, MORE], np.array([0, 0])))
    assert math.isnan(most_likely_mean([EMPTY, MORE], np.array([0, 9])))
    assert most_likely_mean([EMPTY, ONE, MORE], np.array([9, 0, 0])) == 0


def test_the_mean_is_found_where_several_cells_are_one_class_and_p_is_what_chance_makes() -> None:
    """2,000 experiments of 400 droplets with 0.8 cells on average: 5 % have p below 0.05."""
    rng = np.random.default_rng(4)
    means, ps = [], []
    for _ in range(2000):
        numbers = np.minimum(rng.poisson(0.8, 400), 2)
        found = compared([EMPTY, ONE, MORE], np.bincount(numbers, minlength=3).tolist())
        means.append(float(str(found["cells_per_droplet"])))
        ps.append(float(str(found["poisson_p"])))
    assert np.mean(means) == pytest.approx(0.8, abs=0.004)
    assert np.mean(np.array(ps) < 0.05) == pytest.approx(0.05, abs=0.015)
    assert np.mean(ps) == pytest.approx(0.5, abs=0.03)


def test_cells_that_stick_together_are_no_poisson_distribution() -> None:
    """As many cells, always two together."""
    found = compared([EMPTY, ONE, MORE], [300, 5, 95])
    assert float(str(found["poisson_p"])) < 1e-6
