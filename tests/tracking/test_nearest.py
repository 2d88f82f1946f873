"""Nearest points, on few that one can count and against loops."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from droptrack.tracking.nearest import nearest, nearest_within


def test_what_is_out_of_reach_has_an_infinite_distance() -> None:
    """Points at 0, 1, 3 and 7; within 2.5 of 1 there are three."""
    tree = cKDTree(np.array([[0.0, 0], [1, 0], [3, 0], [7, 0]]))
    distance, rows = nearest(tree, np.array([[1.0, 0]]), 4, 2.5)
    assert distance.tolist() == [[0, 1, 2, np.inf]]
    assert rows[0, :3].tolist() == [1, 0, 2]


@pytest.mark.parametrize("n", [0, 1, 50, 100])
def test_the_nearest_within_reach_are_those_of_a_loop(n: int) -> None:
    """Few are compared with all, many sought in a tree; every fifth reaches nowhere."""
    rng = np.random.default_rng(n)
    points, others = rng.uniform(0, 200, (60, 2)), rng.uniform(0, 200, (n, 2))
    reach = np.where(np.arange(60) % 5, rng.uniform(0, 60, 60), -1.0)
    expected = []
    for i, (point, limit) in enumerate(zip(points, reach, strict=True)):
        distance = np.hypot(*(others - point).T)
        order = np.argsort(distance)[:4]
        expected += [(i, int(k), distance[k]) for k in order if distance[k] <= limit]
    for scale in (1.0, 0.1):  # with and without more than four in reach
        rows, columns, distance = nearest_within(points, scale * reach, others, 4)
        found = sorted(zip(rows.tolist(), columns.tolist(), distance.tolist(), strict=True))
        wanted = sorted(one for one in expected if one[2] <= scale * reach[one[0]])
        assert [one[:2] for one in found] == [one[:2] for one in wanted]
        np.testing.assert_allclose([one[2] for one in found], [one[2] for one in wanted])
    assert not len(nearest_within(points, np.full(60, -1.0), others, 4)[0])
