"""The scale that frames suggest: what a network sees again at other scales is a droplet."""

import sys
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from data_gen.scenes.shapes import draw_ellipses
from droptrack.data.arrays import Floats
from droptrack.data.detections import Detections
from droptrack.data.frames import Frame, grey_frame
from droptrack.data.stage_times import StageTimes
from droptrack.detection import scale_choice
from droptrack.detection.scale_choice import choose_scale
from droptrack.detection.scale_evidence import STEP, TILE, scales_for

KNOWN = (14, 120)  # sizes that the detector below knows, px of its input


class Blobs:
    """A detector that knows its scale: bright blobs of the sizes it knows; specks where asked."""

    max_iou = 0.3

    def __init__(self, n_specks: int = 0, score: float = 0.9) -> None:
        self._n_specks, self._score, self._rng = n_specks, score, np.random.default_rng(0)

    def start(self, frames: Sequence[Frame], times: StageTimes) -> Callable[[], list[Detections]]:
        return lambda: [self._find(frame) for frame in frames]

    def _find(self, frame: Frame) -> Detections:
        assert frame.shape == (TILE, TILE, 3)
        _, _, stats, _ = cv2.connectedComponentsWithStats((frame[..., 0] > 128).astype(np.uint8))
        boxes = stats[1:, :4].astype(float)
        boxes[:, :2] += boxes[:, 2:] / 2
        side = np.sqrt(boxes[:, 2:].prod(axis=1))
        boxes = boxes[(side > KNOWN[0]) & (side < KNOWN[1])]
        specks = self._rng.uniform(20, TILE - 20, (self._n_specks, 2))
        boxes = np.vstack([boxes, np.hstack([specks, np.full_like(specks, 16)])])
        return Detections(boxes, np.full(len(boxes), self._score), np.zeros(len(boxes), int))


def discs(radius: float, size: tuple[int, int]) -> tuple[Frame, Floats]:
    """White discs on a lattice of four radii, moved by up to half a radius; x, y of each."""
    rng = np.random.default_rng(0)
    steps = [np.arange(2 * radius, side - radius, 4 * radius) for side in size]
    places = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2).astype(float)
    places += rng.uniform(-0.5, 0.5, places.shape) * radius
    image = np.zeros(size[::-1], np.uint8)
    rows = np.column_stack([places, np.full((len(places), 2), radius), np.zeros(len(places))])
    draw_ellipses(image, rows, 230)
    return grey_frame(image), places


@pytest.mark.parametrize(
    ("radius", "size"), [(4, (400, 300)), (25, (900, 700)), (150, (1900, 1200))]
)
@pytest.mark.parametrize("n_specks", [0, 1])
def test_discs_of_any_size_get_a_scale_at_which_they_are_known(
    radius: float, size: tuple[int, int], n_specks: int
) -> None:
    """Boxes that no other scale confirms do not change it."""
    frame, places = discs(radius, size)
    choice = choose_scale([frame], Blobs(n_specks), default=0.8)  # type: ignore[arg-type]
    assert KNOWN[0] <= 2 * radius * choice.scale <= KNOWN[1]
    assert choice.quality[choice.scale] > 0.7
    assert np.median(choice.diameters) == pytest.approx(2 * radius, rel=0.08)
    # in the tiles looked at, so not more than there are
    assert 0.3 * len(places) <= len(choice.diameters) <= len(places)


def test_what_is_seen_at_one_scale_only_changes_nothing() -> None:
    """Dust and noise of frames without droplets."""
    frame = grey_frame(np.zeros((600, 1200), np.uint8))
    choice = choose_scale([frame], Blobs(n_specks=1), default=0.8)  # type: ignore[arg-type]
    assert (choice.scale, choice.quality, len(choice.diameters)) == (0.8, {}, 0)


def test_clear_droplets_among_many_specks_still_get_a_scale() -> None:
    """If half of the frames have some; none of the scales is good."""
    frame, _ = discs(25, (900, 700))
    empty = grey_frame(np.zeros((700, 900), np.uint8))
    for frames, wanted in (([frame, empty], 0.8), ([frame, empty, empty], 3.2)):
        choice = choose_scale(frames, Blobs(n_specks=60), default=3.2)  # type: ignore[arg-type]
        assert choice.scale == pytest.approx(wanted)


