"""How far each ray may go, told by all together; and outlines that only then are the droplets'."""

from itertools import product

import numpy as np
import pytest

from droptrack.data.arrays import Floats, Pixels, Rows
from droptrack.data.frames import grey_frame
from droptrack.measurement import closed_paths
from droptrack.measurement.droplets import measure_droplets
from droptrack.measurement.rays import N_RAYS
from droptrack.measurement.shapes import DIAMETER

LENGTH, WIDTH = 120.0, 40.0  # of a plug, px


def cost_of(path: Rows, costs: Rows, change: int) -> int:
    """What a way along costs (K, R) costs, that goes around as often as it has places."""
    steps = int(np.abs(np.diff(path)).sum())
    return change * steps + sum(int(costs[k % len(costs), at]) for k, at in enumerate(path))


@pytest.mark.parametrize("seed", range(20))
def test_no_other_way_around_is_cheaper(seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 10, (4, 3))
    change = int(rng.integers(0, 8))
    every = product(range(3), repeat=8)
    least = min(cost_of(np.array(path), costs, change) for path in every)
    assert cost_of(closed_paths._find_path(costs, change), costs, change) == least
    if (loops := closed_paths.load_loops()) is not None:
        path = np.empty(8, np.int64)
        loops._find_path(costs, change, path)
        np.testing.assert_array_equal(path, closed_paths._find_path(costs, change))


def slanted(angle: float, *, wall: float, rim: float) -> tuple[Pixels, Floats, float]:
    """A plug with a rim 4 px wide, 6 px from the walls of its channel, levels added to 150.

    Seen under an angle, rad; its box (1, 4), and its diameter px.
    """
    y, x = np.mgrid[:240, :240] + 0.5
    along = np.cos(angle) * (x - 120) + np.sin(angle) * (y - 120)
    across = np.abs(np.cos(angle) * (y - 120) - np.sin(angle) * (x - 120))
    beyond = np.maximum(np.abs(along) - (LENGTH - WIDTH) / 2, 0)
    distance = np.hypot(beyond, across) - WIDTH / 2
    shares = [np.clip(0.5 - one, 0, 1) for one in (distance, distance + 4)]
    at_wall = np.clip(0.5 - (np.abs(across - WIDTH / 2 - 9) - 3), 0, 1)
    levels = 150 + wall * at_wall + rim * (shares[0] - shares[1])
    half = np.abs([np.cos(angle), np.sin(angle)]) * (LENGTH - WIDTH) / 2 + WIDTH / 2
    box = np.array([[120.0, 120, *(2 * half)]])
    area = WIDTH * (LENGTH - WIDTH) + np.pi * WIDTH**2 / 4
    return levels.astype(np.uint8), box, float(np.sqrt(4 * area / np.pi))


@pytest.mark.usefixtures("implementation")
@pytest.mark.parametrize(("rim", "wall"), [(-60, -120), (60, 90)], ids=["dark", "bright"])
@pytest.mark.parametrize("degrees", [0, 30, 45, 60])
def test_a_plug_beside_walls_twice_as_dark_has_its_own_size(
    degrees: float, rim: float, wall: float
) -> None:
    image, box, diameter = slanted(np.radians(degrees), wall=wall, rim=rim)
    rng = np.random.default_rng(int(degrees))
    for _ in range(5):
        off = box + rng.normal(0, 0.03, (1, 4)) * box[:, [2, 3, 2, 3]]
        found = measure_droplets(grey_frame(image), off)
        assert found.shapes[0, DIAMETER] == pytest.approx(diameter, rel=0.01)


@pytest.mark.usefixtures("implementation")
def test_a_path_goes_along_the_droplet_not_along_the_wall() -> None:
    """All of it within a step of the path's radii, a factor of 1.04, of the plug's outline."""
    image, _, _ = slanted(0.0, wall=-120, rim=-60)
    first, last = np.full((2, 1, N_RAYS), [[[8]], [[70]]])
    path = closed_paths.closed_paths(image, np.full((1, 2), 120.0), np.ones(1), first, last)
    across = N_RAYS // 4  # downwards
    assert path[0, across] == pytest.approx(WIDTH / 2, rel=0.06)
    assert path[0, 0] == pytest.approx(LENGTH / 2, rel=0.06)
