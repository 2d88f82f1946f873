"""Droplets as laboratories film them: exact outlines and boxes, labels, nothing by accident."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.scenes.appearance import Look, paint, random_look
from data_gen.scenes.channels import Channel, draw_walls, forming_plug, random_walls
from data_gen.scenes.confined import within_walls
from data_gen.scenes.dataset import image_source
from data_gen.scenes.distances import (
    box_of,
    cell_distance,
    ellipse_distance,
    patch_around,
    stadium_distance,
)
from data_gen.scenes.footage import ARRANGEMENTS, footage_scene
from data_gen.scenes.inclusions import paint_inside
from data_gen.scenes.outlines import MAX_DEFOCUS, ellipse, suspension
from data_gen.scenes.scene_kinds import HEIGHT, WIDTH
from data_gen.scenes.surroundings import add_text
from data_gen.scenes.windings import distance_from, winding
from droptrack.data.arrays import Float32s
from droptrack.data.frames import grey_frame
from droptrack.data.normalisation import GENTLE, normalisation_for

SHAPE = (HEIGHT, WIDTH)
CENTRE = np.array([300.3, 200.7])


@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2, 2.9])
def test_an_ellipse_ends_where_its_formula_says(angle: float) -> None:
    """Its half width is sqrt((a cos)² + (b sin)²)."""
    a, b = 40.0, 22.0
    patch = patch_around(SHAPE, CENTRE, a + 4)
    box = box_of(patch, ellipse_distance(patch, CENTRE, a, b, angle))
    half = np.array(
        [
            np.hypot(a * np.cos(angle), b * np.sin(angle)),
            np.hypot(a * np.sin(angle), b * np.cos(angle)),
        ]
    )
    assert box is not None
    np.testing.assert_allclose(box, [*(CENTRE - half), *(CENTRE + half)], atol=0.1)


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 0.5])
def test_a_stadium_is_two_half_discs_and_a_rectangle(angle: float) -> None:
    """Half length 60, half height 20 px: discs of 20 px at 40 px from the middle; and its area."""
    patch = patch_around(SHAPE, CENTRE, 70)
    distance = stadium_distance(patch, CENTRE, np.array([60.0, 20.0]), 20.0, angle)
    half = 20 + 40 * np.abs([np.cos(angle), np.sin(angle)])
    box = box_of(patch, distance)
    assert box is not None
    np.testing.assert_allclose(box, [*(CENTRE - half), *(CENTRE + half)], atol=0.05)
    assert (distance < 0).sum() == pytest.approx(80 * 40 + np.pi * 20**2, rel=0.005)
    assert distance.min() == pytest.approx(-20, abs=0.6)


def test_two_equal_droplets_meet_half_way_with_a_film_between_them() -> None:
    """36 px apart, of radius 20, film 4: each ends 16 px from its middle, less what is rounded."""
    patch = patch_around(SHAPE, CENTRE, 24)
    other = np.array([[CENTRE[0] + 36, CENTRE[1], 20.0]])
    distance = cell_distance(patch, CENTRE, 20.0, other, 4.0)
    box = box_of(patch, distance)
    assert box is not None
    alone = box_of(patch, cell_distance(patch, CENTRE, 20.0, np.zeros((0, 3)), 4.0))
    assert alone is not None
    np.testing.assert_allclose(alone, [*(CENTRE - 20), *(CENTRE + 20)], atol=0.05)
    assert CENTRE[0] + 13 < box[2] <= CENTRE[0] + 16
    assert box[0] == pytest.approx(CENTRE[0] - 20, abs=0.5)


def test_a_droplet_beyond_the_image_has_an_empty_patch_and_one_cut_ends_at_the_edge() -> None:
    assert patch_around(SHAPE, np.array([-50.0, 100.0]), 20).is_empty
    centre = np.array([5.0, 100.0])
    patch = patch_around(SHAPE, centre, 24)
    box = box_of(patch, ellipse_distance(patch, centre, 20, 20, 0))
    assert box is not None
    assert box[0] == 0
    assert box[2] == pytest.approx(25, abs=0.05)


@pytest.mark.parametrize("seed", range(8))
def test_a_droplet_is_visible_on_its_background_and_changes_nothing_else(seed: int) -> None:
    rng = np.random.default_rng(seed)
    level = float(rng.uniform(15, 245))
    look = replace(random_look(rng, level), halo=0.0)
    canvas = np.full(SHAPE, level, np.float32)
    outline = ellipse(rng, CENTRE, 30.0, 1.0, margin=20)
    patch, distance = outline.patch, outline.distance
    paint(canvas, outline, look, rng)
    change = np.abs(canvas[patch.rows, patch.columns] - level)
    assert change.max() > 20
    assert change[distance > 2].max() < 1e-3
    canvas[patch.rows, patch.columns] = level
    assert (canvas == np.float32(level)).all()


def plain(**parts: float) -> Look:
    """A look of what is named, and nothing else, with light from the right."""
    none = dict.fromkeys(("fill", "rim", "second", "core", "texture", "inclusions"), 0.0)
    sizes = {"rim_px": 4.0, "rim_share": 0.0, "second_at": 1.0, "core_size": 0.2, "soft": 1.0}
    return Look(**{**none, **sizes, "shading": 0.0, "light": 0.0, **parts})


def across(look: Look, radius: float = 30.0) -> Float32s:
    """What a droplet adds to each pixel of the line through its centre, from left to right."""
    canvas = np.zeros(SHAPE, np.float32)
    outline = ellipse(np.random.default_rng(0), CENTRE, radius, 1.0)
    paint(canvas, outline, look, np.random.default_rng(0))
    return canvas[200, outline.patch.columns]


@pytest.mark.parametrize("radius", [5.0, 30.0, 180.0])
def test_a_halo_is_outside_the_outline_and_ends_where_the_drawing_does(radius: float) -> None:
    levels = across(plain(halo=100.0), radius)
    x = np.arange(len(levels)) - len(levels) // 2
    assert levels[np.abs(x) < radius - 2].max() == 0
    assert 50 < levels[np.abs(x) > radius].max() < 100
    assert max(levels[0], levels[-1]) < 2


def test_much_shading_turns_a_rim_round_on_the_other_side() -> None:
    """28 of 30 px from the centre: 1 + 1.5 * 28 / 30 on one side, 1 - 1.5 * 28 / 30 opposite."""
    levels = across(plain(rim=40.0, shading=1.5))
    middle = len(levels) // 2
    assert levels[middle + 28] / levels[middle - 28] == pytest.approx(2.4 / -0.4, rel=0.1)


def test_a_tilted_filling_is_as_much_more_towards_the_light_as_less_away_from_it() -> None:
    levels = across(plain(tilt=60.0))
    middle = len(levels) // 2
    assert levels[middle + 15] == pytest.approx(30, abs=2)
    assert levels[middle - 15] == pytest.approx(-30, abs=2)


def test_a_reflection_lies_towards_the_light() -> None:
    """At 0.5 of a radius of 30 px; a lens's spot is in the middle."""
    for core_at, wanted in ((0.0, 300), (0.5, 315)):
        levels = across(plain(core=80.0, core_at=core_at))
        first = ellipse(np.random.default_rng(0), CENTRE, 30.0, 1.0).patch.columns.start
        assert first + levels.argmax() == pytest.approx(wanted, abs=1)
        assert levels.max() == pytest.approx(80, rel=0.02)


