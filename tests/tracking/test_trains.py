"""Equal droplets that pass one after the other, few at a time, some in view for a few frames."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.track_scores import only_images, score, track
from data_gen.videos.motion_kinds import MOTIONS, TRAINS, train
from data_gen.videos.motions import make
from droptrack.data.detections import Detections
from droptrack.data.trajectories import Trajectories
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracker import DropletTracker

Floats = NDArray[np.float64]
WIDTH, HEIGHT = 120.0, 60.0  # of a drawn plug, px


def frames_of(centres: Sequence[Sequence[tuple[float, float]]]) -> list[Detections]:
    """Plugs of one size at some centres, frame by frame."""
    found = []
    for places in centres:
        at: Floats = np.array(places, float).reshape(-1, 2)
        boxes = np.hstack([at, np.full((len(at), 2), [WIDTH, HEIGHT])])
        found.append(Detections(boxes, np.ones(len(at)), np.zeros(len(at), np.int64)))
    return found


def tracked(
    frames: Sequence[Detections], parameters: DropletParameters | None = None
) -> Trajectories:
    return track(DropletTracker(parameters or DropletParameters()), frames)


def plug(
    first: int, step: float, last_x: float = 700.0, first_x: float = 100.0
) -> dict[int, tuple[float, float]]:
    """The frames of a plug that enters at `first_x` in one frame and leaves beyond `last_x`."""
    n = int((last_x - first_x) / step) + 1
    return {first + t: (first_x + step * t, 50.0) for t in range(n)}


def drawn(plugs: Sequence[dict[int, tuple[float, float]]], n: int) -> list[Detections]:
    return frames_of([[one[t] for one in plugs if t in one] for t in range(n)])


@pytest.mark.parametrize("name", TRAINS)
def test_no_plug_of_a_train_gets_anothers_identity(name: str) -> None:
    """Up to a step of 0.45 of the spacing, with and without images missing.

    What is missed are a droplet's first and last boxes: no track can tell of them.
    """
    truth, frames = make(MOTIONS[name], 0)
    result = tracked(frames)
    found = score(only_images(truth, frames), only_images(result, frames))
    assert found.switches == 0
    assert found.idf1 >= (0.95 if "0.45" in name else 0.985)


@pytest.mark.parametrize(
    ("name", "idf1"),
    [("short views", 0.99), ("short views faults", 0.95), ("short views holes", 0.8)],
)
def test_droplets_in_view_for_three_or_four_frames_are_found(name: str, idf1: float) -> None:
    truth, frames = make(MOTIONS[name], 0)
    result = tracked(frames)
    found = score(only_images(truth, frames), only_images(result, frames))
    assert found.switches == 0
    assert found.idf1 >= idf1


@pytest.mark.parametrize("step", [20.0, 40.0, 60.0])
@pytest.mark.parametrize("pause", [2, 8, 13])
def test_a_plug_that_left_is_not_the_next_one_that_enters(step: float, pause: int) -> None:
    """All are equal, and one at a time is in the image; none is there in between."""
    length, plugs, start = int(600 / step) + 1, [], 0
    for _ in range(6):
        plugs.append(plug(start, step))
        start += length + pause
    result = tracked(drawn(plugs, start))
    assert len(np.unique(result.track_id)) == 6
    assert result.observed.all()


def test_a_frame_without_an_image_is_no_miss() -> None:
    """Two images of three are missing: a new droplet is confirmed by those that there are."""
    plugs = [plug(0, 10.0), plug(30, 10.0)]
    frames = drawn(plugs, 90)
    holes = [one if t % 3 == 0 else frames_of([[]])[0] for t, one in enumerate(frames)]
    result = tracked(holes)
    assert len(np.unique(result.track_id)) == 2


def test_two_detections_are_enough_for_a_droplet_where_others_went_the_same_way() -> None:
    plugs = [plug(11 * i, 60.0) for i in range(5)]
    short = {60: (580.0, 50.0), 61: (640.0, 50.0)}  # comes from nowhere
    result = tracked(drawn([*plugs, short], 75))
    assert result.frame[result.x == 580].tolist()[-1] == 60
    assert len(np.unique(result.track_id)) == 6


@pytest.mark.parametrize("at", [(300.0, 50.0), (350.0, 150.0)])
def test_a_box_that_is_there_once_and_does_not_leave_is_no_droplet(at: tuple[float, float]) -> None:
    plugs = [plug(11 * i, 60.0) for i in range(5)]
    result = tracked(drawn([*plugs, {65: at}], 75))
    assert len(np.unique(result.track_id)) == 5


def train_without(*missing: tuple[int, int]) -> list[Detections]:
    """Twelve plugs, one every four frames, 60 px a frame; some boxes (plug, box) are missing.

    They are first seen at 100 to 160 px, last seen at 640 to 700.
    """
    plugs = [plug(4 * i, 60.0, first_x=100.0 + 23 * i % 60) for i in range(12)]
    for i, place in missing:
        del plugs[i][4 * i + place]
    return drawn(plugs, 4 * 11 + 30)


GAPS = ((3, 5), (5, 4), (9, 6))  # boxes in the middle of the image, by which misses are known


@pytest.mark.parametrize(("i", "place", "x"), [(10, 0, 150.0), (8, 9, 644.0)])
def test_a_plug_whose_first_or_last_box_is_missed_has_a_row_that_says_so(
    i: int, place: int, x: float
) -> None:
    """Others were seen further out than it would have been."""
    result = tracked(train_without((i, place), *GAPS))
    assert len(np.unique(result.track_id)) == 12
    row = result[(result.frame == 4 * i + place) & ~result.observed]
    assert row.x == pytest.approx([x], abs=3)
    assert row.y == pytest.approx([50], abs=3)
    assert (~result.observed).sum() == 1 + len(GAPS)


def test_no_row_is_added_where_every_plug_is_seen() -> None:
    frames = train_without()
    result = tracked(frames)
    assert result.observed.all()
    assert len(result) == sum(len(found) for found in frames)


def test_a_droplet_that_appears_inside_was_not_there_before() -> None:
    """Its first four boxes are missing: more than a detector misses in a row."""
    result = tracked(train_without(*((10, k) for k in range(4)), *GAPS))
    (same,) = result.track_id[(result.frame == 44) & (np.abs(result.x - 390) < 1)]
    assert result.x[result.track_id == same].min() == 390


def test_a_plug_in_the_last_frame_is_found_by_one_box() -> None:
    """No further one can come; it is where others enter, and as large."""
    plugs = [plug(3 * i, 100.0) for i in range(20)]
    result = tracked(drawn(plugs, 3 * 19 + 1))
    assert len(np.unique(result.track_id)) == 20
    assert result.x[result.frame == 57].min() == 100
    result = tracked(drawn([*plugs[:19], {57: (400.0, 300.0)}], 3 * 19 + 1))
    assert len(np.unique(result.track_id)) == 19


def test_an_expected_velocity_tells_steps_longer_than_half_the_spacing() -> None:
    """A step of 0.8 of the spacing looks like one of 0.2 backwards."""
    motion = train(spacing=2.0, step=0.8)
    step = motion.speed * motion.diameter
    truth, frames = make(motion, 0)
    alone = score(truth, tracked(frames))
    told = score(truth, tracked(frames, DropletParameters(expect_velocity=(step, 0.0))))
    assert alone.idf1 < 0.8
    assert told.idf1 > 0.9
    assert told.switches == 0


@pytest.mark.parametrize(("step", "ambiguous"), [(0.2, False), (0.45, True)])
def test_a_step_of_half_the_spacing_may_be_another(step: float, ambiguous: bool) -> None:
    _, frames = make(train(spacing=2.0, step=step), 0)
    tracker = DropletTracker(DropletParameters())
    for found in frames:
        tracker.update(found.boxes, np.zeros((len(found), 0)))
    assert tracker.velocity_is_ambiguous == ambiguous
