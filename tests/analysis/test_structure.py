"""Cells, order, g(r) and rearrangements: lattices, drawings, freud and trackpy."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import Voronoi
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.analysis.bootstrap import ratio
from droptrack.analysis.structure.cells import Cells, cells_of
from droptrack.analysis.structure.frames import sum_frames
from droptrack.analysis.structure.order import hexatic_order, n_neighbours
from droptrack.analysis.structure.pair_correlation import pair_counts
from droptrack.analysis.structure.rearrangements import NeighbourChanges
from droptrack.analysis.structure.report import StructureConfig, analyse_structure
from droptrack.analysis.structure.window import Window
from droptrack.data.arrays import Floats
from droptrack.data.formats.table import Table
from droptrack.data.region import Region
from droptrack.data.trajectories import write_trajectories
from tests.analysis.drawings import hexagonal, rows_of

BOX = Window(size=(200, 200), periodic=True)


def at_random(n: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).uniform(0, 200, (n, 2))


def pairs(cells: Cells) -> set[tuple[int, int]]:
    return {
        (min(a, b), max(a, b))
        for a, b in zip(cells.first.tolist(), cells.second.tolist(), strict=True)
    }


def test_a_hexagonal_lattice_is_one_crystal() -> None:
    """In a periodic box all have six neighbours, psi_6 = 1, and cells of sqrt(3) / 2 a²."""
    places = hexagonal(20, 20, 10.0) + 1.0
    window = Window(size=(200, 173), periodic=True)
    places[:, 1] *= 173 / (20 * np.sqrt(0.75) * 10)  # the box in whole px
    cells = cells_of(places, np.full(400, 5.0), window, 1.5)
    assert (n_neighbours(cells) == 6).all()
    assert cells.areas == pytest.approx(200 * 173 / 400)
    assert np.abs(hexatic_order(cells)) == pytest.approx(1, abs=2e-3)
    assert np.abs(hexatic_order(cells, weighted=True)) == pytest.approx(1, abs=3e-3)
    assert cells.inner.all()


def test_at_an_open_boundary_only_whole_cells_count() -> None:
    places = hexagonal(8, 8, 10.0) + 40
    cells = cells_of(places, np.full(64, 5.0), Window(size=(200, 200)), 1.5)
    row, column = np.divmod(np.arange(64), 8)
    assert (n_neighbours(cells)[cells.inner] == 6).all()
    assert cells.areas[cells.inner] == pytest.approx(np.sqrt(0.75) * 100)
    middle = (row > 0) & (row < 7) & (column > 0) & (column < 7)
    assert cells.inner[middle].all()
    assert not cells.inner[~middle].any()


def test_a_region_leaves_out_cells_that_reach_over_its_wall() -> None:
    places = hexagonal(8, 8, 10.0) + 40
    mask = np.zeros((200, 200), bool)
    mask[:, :85] = True  # a wall at x = 85
    cells = cells_of(places, np.full(64, 5.0), Window(size=(200, 200), region=Region(mask)), 1.5)
    assert cells.inner.any()
    assert places[cells.inner, 0].max() < 80.1  # the next one's cell goes from 80 or 85 on


def test_cells_of_equal_discs_are_voronoi_s() -> None:
    places = at_random(150)
    cells = cells_of(places, np.full(150, 3.0), Window(size=(200, 200)))
    diagram = Voronoi(places)
    expected = {(min(a, b), max(a, b)) for a, b in diagram.ridge_points.tolist()}
    lost = expected - pairs(cells)
    assert pairs(cells) <= expected
    hull = {k for k in range(150) if -1 in diagram.regions[diagram.point_region[k]]}
    assert all(a in hull and b in hull for a, b in lost)  # long slivers along the hull
    for k in np.flatnonzero(cells.inner):
        corners = diagram.vertices[diagram.regions[diagram.point_region[k]]]
        x, y = corners.T
        area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        assert cells.areas[k] == pytest.approx(area)


def test_radical_cells_are_where_the_power_is_least() -> None:
    """Each place of a fine grid belongs to the disc with the least |x - c|² - r²."""
    rng = np.random.default_rng(1)
    places, radii = at_random(40, 2), rng.uniform(2, 25, 40)
    cells = cells_of(places, radii, BOX)
    steps = (np.arange(800) + 0.5) / 4
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 1, 2)
    owner = np.zeros(len(grid), int)
    for part in np.array_split(np.arange(len(grid)), 20):
        offset = np.abs(grid[part] - places)
        offset = np.minimum(offset, 200 - offset)
        owner[part] = ((offset**2).sum(axis=-1) - radii**2).argmin(axis=1)
    counted = np.bincount(owner, minlength=40) / 16
    assert np.nan_to_num(cells.areas) == pytest.approx(counted, abs=6)
    assert np.nansum(cells.areas) == pytest.approx(200**2)
    assert (counted == 0).sum() == np.isnan(cells.areas).sum()


def test_freud_finds_the_same_neighbours_areas_and_order() -> None:
    freud = pytest.importorskip("freud")
    places = at_random(300, 3)
    cells = cells_of(places, np.full(300, np.nan), BOX)
    box = freud.box.Box.square(200)
    points = np.column_stack([places - 100, np.zeros(300)])
    voronoi = freud.locality.Voronoi()
    voronoi.compute((box, points))
    assert cells.areas == pytest.approx(voronoi.volumes, rel=1e-4)
    assert n_neighbours(cells).tolist() == voronoi.nlist.neighbor_counts.tolist()
    for weighted in (False, True):
        order = freud.order.Hexatic(k=6, weighted=weighted)
        order.compute((box, points), neighbors=voronoi.nlist)
        ours = np.abs(hexatic_order(cells, weighted=weighted))
        assert ours == pytest.approx(np.abs(order.particle_order), abs=2e-4)


def test_freud_finds_the_same_pair_correlation_in_a_periodic_box() -> None:
    freud = pytest.importorskip("freud")
    frames, places = np.repeat(np.arange(5), 100), at_random(500, 4)
    edges = np.linspace(0, 80, 21)
    counts, chance = pair_counts(frames, places, np.tile(np.arange(100), 5), BOX, edges, 100)
    rdf = freud.density.RDF(bins=20, r_max=80, normalization_mode="finite_size")
    for k in range(5):
        points = np.column_stack([places[frames == k] - 100, np.zeros(100)])
        rdf.compute((freud.box.Box.square(200), points), reset=False)
    # freud divides by the area of the annulus, we by the middle's circle: the same in 2D
    assert ratio(counts, chance)[1:] == pytest.approx(rdf.rdf[1:], rel=1e-3)


@pytest.mark.parametrize("shape", ["image", "region"])
def test_places_at_random_in_any_window_have_g_of_1(shape: str) -> None:
    """Up to half of the window's height, where two fifths of the neighbourhood are cut off."""
    rng = np.random.default_rng(5)
    window = Window(size=(300, 100))
    if shape == "region":
        y, x = np.mgrid[:100, :300]
        window = Window(size=(300, 100), region=Region((np.abs(y - 50) < 20 + x / 10) & (x > 30)))
    places = rng.uniform(0, [300, 100], (40_000, 2))
    places = places[window.contains(places)][:20_000]
    frames, owners = np.repeat(np.arange(100), 200), np.tile(np.arange(200), 100)
    counts, chance = pair_counts(frames, places, owners, window, np.linspace(0, 50, 11), 200)
    assert ratio(counts, chance) == pytest.approx(np.ones(10), abs=0.03)