def test_out_of_focus_a_rim_is_wider_and_fainter_and_the_outline_stays() -> None:
    """A dark ring on grey: its strength falls to half where it is blurred by its own width."""
    rng = np.random.default_rng(0)
    look = plain(rim=-100.0)
    sharp = ellipse(rng, CENTRE, 30.0, 1.0, margin=30)
    deepest, wide = [], []
    for outline in (sharp, replace(sharp, defocus=4.0)):
        canvas = np.full(SHAPE, 128, np.float32)
        paint(canvas, outline, look, rng)
        across = 128 - canvas[200, 300:360]  # along x from the centre on
        deepest.append(across.max())
        wide.append((across > 2).sum())
    assert deepest[1] == pytest.approx(0.5 * deepest[0] * 0.9, rel=0.15)
    assert wide[1] > wide[0] + 2


def test_blurs_have_no_label() -> None:
    rng = np.random.default_rng(2)
    outlines = [o for _ in range(20) for o in suspension(rng, np.zeros(SHAPE, np.float32))]
    assert {outline.labelled for outline in outlines} == {True, False}
    assert all(o.labelled == (o.defocus < MAX_DEFOCUS * o.radius) for o in outlines)


@pytest.mark.parametrize(
    ("look", "defocus", "labelled"),
    [
        (plain(fill=-400.0), 0.0, [True, True, False]),  # black on black shows nothing
        (plain(fill=-40.0), 0.0, [True, True, True]),  # what is grey gets darker
        (plain(fill=-40.0), 20.0, [True, True, True]),
        (plain(rim=-40.0), 20.0, [False, False, False]),  # a rim of 4 px keeps a sixth: 4 / 24
        (plain(rim=-40.0), 6.0, [True, True, True]),  # and here 4 / 10
    ],
)
def test_only_what_can_be_seen_of_a_droplet_has_a_label(
    look: Look, defocus: float, labelled: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A large droplet, one beside it, and one that lies before it."""
    rng = np.random.default_rng(0)
    places = [([400.0, 300.0], 90.0), ([700.0, 300.0], 30.0), ([400.0, 300.0], 30.0)]
    outlines = [
        replace(ellipse(rng, np.array(centre), radius, 1.0, margin=defocus), defocus=defocus)
        for centre, radius in places
    ]
    monkeypatch.setitem(ARRANGEMENTS, "three", lambda *_: iter(outlines))
    grey = np.full(SHAPE, 128, np.float32)
    monkeypatch.setattr("data_gen.scenes.footage.background", lambda *_: (grey, 128.0))
    monkeypatch.setattr("data_gen.scenes.footage.random_look", lambda *_: look)
    boxes = footage_scene("three", np.random.default_rng(1)).boxes
    wanted = [[*at, 2 * r, 2 * r] for (at, r), one in zip(places, labelled, strict=True) if one]
    np.testing.assert_allclose(boxes, np.array(wanted).reshape(-1, 4), atol=0.1)


@pytest.mark.parametrize(("name", "seed"), [("packing", [9, 20]), ("stream", [5, 0, 0])])
def test_what_the_camera_shows_all_white_has_no_label(name: str, seed: list[int]) -> None:
    """Droplets in a part of an image, or in all of it, are brighter than its white."""
    scene = footage_scene(name, np.random.default_rng(seed))
    assert (scene.image == 255).mean() > 0.05
    for x, y, w, h in scene.boxes:
        rows, columns = (
            slice(max(0, int(middle - size / 2) - 3), int(middle + size / 2) + 4)
            for middle, size in ((y, h), (x, w))
        )
        assert (scene.image[rows, columns] < 255).any()


def test_faint_images_are_drawn_as_a_network_is_shown_them() -> None:
    """Contrasts below 32 levels are stretched, up to 4 times: no drawn image is left as faint."""
    for name in ("empty", "foam"):
        for seed in range(30):
            image = footage_scene(name, np.random.default_rng([7, seed])).image
            frame = grey_frame(image)
            assert normalisation_for([frame], stretching=GENTLE).levels is None


def test_faint_droplets_have_the_same_look_with_less_contrast() -> None:
    """60 levels of filling and 120 of rim become 5 and 10."""
    look = replace(random_look(np.random.default_rng(1), 128), fill=60.0, rim=-120.0, second=24.0)
    faint = look.faint(10)
    assert (faint.fill, faint.rim, faint.second) == pytest.approx((5, -10, 2))
    assert faint.contrast == pytest.approx(10)
    assert (faint.soft, faint.inclusions) == (look.soft, 0)


def test_cells_lie_inside_the_droplet_that_they_fit_in() -> None:
    """Of 4 px in one of 60 px: specks of a cell's size, well inside."""
    areas = []
    for seed in range(20):
        rng = np.random.default_rng([3, seed])
        outline = ellipse(rng, CENTRE, 60.0, 1.0)
        canvas = np.zeros(SHAPE, np.float32)
        paint_inside(canvas, outline, 4.0, rng)
        painted = np.abs(canvas) > 3
        distance = np.full(SHAPE, np.inf, np.float32)
        distance[outline.patch.rows, outline.patch.columns] = outline.distance
        assert distance[painted].max() < 6
        areas.append(painted.sum())
    assert max(areas) > 8 * min(areas)  # some have one, some have many
    assert np.pi * 3**2 < min(areas) < 3 * np.pi * 8**2


@pytest.mark.parametrize("cell_px", [0.0, 4.0])
def test_nothing_is_painted_into_a_droplet_beyond_the_image(cell_px: float) -> None:
    rng = np.random.default_rng(0)
    canvas = np.zeros(SHAPE, np.float32)
    paint_inside(canvas, ellipse(rng, np.array([-300.0, 100.0]), 60.0, 1.0), cell_px, rng)
    assert not canvas.any()


def test_a_winding_channel_has_its_width_everywhere() -> None:
    """Two parts along x, 200 px long and 60 px apart, 24 px wide: distances by hand."""
    course = winding(n=2, length=200, apart=60) + CENTRE
    distance = distance_from(course, 24)
    x, y = np.floor(CENTRE).astype(int)
    assert distance[y - 30, x] == pytest.approx(-12, abs=1)
    assert distance[y, x] == pytest.approx(30 - 12, abs=1)
    assert distance[y, x + 100 + 30] == pytest.approx(-12, abs=1)  # the outermost of the bend
    assert distance[y, x + 100 + 30 + 20] == pytest.approx(20 - 12, abs=1)


def test_captions_may_run_across_the_image() -> None:
    widths = []
    for seed in range(60):
        canvas = np.full(SHAPE, 128, np.float32)
        add_text(np.random.default_rng([4, seed]), canvas, anywhere=False)
        columns = np.flatnonzero((canvas != 128).any(axis=0))
        widths.append(np.ptp(columns))
    assert min(widths) < WIDTH / 4
    assert max(widths) > 0.8 * WIDTH


def test_a_channel_is_a_strip_from_its_start_on() -> None:
    """Along x at y = 200.5, 40 px wide, from x = 301 on: distances by hand."""
    centre = np.array([300.5, 200.5])
    distance = Channel(centre=centre, angle=0.0, width=40, start=0.5).distance()
    assert distance.shape == SHAPE
    assert distance[200, 600] == pytest.approx(-20)
    assert distance[230, 600] == pytest.approx(10)
    assert distance[200, 290] == pytest.approx(10.5)


def test_channels_of_one_layer_open_into_one_another_those_of_two_cross() -> None:
    rng = np.random.default_rng(0)
    middle = np.array([600.5, 300.5])
    cross = [Channel(centre=middle, angle=angle, width=60) for angle in (0.0, np.pi / 2)]
    walls = random_walls(rng)
    joined, layered = np.zeros((2, *SHAPE), np.float32)
    draw_walls(joined, [cross], walls, 0)
    draw_walls(layered, [cross[:1], cross[1:]], walls, 0)
    beside = 300 + 30 + int(walls[0].away + walls[0].width / 2)  # the wall below the first channel
    assert abs(joined[beside, 100]) > 10
    assert joined[beside, 600] == 0
    assert joined[beside, 100] == pytest.approx(layered[beside, 100])
    assert abs(layered[beside, 600]) > 10


def test_a_droplet_flattens_on_a_wall_and_its_rim_can_hide_there() -> None:
    """A disc of 30 px whose middle is 20 px below a wall: the segment above it is gone.

    That has R² arccos(d/R) - d sqrt(R² - d²); corners are rounded by a few px.
    """
    disc = ellipse(np.random.default_rng(0), CENTRE, 30.0, 1.0)
    wall = np.repeat(CENTRE[1] - 20 - np.arange(HEIGHT, dtype=np.float32)[:, None] - 0.5, WIDTH, 1)
    held = within_walls(disc, wall, 0.0)
    assert held is not None
    box = box_of(held.patch, held.distance)
    assert box is not None
    np.testing.assert_allclose(box, [*(CENTRE - [30, 20]), *(CENTRE + 30)], atol=2)
    segment = 30**2 * np.arccos(20 / 30) - 20 * np.sqrt(30**2 - 20**2)
    assert held.area == pytest.approx(np.pi * 30**2 - segment, rel=0.04)
    assert isinstance(held.rim, np.ndarray)
    assert held.rim[4 + 10, 34] == pytest.approx(0, abs=0.1)  # at the wall
    assert held.rim[4 + 58, 34] == 1  # at the other end
    assert within_walls(disc, wall + 40, 0.0) is None  # nine tenths of it are in the wall


def test_a_thread_has_a_head_as_high_as_a_plug_and_no_label() -> None:
    """From x = 600 to the right, 24 px high, plugs 60 px; smooth, so a bit larger.

    Where head and thread end together, the smooth minimum lies by ln 2 of its width further out.
    """
    channel = Channel(centre=np.array([600.5, 300.5]), angle=0.0, width=80)
    half = np.array([400.0, 12.0])
    (outline,) = forming_plug(channel, np.array([1000.5, 300.5]), half, 30.0, 1.0)
    assert not outline.labelled
    inside = np.zeros(SHAPE, bool)
    inside[outline.patch.rows, outline.patch.columns] = outline.distance < 0
    heights = inside.sum(axis=0)
    further = 0.4 * 30 * np.log(2)
    assert np.flatnonzero(heights)[0] == pytest.approx(600 - further, abs=1)
    assert heights[600:720].max() == pytest.approx(60, abs=6)
    assert heights[1000] == pytest.approx(24, abs=2)


@pytest.mark.parametrize("name", ARRANGEMENTS)
def test_a_scene_depends_on_its_seed_only_and_its_boxes_lie_in_the_image(name: str) -> None:
    n_boxes = 0
    for seed in range(3):
        scene, again = (footage_scene(name, np.random.default_rng([seed, 1])) for _ in range(2))
        np.testing.assert_array_equal(scene.image, again.image)
        np.testing.assert_array_equal(scene.boxes, again.boxes)
        assert scene.image.shape == SHAPE
        low = scene.boxes[:, :2] - scene.boxes[:, 2:] / 2
        high = scene.boxes[:, :2] + scene.boxes[:, 2:] / 2
        assert (low >= 0).all()
        assert (high <= [WIDTH, HEIGHT]).all()
        n_boxes += len(scene.boxes)
    assert (n_boxes == 0) == (name == "empty")


def test_training_can_draw_all_of_them() -> None:
    draw = image_source("everything")
    image, boxes = draw(np.random.default_rng(0))
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert boxes.shape[1] == 4