@pytest.mark.parametrize(("n_specks", "large", "n_levels"), [(60, 24, 2), (60, 12, 0), (0, 24, 0)])
def test_where_all_scales_are_in_doubt_droplets_of_many_sizes_get_two(
    n_specks: int, large: int, n_levels: int
) -> None:
    """Discs of 16 px and some three times as large: a finer scale than for these alone."""
    image, _ = discs(8, (300, 350))
    larger, _ = discs(large, (900, 350))
    frames = [np.hstack([image, larger])] * 2
    choice = choose_scale(frames, Blobs(n_specks), default=1.6)  # type: ignore[arg-type]
    assert len(choice.levels) == n_levels
    if n_levels:
        (smaller, fine), (rest, coarse) = choice.levels
        assert fine == choice.scale > coarse == pytest.approx(20 / large, rel=0.1)
        assert (smaller.smallest, rest.largest) == (0, np.inf)
        assert smaller.largest == rest.smallest == pytest.approx(16 / coarse)


@pytest.mark.parametrize(("n_empty", "score", "chosen"), [(0, 0.65, 1), (1, 0.65, 0), (2, 0.9, 1)])
def test_what_few_frames_have_has_to_be_seen_more_surely(
    n_empty: int, score: float, chosen: int
) -> None:
    """Digits and specks have an evidence of about 0.65; droplets that pass now and then, more."""
    frame, _ = discs(150, (1900, 1200))
    frames = [frame, *[grey_frame(np.zeros((1200, 1900), np.uint8))] * n_empty]
    choice = choose_scale(frames, Blobs(score=score), default=0.8)  # type: ignore[arg-type]
    assert (choice.scale != 0.8) == chosen


def test_small_things_in_droplets_are_no_droplets() -> None:
    """Dark discs with five bright cells each: the cells outnumber them, and are as clear."""
    frame, places = discs(80, (1000, 1000))
    image = frame[..., 0].copy()
    cells = (places[:, None] + np.array([[0, 0], [40, 0], [-40, 0], [0, 40], [0, -40]])).reshape(
        -1, 2
    )
    for x, y in cells:
        cv2.circle(image, (round(x), round(y)), 14, 0, 2)
    choice = choose_scale([grey_frame(image)], Blobs(), default=3.0)  # type: ignore[arg-type]
    assert 160 * choice.scale <= KNOWN[1]
    assert np.median(choice.diameters) == pytest.approx(160, rel=0.05)


def test_without_droplets_the_default_is_taken() -> None:
    black = grey_frame(np.zeros((300, 400), np.uint8))
    choice = choose_scale([black], Blobs(), default=0.7)  # type: ignore[arg-type]
    assert choice.scale == 0.7
    assert not len(choice.diameters)


@pytest.mark.parametrize("default", [0.6, 1.0])
def test_of_scales_that_are_as_good_the_middle_is_taken(default: float) -> None:
    """Discs of 50 px, found at all scales that make them KNOWN: in the middle of these, a step."""
    frame, _ = discs(25, (900, 700))
    choice = choose_scale([frame], Blobs(), default=default)  # type: ignore[arg-type]
    middle = np.sqrt(KNOWN[0] * KNOWN[1]) / 50
    assert middle / STEP <= choice.scale <= middle * STEP


@pytest.mark.parametrize(
    ("large", "quality", "wanted"), [(23, 0.9, 2.26), (23, 0.8, 1.6), (8, 0.9, 1.6)]
)
def test_droplets_of_many_sizes_get_a_scale_for_most_of_them(
    monkeypatch: pytest.MonkeyPatch, large: int, quality: float, wanted: float
) -> None:
    """40 discs of 16 px and 8 of 46 px: 40 / 16 is nearest to 2.26, if that is not much worse.

    Where all have 16 px, the best is taken.
    """
    image = np.zeros((400, 600), np.uint8)
    places = [(x, y) for y in range(40, 400, 66) for x in range(40, 600, 74)]
    for k, place in enumerate(places):
        cv2.circle(image, place, large if k % 6 == 0 else 8, 230, -1)
    of_scales = dict.fromkeys(scales_for(600, 400, 0.8), 0.0)
    of_scales |= {scale: 1.0 for scale in of_scales if 1.5 < scale < 1.7}
    of_scales |= {scale: quality for scale in of_scales if 2.2 < scale < 2.3}
    monkeypatch.setattr(scale_choice, "_qualities", lambda seen, tiny: of_scales)
    choice = choose_scale([grey_frame(image)], Blobs(), default=0.8)  # type: ignore[arg-type]
    assert choice.scale == pytest.approx(wanted, abs=0.01)


