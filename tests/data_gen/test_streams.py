"""Droplets in a channel wider than they are: within its walls, apart, of about one size."""

import numpy as np
import pytest

from data_gen.scenes import streams
from data_gen.scenes.channels import Channel
from data_gen.scenes.outlines import SHAPE


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 0.4])
def test_a_tapering_channel_is_as_wide_as_its_formula_says(angle: float) -> None:
    """80 px at the middle, 0.1 px wider a px along it: 100 px after 200 px, 70 px before 100."""
    middle = np.array([600.0, 300.0])
    channel = Channel(centre=middle, angle=angle, width=80, widening=0.1)
    distance = channel.distance()
    for along, half in ((0, 40), (200, 50), (-100, 35)):
        for side in (-1, 1):
            x, y = middle + along * channel.along + side * half * channel.across
            assert distance[int(y), int(x)] == pytest.approx(0, abs=1.5)
        x, y = middle + along * channel.along
        assert distance[int(y), int(x)] == pytest.approx(-half, abs=1.5)


@pytest.mark.parametrize("seed", range(12))
def test_droplets_lie_within_the_walls_and_apart(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Channel] = []
    monkeypatch.setattr(
        streams, "draw_walls", lambda canvas, layers, *_: drawn.extend(layers[0][:1])
    )
    rng = np.random.default_rng(seed)
    droplets = list(streams.stream(rng, np.zeros(SHAPE, np.float32)))
    walls = drawn[0].distance()
    centres = np.array([one.centre for one in droplets]).reshape(-1, 2)
    radii = np.array([one.radius for one in droplets])
    for one in droplets:
        wall = walls[one.patch.rows, one.patch.columns][one.distance < -0.3 * one.radius]
        assert wall.max(initial=-1) < 1  # a long one may reach a little further with its ends
    if len(droplets) > 1:
        assert radii.max() <= 3.2 * radii.min()
        gaps = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
        np.fill_diagonal(gaps, np.inf)
        assert np.median(gaps.min(axis=1)) > 1.5 * np.median(radii)


def test_every_way_to_lie_there_is_drawn() -> None:
    """In one file, all are on a line; elsewhere they are not."""
    straight = []
    for seed in range(60):
        found = list(streams.stream(np.random.default_rng(seed), np.zeros(SHAPE, np.float32)))
        if len(found) > 5:
            centres = np.array([one.centre for one in found])
            off = np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)[1]
            straight.append(off / np.sqrt(len(found)) < 0.3 * found[0].radius)
    assert 0.2 < np.mean(straight) < 0.8
