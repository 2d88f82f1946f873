"""What one would pick instead of droptrack does what its name says, on drawings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.reproduction.classical import Method, best_setting, threshold, trackpy_locate, watershed
from bench.reproduction.evaluation import only_counted
from bench.reproduction.linking import Found, Linker, link_with_norfair, link_with_trackpy, rows_of
from bench.reproduction.simulations import Clip
from bench.reproduction.tracking import Watched
from data_gen.scenes.shapes import WHITE, draw_ellipses
from droptrack.data.arrays import Pixels
from droptrack.data.trajectories import read_trajectories

CENTRES = np.array([[60.25, 50.5], [120.0, 90.75], [200.5, 40.0]])
RADIUS = 15.0


def drawn(centres: np.ndarray, radius: float = RADIUS) -> Pixels:
    canvas = np.zeros((140, 260), np.uint8)
    n = len(centres)
    discs = np.column_stack([centres, np.full((n, 2), radius), np.zeros(n)])
    draw_ellipses(canvas, discs, WHITE)
    return canvas


def in_order(found: Found) -> np.ndarray:
    return found.centres[np.argsort(found.centres[:, 0])]


@pytest.mark.parametrize("find", [threshold, lambda image, blur: watershed(image, blur, 0.7)])
def test_regions_have_the_discs_centres_and_sizes(find: object) -> None:
    found = find(drawn(CENTRES), 0)  # type: ignore[operator]
    assert in_order(found) == pytest.approx(CENTRES, abs=0.05)
    assert found.sizes == pytest.approx(2 * RADIUS, abs=2)


def test_a_region_at_the_images_edge_is_left_out() -> None:
    image = drawn(np.vstack([CENTRES, [[255.0, 100.0]]]))
    assert len(threshold(image, 0).centres) == 3


def test_a_watershed_parts_discs_that_touch_where_a_threshold_does_not() -> None:
    touching = np.array([[100.0, 70.0], [127.0, 70.0]])
    image = drawn(touching)
    assert len(threshold(image, 0).centres) == 1
    assert in_order(watershed(image, 0, 0.7)) == pytest.approx(touching, abs=1.5)


def test_trackpy_finds_the_discs() -> None:
    pytest.importorskip("trackpy")
    found = trackpy_locate(drawn(CENTRES), 31, 0)
    near = np.hypot(*(found.centres[:, None] - CENTRES[None]).T).min(axis=1)
    assert near.max() < 1


def test_the_setting_that_finds_most_is_taken() -> None:
    frames = [(0, drawn(CENTRES)), (1, drawn(CENTRES))]
    truth = rows_of([(number, Found(CENTRES, np.full((3, 2), 30.0))) for number in (0, 1)])
    nothing = Method("nothing", lambda _: Found(np.zeros((0, 2)), np.zeros((0, 2))))
    good = Method("good", lambda image: threshold(image, 0))
    double = Method("double", lambda image: Found(np.vstack([CENTRES] * 2), np.full((6, 2), 30.0)))
    assert best_setting([nothing, double, good], frames, truth).setting == "good"


LINKERS = [("trackpy", link_with_trackpy), ("norfair", link_with_norfair)]


@pytest.mark.parametrize(("package", "link"), LINKERS)
def test_linkers_keep_identities_and_leave_no_droplet_out(package: str, link: Linker) -> None:
    pytest.importorskip(package)
    frames = []
    for number in range(8):
        centres = CENTRES + np.array([3.0 * number, 0])
        if number == 4:
            centres = centres[1:]  # the first is not found once
        order = np.random.default_rng(number).permutation(len(centres))
        frames.append((number, Found(centres[order], np.full((len(centres), 2), 30.0))))
    rows = link(frames, 30.0)
    assert len(rows) == 8 * 3 - 1
    assert len(np.unique(rows.track_id)) == 3
    for track_id in np.unique(rows.track_id):
        assert np.ptp(rows.y[rows.track_id == track_id]) == 0


@pytest.mark.parametrize(("package", "link"), LINKERS)
def test_nothing_found_gives_no_rows(package: str, link: Linker) -> None:
    pytest.importorskip(package)
    none = Found(np.zeros((0, 2)), np.zeros((0, 2)))
    assert len(link([(0, none), (1, none)], 30.0)) == 0


def test_what_need_not_be_found_is_neither_missed_nor_false(sine: Path) -> None:
    every, _ = read_trajectories(sine / "truth.csv")
    cut = every.track_id == 3
    truth = replace(every, scores=np.where(cut, 0.0, 1.0))
    for found in (every, every[~cut]):
        counted_truth, counted = only_counted(truth, found)
        assert 3 not in counted_truth.track_id
        assert len(counted_truth) == len(counted) == int((~cut).sum())


def test_our_detections_of_the_test_video_are_its_droplets(sine: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sine"
    folder.symlink_to(sine)
    watched = Watched(Clip("sine", degraded=False, folder=folder))
    found, seconds = watched.detections
    assert [number for number, _ in found] == list(range(40))
    assert seconds > 0
    whole = watched.truth.scores > 0
    for number in (0, 39):
        truth = watched.truth[whole & (watched.truth.frame == number)]
        places = np.column_stack([truth.x, truth.y])
        apart = np.hypot(*(places[:, None] - found[number][1].centres[None]).T)
        assert apart.min(axis=0).max() < 0.1