def test_droplets_of_very_many_sizes_get_two_scales() -> None:
    """Discs of 16, 30 and 200 px: no scale makes all KNOWN, two do, each for its sizes."""
    frame, radii = np.zeros((900, 1200), np.uint8), [8] * 12 + [15] * 18
    for k, radius in enumerate(radii):
        cv2.circle(frame, (60 + 36 * k, 60 + 50 * (k % 3)), radius, 230, -1)
    for k in range(10):
        cv2.circle(frame, (130 + 230 * (k % 5), 400 + 250 * (k // 5)), 100, 230, -1)
    choice = choose_scale([grey_frame(frame)], Blobs(), default=0.8)  # type: ignore[arg-type]
    (small, fine), (large, coarse) = choice.levels
    assert small.largest == large.smallest
    assert 30 < small.largest < 200
    assert all(KNOWN[0] <= diameter * fine <= KNOWN[1] for diameter in (16, 30))
    assert KNOWN[0] <= 200 * coarse <= KNOWN[1]


@pytest.mark.parametrize(("other", "differ"), [(20, False), (60, True)])
def test_images_whose_droplets_differ_in_size_are_told(other: int, differ: bool) -> None:
    """Discs of 40 px in one image, of 40 or 120 in the other; droplets of one size need no two."""
    frames = [discs(radius, (900, 700))[0] for radius in (20, other)]
    choice = choose_scale(frames, Blobs(), default=0.8)  # type: ignore[arg-type]
    assert choice.differ == differ
    assert not choice.levels


@pytest.mark.parametrize(("n_inside", "fits"), [(0, 360), (3, 360), (60, 14)])
def test_a_droplet_that_fills_the_frame_sets_the_scale_unless_it_is_the_view_of_others(
    n_inside: int, fits: float
) -> None:
    """A ring of 360 px in a frame of 440, with discs of 14 px in it; at 0.3 the ring is known."""
    image = np.zeros((440, 440), np.uint8)
    cv2.circle(image, (220, 220), 178, 230, 5)
    places = np.stack(np.meshgrid(*[np.arange(100, 350, 32)] * 2), axis=-1).reshape(-1, 2)
    for x, y in np.random.default_rng(0).permutation(places)[:n_inside]:
        cv2.circle(image, (x, y), 7, 230, -1)
    choice = choose_scale([grey_frame(image)], Blobs(), default=1.5)  # type: ignore[arg-type]
    assert KNOWN[0] <= fits * choice.scale <= KNOWN[1]


def test_the_finest_scale_is_one_at_which_a_network_is_still_sure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a detector that shows discs of 50 px at every scale up to 400 px of its input."""
    monkeypatch.setattr(sys.modules[__name__], "KNOWN", (14, 400))
    monkeypatch.setattr(scale_choice, "PLENTY_PX", np.inf)
    frame, _ = discs(25, (200, 200))
    choice = choose_scale([frame], Blobs(), default=1.0)  # type: ignore[arg-type]
    assert 100 <= 50 * choice.scale <= 180


@pytest.mark.parametrize("radius", [16, 25, 40])
def test_large_droplets_get_the_coarsest_scale_at_which_they_are_large_enough(
    monkeypatch: pytest.MonkeyPatch, radius: int
) -> None:
    """Of those at which a detector finds them: 40 px of the input, or up to a step more."""
    monkeypatch.setattr(sys.modules[__name__], "KNOWN", (14, 400))
    frame, _ = discs(radius, (16 * radius, 12 * radius))
    choice = choose_scale([frame], Blobs(), default=1.0)  # type: ignore[arg-type]
    assert 39 <= 2 * radius * choice.scale <= 41 * STEP


def test_scales_are_those_that_make_an_input_neither_tiny_nor_huge() -> None:
    assert min(scales_for(4000, 3000, 0.3)) * 3000 >= 48
    assert max(scales_for(4000, 3000, 0.3)) ** 2 * 4000 * 3000 <= 9e6
    assert scales_for(8, 8, 1.0) == []
