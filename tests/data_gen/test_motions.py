"""The benchmark's motions are what their names say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.simulate import app
from data_gen.videos.motion_kinds import HEIGHT, MOTIONS, WIDTH, Kind, Motion
from data_gen.videos.motion_paths import N_STOPPING, move
from data_gen.videos.motions import make
from droptrack.data.mot_files import open_detections
from droptrack.data.trajectories import read_trajectories


@pytest.mark.parametrize("name", MOTIONS)
def test_perfect_detections_are_the_ground_truth(name: str) -> None:
    perfect = replace(MOTIONS[name], missing=0, false=0, jitter=0, images_missing=0)
    motion = replace(perfect, frames=8)
    truth, frames = make(motion, 0)
    for number, found in enumerate(frames):
        mine = truth[truth.frame == number].boxes
        boxes = found.boxes
        np.testing.assert_allclose(
            boxes[np.lexsort(boxes.T[:2])], mine[np.lexsort(mine.T[:2])], rtol=1e-12
        )
        assert (boxes[:, :2] >= boxes[:, 2:] / 2 - 1e-9).all()
        assert (boxes[:, :2] <= [WIDTH, HEIGHT] - boxes[:, 2:] / 2 + 1e-9).all()


def test_a_missing_image_has_no_boxes_and_the_others_all() -> None:
    motion = replace(MOTIONS["train 2 0.2 holes"], missing=0, false=0, jitter=0, frames=60)
    truth, frames = make(motion, 0)
    n_empty = 0
    for number, found in enumerate(frames):
        n = int((truth.frame == number).sum())
        assert len(found) in (0, n)
        n_empty += n > 0 and not len(found)
    assert 10 < n_empty < 30


def steps(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Places and steps per frame, in diameters, of droplets that are seen in frames 0 and 1."""
    truth, _ = make(motion, 3)
    first, second = (truth[truth.frame == t] for t in (0, 1))
    _, i, j = np.intersect1d(first.track_id, second.track_id, return_indices=True)
    place = np.column_stack([first.x, first.y])[i]
    return place, (np.column_stack([second.x, second.y])[j] - place) / motion.diameter


def test_speeds_are_in_diameters_per_frame() -> None:
    _, uniform = steps(Motion(Kind.uniform, speed=1.5, frames=3))
    np.testing.assert_allclose(uniform, np.tile([1.5, 0], (len(uniform), 1)), atol=1e-9)
    place, shear = steps(Motion(Kind.shear, speed=2, frames=3))
    np.testing.assert_allclose(shear[:, 0], 2 * place[:, 1] / HEIGHT, atol=1e-9)
    _, packing = steps(replace(MOTIONS["packing"], frames=3))
    np.testing.assert_allclose(packing, np.tile([0.525, 0], (len(packing), 1)), atol=1e-9)


def path_of(motion: Motion, droplet: int) -> np.ndarray:
    """Places (T, 2) of a droplet in all frames, in diameters."""
    paths, _ = move(np.random.default_rng(0), motion)
    return np.asarray(paths[droplet] / motion.diameter)


def test_a_pulsing_train_nearly_rests_and_a_reversing_one_comes_back() -> None:
    pulsing = np.diff(path_of(replace(MOTIONS["pulsing"], frames=33), 5)[:, 0])
    smallest = 0.55 - 0.45 * np.sinc(1 / 8)  # mean of 0.55 - 0.45 cos over a sixteenth of a period
    assert pulsing.min() == pytest.approx(0.6 * smallest)
    assert pulsing.max() == pytest.approx(0.6, rel=0.05)
    np.testing.assert_allclose(pulsing[:16], pulsing[16:], atol=1e-9)
    reversing = path_of(replace(MOTIONS["reversing"], frames=17), 5)[:, 0]
    assert reversing[16] == pytest.approx(reversing[0])
    assert np.diff(reversing).max() == pytest.approx(0.6, rel=0.05)
    assert np.diff(reversing).min() == pytest.approx(-0.6, rel=0.05)


def test_where_channels_have_merged_droplets_go_twice_as_fast_one_by_one() -> None:
    motion = MOTIONS["joining"]
    truth, _ = make(replace(motion, missing=0, false=0, jitter=0), 0)
    merged = truth[truth.x > 600]
    assert np.ptp(merged.y) == 0
    for frame in range(0, motion.frames, 10):
        x = np.sort(merged.x[merged.frame == frame])
        np.testing.assert_allclose(np.diff(x), 2 * motion.diameter)
    one = path_of(motion, 10)
    step = np.diff(one[:, 0])
    assert step[one[:-1, 0] > 600 / 60].max() == pytest.approx(0.6)
    assert step[one[1:, 0] < 450 / 60].max() == pytest.approx(0.3)