def test_the_overlap_of_a_rectangle_is_its_closed_form() -> None:
    edges = np.linspace(0, 60, 13)
    middles = (edges[1:] + edges[:-1]) / 2
    share = Window(size=(200, 80)).distance_share(edges)
    overlap = 200 * 80 - 2 / np.pi * middles * 280 + middles**2 / np.pi
    assert share == pytest.approx(2 * np.pi * middles * 5 * overlap / 16000**2, rel=2e-3)


MIDDLE = np.array([30.0, 30 * np.sqrt(0.75)])  # between two neighbours of a row of the lattice


def t1(n_frames: int, when: int, noise: float = 0.0) -> Floats:
    """Places (T, N, 2): a hexagonal lattice in whose middle four droplets change neighbours.

    The pair along x parts and the pair along y meets, slowly, halfway in the frame `when`.
    """
    lattice, middle = hexagonal(7, 6, 10.0), MIDDLE
    order = np.argsort(np.hypot(*(lattice - middle).T))
    others = lattice[order[4:]]
    share = np.clip(0.5 + (np.arange(n_frames) - when + 0.01) / 20, 0, 1)[:, None]
    along_x = 6 + 2 * share
    along_y = 8 - 2 * share
    zero = np.zeros_like(share)
    four = [
        np.hstack([sign * one, sign * other])[:, None]
        for one, other in ((along_x, zero), (zero, along_y))
        for sign in (-1, 1)
    ]
    still = np.broadcast_to(others, (n_frames, *others.shape))
    places = np.concatenate([np.concatenate(four, axis=1) + middle, still], axis=1) + 50
    return places + np.random.default_rng(0).normal(0, noise, places.shape)


def test_a_drawn_t1_is_found_once_where_and_when_it_is() -> None:
    sums = sum_frames(Table(rows=rows_of(t1(60, 30))), Window(size=(200, 200)), 1.5, 3)
    (event,) = sums.events
    assert set(event.lost) == {0, 1}
    assert set(event.gained) == {2, 3}
    assert abs(event.frame - 30) <= 1
    assert [event.x, event.y] == pytest.approx((MIDDLE + 50).tolist(), abs=0.1)
    assert sums.n_flips == 1


def test_a_t1_outside_of_the_region_is_not_counted() -> None:
    mask = np.zeros((200, 200), bool)
    mask[:, :60] = True
    window = Window(size=(200, 200), region=Region(mask))
    sums = sum_frames(Table(rows=rows_of(t1(60, 30))), window, 1.5, 3)
    assert sums.n_flips == 1
    assert not sums.events


