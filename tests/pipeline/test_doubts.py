"""Tracks that do not look like droplets are said to, with the cure; those that do are not."""

import numpy as np

from droptrack.network.bundled import find_network
from droptrack.pipeline.doubts import doubts, mixed_outlines
from droptrack.pipeline.paths import DropletPath

CFG, _ = find_network()


def path(x: float, y: float, *, frames: int = 40, step: float = 2.0) -> DropletPath:
    """A droplet of 20 px that moves `step` px a frame along x."""
    box = [x, y, 20.0, 20.0]
    one = DropletPath(
        first_frame=0, last_frame=frames - 1, first_box=box, last_box=box, n_observed=frames
    )
    one.add(list(range(frames)), [x + step * k for k in range(frames)], [y] * frames)
    one.diameters_px, one.n_diameters = 20.0 * frames, frames
    return one


def test_droplets_that_move_alike_raise_no_doubt() -> None:
    rng = np.random.default_rng(0)
    paths = [path(*rng.uniform(0, 500, 2)) for _ in range(30)]
    assert doubts(paths, 100, CFG, 0.8) == []
    assert doubts([], 100, CFG, 0.8) == []


def test_many_tracks_of_one_frame_are_doubted() -> None:
    rng = np.random.default_rng(0)
    short = [path(*rng.uniform(0, 500, 2), frames=1) for _ in range(30)]
    long = [path(*rng.uniform(0, 500, 2)) for _ in range(12)]
    (doubt,) = doubts([*short, *long], 100, CFG, 0.8)
    assert doubt.startswith("30 of 42 droplets were seen in 2 frames or fewer")
    assert "--scale" in doubt
    assert doubts([*short[:9], *long], 100, CFG, 0.8) == []


def test_boxes_that_stay_while_others_move_are_doubted_but_not_where_all_stay() -> None:
    rng = np.random.default_rng(0)
    still = [path(*rng.uniform(0, 500, 2), step=0.0) for _ in range(3)]
    moving = [path(*rng.uniform(0, 500, 2)) for _ in range(12)]
    (doubt,) = doubts([*still, *moving], 100, CFG, 0.8)
    assert doubt.startswith("3 of 15 droplets stay where they are")
    assert "--region" in doubt
    assert doubts(still, 100, CFG, 0.8) == []


def test_boxes_in_every_cell_of_the_network_are_doubted() -> None:
    """Cells of 16 px of an input half as large as the frame: 32 px of the frame."""
    cells = np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2)
    noise = np.random.default_rng(0).normal(0, 1, cells.shape)
    places = 32 * cells + 11 + noise
    (doubt,) = doubts([path(*place) for place in places.tolist()], 100, CFG, 0.5)
    assert doubt.startswith("droplets lie on a grid of 32 px")
    anywhere = 31 * cells + 11 + noise
    assert doubts([path(*place) for place in anywhere.tolist()], 100, CFG, 0.5) == []


def test_sizes_of_two_kinds_are_doubted() -> None:
    (doubt,) = mixed_outlines(200, 30)
    assert doubt.startswith("30 of 200 sizes are those of rings, measured outside")
    for n_sizes, n_rings in ((200, 0), (200, 200), (200, 3), (200, 197), (19, 9), (0, 0)):
        assert mixed_outlines(n_sizes, n_rings) == []