def test_droplets_that_stop_at_a_wall_stay_apart_and_at_rest() -> None:
    motion = MOTIONS["stopping"]
    paths = move(np.random.default_rng(0), motion)[0][-N_STOPPING:] / motion.diameter
    np.testing.assert_allclose(np.diff(paths[:, :10, 0]), 0.5)
    np.testing.assert_allclose(np.diff(paths[:, 30:, 0]), 0)
    np.testing.assert_allclose(-np.diff(paths[:, -1, 0]), 4)


def test_vortices_neither_gain_nor_lose_area() -> None:
    """A droplet's step turns with the stream function sin(kx) sin(ky), which it keeps."""
    truth, _ = make(Motion(Kind.vortices, frames=40), 0)
    k = 2 * np.pi / HEIGHT
    stream = np.sin(k * truth.x) * np.sin(k * truth.y)
    for droplet in np.unique(truth.track_id)[:20]:
        mine = stream[truth.track_id == droplet]
        np.testing.assert_allclose(mine, mine[0], atol=2e-4)


def test_faults_are_as_frequent_and_large_as_asked_for() -> None:
    clean, _ = make(Motion(Kind.vortices, frames=40), 0)
    n = len(clean)
    _, missing = make(Motion(Kind.vortices, frames=40, missing=0.3), 0)
    assert 1 - sum(map(len, missing)) / n == pytest.approx(0.3, abs=0.02)
    _, false = make(Motion(Kind.vortices, frames=40, false=0.2), 0)
    assert sum(map(len, false)) / n - 1 == pytest.approx(0.2, abs=0.02)
    truth, jitter = make(Motion(Kind.vortices, frames=2, jitter=0.1), 0)
    boxes, true = jitter[0].boxes, truth[truth.frame == 0].boxes
    apart = np.hypot(*(boxes[:, None, :2] - true[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
    assert np.sqrt((apart**2).mean() / 2) == pytest.approx(2, rel=0.15)


def test_half_of_the_droplets_grow_and_half_shrink() -> None:
    truth, _ = make(Motion(Kind.growing, speed=0, frames=11), 0)
    first, last = (truth[truth.frame == t] for t in (0, 10))
    _, i, j = np.intersect1d(first.track_id, last.track_id, return_indices=True)
    change = last.boxes[j, 2] / first.boxes[i, 2]
    assert set(change.round(6)) == {0.5, 2.0}
    assert (change > 1).mean() == pytest.approx(0.5, abs=0.1)


def test_the_command_writes_detections_and_ground_truth(tmp_path: Path) -> None:
    options = ["--out", str(tmp_path), "--kind", "channel", "--frames", "5", "--seed", "2"]
    result = CliRunner().invoke(app, ["motions", *options])
    assert result.exit_code == 0, result.output
    truth, about = read_trajectories(tmp_path / "truth.csv")
    frames = [found for found, _ in open_detections(tmp_path / "detections.txt")]
    assert [len(found) for found in frames] == np.bincount(truth.frame).tolist()
    assert "1200 x 600 px" in about["video"]


def test_too_many_droplets_are_refused(tmp_path: Path) -> None:
    options = ["--out", str(tmp_path), "--droplets", "5000"]
    result = CliRunner().invoke(app, ["motions", *options])
    assert result.exit_code == 1
    assert "no room for 5000 droplets" in result.output


@pytest.mark.parametrize("kind", ["merging", "splitting"])
def test_without_a_number_there_are_fifty_events_of_four_droplets(
    kind: str, tmp_path: Path
) -> None:
    result = CliRunner().invoke(app, ["motions", "--out", str(tmp_path), "--kind", kind])
    assert result.exit_code == 0, result.output
    truth, _ = read_trajectories(tmp_path / "truth.csv")
    assert len(np.unique(truth.track_id)) == 200
    result = CliRunner().invoke(
        app, ["motions", "--out", str(tmp_path), "--kind", kind, "--droplets", "204"]
    )
    assert result.exit_code == 1
    assert "at most 200 --droplets" in result.output