def test_noise_at_the_change_makes_no_more_of_it() -> None:
    rows = rows_of(t1(60, 30, noise=0.9))
    sums = sum_frames(Table(rows=rows), Window(size=(200, 200)), 1.5, 4)
    assert sums.n_flips > 1
    of_four = [one for one in sums.events if {*one.lost, *one.gained} == {0, 1, 2, 3}]
    assert [set(one.lost) for one in of_four] == [{0, 1}]


def test_a_flow_that_carries_all_along_rearranges_nothing() -> None:
    lattice = hexagonal(8, 8, 10.0) + 20
    turned = [[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]]
    places = [lattice]
    for _ in range(30):
        places.append((places[-1] - 60) @ np.array(turned) + 60)
    sums = sum_frames(Table(rows=rows_of(np.array(places))), Window(size=(200, 200)), 1.5, 3)
    assert sums.n_flips == 0


def change(states: list[str], persistence: int) -> int:
    """Changes of four droplets, of which "x" has 0 and 1 as neighbours, "y" 2 and 3, "-" lost 3."""
    changes = NeighbourChanges(persistence)
    places = np.array([[-1.0, 0], [1, 0], [0, -1], [0, 1]])
    sides = [(0, 2), (0, 3), (1, 2), (1, 3)]
    for frame, state in enumerate(states):
        kept = [0, 1, 2] if state == "-" else [0, 1, 2, 3]
        near = [*sides, (0, 1) if state != "y" else (2, 3)]
        near = [one for one in near if set(one) <= set(kept)]
        first, second = np.array(near).T
        changes.add(frame, np.array(kept), places[kept], (first, second))
    return len(changes.found())


def test_changes_have_to_last() -> None:
    assert change(list("xxxxyyyy"), 3) == 1
    assert change(list("xxxxyyxx"), 3) == 0
    assert change(list("xxxxyxyyyy"), 3) == 1  # it flickers once
    assert change(list("xxxxyy"), 3) == 0  # the recording ends too early
    assert change(list("xxxxyyyyxxxx"), 3) == 2  # back again is another
    assert change(list("xxxx-yyyy"), 3) == 0  # nobody saw it


def test_the_command_says_how_walls_are_treated(tmp_path: Path) -> None:
    places = np.repeat((hexagonal(8, 8, 10.0) + 40)[None], 10, axis=0)
    write_trajectories(tmp_path / "t.csv", rows_of(places), {"um per px": "2"})
    found = {}
    for name, options in (
        ("open", []),
        ("region", ["--region", "30,30 90,30 90,120 30,120"]),
        ("far", ["--region", "1,1 9,1 9,9 1,9"]),
    ):
        arguments = ["structure", str(tmp_path / "t.csv"), "--out", str(tmp_path / name)]
        result = CliRunner().invoke(app, ["analyse", *arguments, "--size", "200x200", *options])
        assert result.exit_code == 0, result.output
        found[name] = json.loads((tmp_path / name / "structure.json").read_text())
    whole = found["open"]
    assert whole["psi6"] == pytest.approx(1)
    assert whole["neighbours"] == 6
    assert whole["t1_rate_per_frame"] == 0
    assert whole["cell_area_px2"] == pytest.approx(np.sqrt(0.75) * 100)
    assert whole["cell_area_um2"] == pytest.approx(np.sqrt(0.75) * 400)
    assert whole["packing_fraction"] == pytest.approx(64 * np.pi * 25 / 200**2)
    assert whole["local_area_fraction"] == pytest.approx(np.pi / np.sqrt(12))
    assert whole["settings"]["boundary"] == "open: the image"
    # a polygon has half a pixel more along its border
    area = found["region"]["settings"]["window_area_px2"]
    assert area == pytest.approx(60 * 90 + 150, abs=2)
    assert found["region"]["n_inner"] < whole["n_inner"]
    assert found["far"]["psi6"] is None
    assert found["far"]["not_defined"]["packing_fraction"] == "no droplet is in the region"
    assert (tmp_path / "open" / "structure_pair_correlation.png").exists()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_few_droplets_have_no_inner_ones(n: int) -> None:
    places = np.repeat((hexagonal(2, 2, 10.0) + 40)[None, :n], 3, axis=0)
    found = analyse_structure(Table(rows=rows_of(places)), StructureConfig())
    values = {one.stem: one for one in found.quantities}
    assert np.isnan(values["psi6"].value)
    assert "inner" in values["psi6"].reason
    assert all(np.isfinite(one.value) or one.reason for one in found.quantities)


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    write_trajectories(tmp_path / "t.csv", rows_of(hexagonal(4, 4, 10.0)[None] + 20), {})
    for options, message in (
        (["--reach", "0"], "--reach 0: should be above 0"),
        (["--persistence", "0"], "--persistence 0: should be at least 1 frame"),
        (["--periodic", "--region", "1,1 9,1 9,9"], "give --region or --periodic, not both"),
    ):
        arguments = ["structure", str(tmp_path / "t.csv"), "--out", str(tmp_path / "a")]
        result = CliRunner().invoke(app, ["analyse", *arguments, *options])
        assert result.exit_code == 1
        assert message in result.output
