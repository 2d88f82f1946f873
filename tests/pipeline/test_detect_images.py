"""Droplets of single images: a row each, cut ones marked, images of any size, counts and sizes."""

import csv
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from data_gen.scenes.shapes import draw_ellipses
from droptrack.__main__ import app


def image_of(path: Path, discs: list[tuple[float, float, float]], size: tuple[int, int]) -> None:
    """White discs (x, y, radius) on black."""
    canvas = np.zeros(size[::-1], np.uint8)
    if discs:
        draw_ellipses(canvas, np.array([[x, y, r, r, 0] for x, y, r in discs]), 255)
    cv2.imwrite(str(path), canvas)


def detect(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["detect", *arguments])
    return result.exit_code, result.output


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "detections.csv").open() as file:
        return list(csv.DictReader(file))


def test_images_of_two_sizes_have_their_droplets(tmp_path: Path) -> None:
    """Three discs by hand, one of them cut by the edge; places to 0.05 px, diameters to 6 %."""
    one, two = tmp_path / "one.png", tmp_path / "two.png"
    image_of(one, [(100.25, 120, 30), (300, 200.5, 40)], (500, 400))
    image_of(two, [(2, 150, 35), (200, 80, 25)], (320, 320))
    out = tmp_path / "out"
    code, said = detect(str(one), str(two), "--out", str(out), "--precision", "fp32")
    assert code == 0, said
    rows = rows_of(out)
    assert [Path(row["image"]).name for row in rows] == ["one.png"] * 2 + ["two.png"] * 2
    assert [row["at_edge"] for row in rows] == ["0", "0", "1", "0"]
    whole = [row for row in rows if row["at_edge"] == "0"]
    for row, (x, y, r) in zip(
        whole, [(100.25, 120, 30), (300, 200.5, 40), (200, 80, 25)], strict=True
    ):
        assert row["centre_of_mass"] == "1"
        assert (float(row["x"]), float(row["y"])) == pytest.approx((x, y), abs=0.05)
        assert (float(row["w"]), float(row["h"])) == pytest.approx((2 * r, 2 * r), rel=0.06)
    report = json.loads((out / "report.json").read_text())
    assert [row["n_droplets"] for row in report["droplets"]] == [2, 2]
    summary = report["summary"]
    assert (summary["n_images"], summary["n_droplets"], summary["n_at_edge"]) == (2, 4, 1)
    assert summary["mean_diameter_px"] == pytest.approx(2 * (30 + 40 + 25) / 3, rel=0.06)
    assert cv2.imread(str(out / "sizes.png")) is not None
    for name, size in (("one", (400, 500)), ("two", (320, 320))):
        drawn = cv2.imread(str(out / "annotated" / f"{name}.jpg"))
        assert drawn is not None
        assert drawn.shape[:2] == size


def test_faint_and_red_images_are_seen_as_clearly_as_white_ones(tmp_path: Path) -> None:
    """The same discs three times; the network is shown what it learned, and told so."""
    discs = [(100.0, 120.0, 30.0), (300.0, 200.0, 40.0)]
    white = tmp_path / "white.png"
    image_of(white, discs, (500, 400))
    plane = np.asarray(cv2.imread(str(white), cv2.IMREAD_GRAYSCALE), np.uint8)
    faint = (60 + plane * 0.1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "faint.png"), faint)
    cv2.imwrite(str(tmp_path / "red.png"), np.dstack([plane * np.uint8(0)] * 2 + [plane]))
    out = tmp_path / "out"
    code, said = detect(str(tmp_path), "--out", str(out), "--no-shape")
    assert code == 0, said
    images = json.loads((out / "report.json").read_text())["droplets"]
    assert [row["n_droplets"] for row in images] == [2, 2, 2]
    faint_one, red_one, white_one = (row["network_sees"] for row in images)
    assert "stretched" in faint_one
    assert (red_one, white_one) == ("the red channel", "")


def test_rims_are_found_at_a_scale_of_its_own_choice(tmp_path: Path) -> None:
    """Nine dark rings on grey by hand, the same grey inside and out, 140 px and so too large."""
    canvas = np.full((760, 900), 150, np.uint8)
    places = [(160.0 + 280 * column, 130.0 + 250 * row) for column in range(3) for row in range(3)]
    for x, y in places:
        cv2.circle(canvas, (round(x), round(y)), 67, 60, 6, cv2.LINE_AA)
    noisy = canvas + np.random.default_rng(0).normal(0, 3, canvas.shape)
    cv2.imwrite(str(tmp_path / "rims.png"), np.clip(noisy, 0, 255).astype(np.uint8))
    out = tmp_path / "out"
    code, said = detect(str(tmp_path / "rims.png"), "--out", str(out), "--weights", "footage")
    assert code == 0, said
    rows = rows_of(out)
    found = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    assert len(found) == 9
    away = np.hypot(*(np.array(places)[:, None] - found).transpose(2, 0, 1))
    assert away.min(axis=1).max() < 3
    diameters = np.array([float(row["diameter_px"]) for row in rows])
    np.testing.assert_allclose(diameters, 140, rtol=0.03)
    settings = json.loads((out / "report.json").read_text())["settings"]
    assert settings["network"].endswith("yolov3-tiny-footage.weights")
    assert 8 <= 140 * settings["scale"] <= 240


def ring_image(path: Path, radius: int, n: tuple[int, int]) -> None:
    """Dark rings on grey, 1000 x 800 px, n columns and rows of them."""
    canvas = np.full((800, 1000), 150, np.uint8)
    for x in np.linspace(1.6 * radius, 1000 - 1.6 * radius, n[0]):
        for y in np.linspace(1.6 * radius, 800 - 1.6 * radius, n[1]):
            cv2.circle(canvas, (round(x), round(y)), radius, 60, max(1, radius // 9), cv2.LINE_AA)
    noisy = canvas + np.random.default_rng(0).normal(0, 3, canvas.shape)
    cv2.imwrite(str(path), np.clip(noisy, 0, 255).astype(np.uint8))


def test_images_of_several_lenses_get_a_scale_each(tmp_path: Path) -> None:
    """Rings of 14 px in one image, of 300 px in the other: no scale shows both.

    A third image, of about their size, has its own scale, too.
    """
    ring_image(tmp_path / "far.png", 7, (12, 10))
    ring_image(tmp_path / "near.png", 150, (2, 2))
    near = np.asarray(cv2.imread(str(tmp_path / "near.png"), cv2.IMREAD_GRAYSCALE))
    cv2.imwrite(str(tmp_path / "smaller.png"), near[:-20])
    out = tmp_path / "out"
    code, said = detect(str(tmp_path), "--out", str(out), "--weights", "footage", "--no-shape")
    assert code == 0, said
    assert "a scale of its own" in " ".join(said.split())
    report = json.loads((out / "report.json").read_text())
    assert report["settings"]["scale"] == "of each image"
    scales = [row["scale"] for row in report["droplets"]]
    assert scales[0] > 1.3 * max(scales[1:])
    assert [row["n_droplets"] for row in report["droplets"]] == [120, 4, 4]


def test_droplets_of_very_many_sizes_are_found_at_two_scales(tmp_path: Path) -> None:
    """99 rings of 14 px and 6 of 400: the report has both scales, the console says why.

    And in an image a bit smaller, for which what was chosen holds, too.
    """
    path = tmp_path / "many.png"
    image = np.full((1300, 1400), 150, np.uint8)
    for x in range(30, 1400, 42):
        for y in (30, 90, 150):
            cv2.circle(image, (x, y), 7, 60, 1, cv2.LINE_AA)
    for x in (240, 700, 1160):
        for y in (440, 900):
            cv2.circle(image, (x, y), 195, 60, 12, cv2.LINE_AA)
    cv2.imwrite(str(path), image)
    cv2.imwrite(str(tmp_path / "smaller.png"), image[:-40])
    out = tmp_path / "out"
    code, said = detect(str(tmp_path), "--out", str(out), "--weights", "footage", "--no-shape")
    assert code == 0, said
    assert "many sizes" in " ".join(said.split())
    report = json.loads((out / "report.json").read_text())
    assert [len(row["scale"]) for row in report["droplets"]] == [2, 2]
    sides = np.array([float(row["w"]) for row in rows_of(out)])
    assert ((sides < 25).sum(), (sides > 380).sum(), len(sides)) == (198, 12, 210)


def test_frames_of_a_video_have_one_scale_though_their_droplets_differ(tmp_path: Path) -> None:
    for name, radius, n in (("far", 7, (12, 10)), ("near", 150, (2, 2))):
        ring_image(tmp_path / f"{name}.png", radius, n)
    pages = [cv2.imread(str(tmp_path / f"{name}.png"), 0) for name in ("far", "near")]
    tifffile.imwrite(tmp_path / "pages.tif", np.stack([np.asarray(page) for page in pages]))
    out = tmp_path / "out"
    code, said = detect(
        str(tmp_path / "pages.tif"), "--out", str(out), "--weights", "footage", "--no-shape"
    )
    assert code == 0, said
    scales = {row["scale"] for row in json.loads((out / "report.json").read_text())["droplets"]}
    assert len(scales) == 1


def test_a_folder_and_a_video_are_many_images(sine: Path, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    for name, n in (("b_2.png", 1), ("b_10.png", 0)):
        image_of(folder / name, [(100, 120, 30)] * n, (300, 240))
    out = tmp_path / "out"
    code, said = detect(str(folder), str(sine / "video.avi"), "--out", str(out), "--no-images")
    assert code == 0, said
    rows = rows_of(out)
    assert Path(rows[0]["image"]).name == "b_2.png"
    assert len(rows) == 1 + 12 * 40
    assert {row["frame"] for row in rows[1:]} == {str(n) for n in range(40)}
    assert not (out / "annotated").exists()


def test_images_of_one_name_are_all_annotated(tmp_path: Path) -> None:
    for name in ("x", "y"):
        (tmp_path / name).mkdir()
        image_of(tmp_path / name / "same.png", [(100, 120, 30)], (300, 240))
    code, said = detect(str(tmp_path / "x"), str(tmp_path / "y"), "--out", str(tmp_path / "out"))
    assert code == 0, said
    names = sorted(path.name for path in (tmp_path / "out" / "annotated").iterdir())
    assert names == ["same-2.jpg", "same.jpg"]


@pytest.mark.parametrize("name", [b"tr\xf6pfchen.png", b"two\nlines.png"])
def test_an_image_with_any_name_has_its_droplets(tmp_path: Path, name: bytes) -> None:
    """Of a name that is no UTF-8, OpenCV crashed as it wrote the annotated image."""
    path = Path(os.fsdecode(bytes(tmp_path) + b"/" + name))
    image_of(tmp_path / "a.png", [(100, 120, 30)], (300, 240))
    try:
        (tmp_path / "a.png").rename(path)
    except OSError:
        pytest.skip("this file system has names in UTF-8 only")
    code, said = detect(str(path), "--out", str(tmp_path / "out"))
    assert code == 0, said
    (row,) = rows_of(tmp_path / "out")
    assert row["image"] == str(path).encode("utf-8", "backslashreplace").decode().replace(
        "\n", r"\n"
    )
    assert (tmp_path / "out" / "annotated" / f"{path.stem}.jpg").is_file()


def test_all_black_white_and_tiny_images_have_no_droplets(tmp_path: Path) -> None:
    """Nor do they stop anything: one grey, a single bright pixel, one of 10 px."""
    for name, image in (
        ("black", np.zeros((240, 480), np.uint8)),
        ("white", np.full((240, 480), 255, np.uint8)),
        ("tiny", np.full((10, 10), 128, np.uint8)),
        ("line", np.zeros((1, 40), np.uint8)),
    ):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    code, said = detect(str(tmp_path), "--out", str(tmp_path / "out"))
    assert code == 0, said
    assert rows_of(tmp_path / "out") == []


def test_without_droplets_or_images_it_is_said(tmp_path: Path) -> None:
    image_of(tmp_path / "black.png", [], (200, 150))
    out = tmp_path / "out"
    code, said = detect(str(tmp_path / "black.png"), "--out", str(out))
    assert code == 0
    assert "no whole droplets found" in said
    assert rows_of(out) == []
    (tmp_path / "text.png").write_text("no image")
    for source, problem in (("missing.png", "no such"), ("text.png", "can be decoded")):
        code, said = detect(str(tmp_path / source), "--out", str(tmp_path / "other"))
        assert code == 1
        assert problem in said
        assert not (tmp_path / "other").exists()


def test_droplets_beside_the_region_do_not_count(tmp_path: Path) -> None:
    """Two discs; the polygon has the left one."""
    path, out = tmp_path / "one.png", tmp_path / "out"
    image_of(path, [(100.25, 120, 30), (300, 200.5, 40)], (500, 400))
    code, said = detect(str(path), "--out", str(out), "--region", "0,0 200,0 200,400 0,400")
    assert code == 0, said
    (row,) = rows_of(out)
    assert float(row["x"]) == pytest.approx(100.25, abs=0.05)
    other = str(tmp_path / "other")
    code, said = detect(str(path), "--out", other, "--region", "900,0 950,0 950,40")
    assert code == 1
    assert "no pixel of the 500 x 400 px frames is in it" in said


def test_results_are_overwritten_only_where_they_are_of_the_same_images(tmp_path: Path) -> None:
    one, two, out = tmp_path / "one.png", tmp_path / "two.png", tmp_path / "out"
    image_of(one, [(100.25, 120, 30)], (300, 300))
    image_of(two, [(90, 100, 30), (200, 200, 30)], (300, 300))
    assert detect(str(one), "--out", str(out))[0] == 0
    code, said = detect(str(one), "--out", str(out))
    assert (code, "--overwrite replaces them" in said) == (1, True)
    assert detect(str(one), "--out", str(out), "--overwrite", "--score", "0.5")[0] == 0
    code, said = detect(str(two), "--out", str(out), "--overwrite")
    assert (code, "results of other images" in said) == (1, True)
    assert len(rows_of(out)) == 1


DISCS = [(100.25, 120.0, 30.0), (300.0, 200.5, 40.0)]


def tiff_of(path: Path, pixels_per_um: float) -> None:
    """The two discs as ImageJ writes an image."""
    image_of(path.with_suffix(".png"), DISCS, (500, 400))
    canvas = np.asarray(cv2.imread(str(path.with_suffix(".png")), cv2.IMREAD_GRAYSCALE))
    path.with_suffix(".png").unlink()
    about = {"axes": "YX", "unit": "um"}
    tifffile.imwrite(
        path, canvas, imagej=True, resolution=(pixels_per_um, pixels_per_um), metadata=about
    )


def white_in_the_corner(path: Path) -> int:
    """How long a scale bar is, px: the white of a line near the lower edge, on black."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return int((image[-12] > 200).sum())


def test_sizes_are_in_micrometres_where_a_pixel_is_known(tmp_path: Path) -> None:
    """0.5 um a px, 500 px wide: a bar of 50 um is 100 px long, 101 with its ends."""
    path, out = tmp_path / "one.png", tmp_path / "out"
    image_of(path, DISCS, (500, 400))
    code, said = detect(str(path), "--out", str(out), "--known-length", "0,0,300,400,250")
    assert code == 0, said
    for row in rows_of(out):
        for name, in_um in (("x", 0.5), ("w", 0.5), ("diameter_px", 0.5), ("area_px2", 0.25)):
            other = {"diameter_px": "diameter_um", "area_px2": "area_um2"}.get(name, f"{name}_um")
            assert float(row[other]) == pytest.approx(in_um * float(row[name]), abs=2e-6)
    report = json.loads((out / "report.json").read_text())
    assert report["settings"]["um_per_px"] == 0.5
    for one in (report["summary"], report["droplets"][0]):
        assert one["mean_diameter_um"] == pytest.approx(35, abs=0.02)  # of 30 and 40
        assert one["std_diameter_um"] == pytest.approx(5, abs=0.02)
        assert one["coefficient_of_variation"] == pytest.approx(1 / 7, abs=1e-3)
    assert white_in_the_corner(out / "annotated" / "one.jpg") == pytest.approx(101, abs=3)


def test_each_image_has_the_pixels_that_its_file_says(tmp_path: Path) -> None:
    """The same discs at 0.5 and 0.25 um a px, and in a file that does not say it."""
    tiff_of(tmp_path / "a.tif", 2)
    tiff_of(tmp_path / "b.tif", 4)
    image_of(tmp_path / "c.png", DISCS, (500, 400))
    out = tmp_path / "out"
    images = [str(tmp_path / name) for name in ("c.png", "a.tif", "b.tif")]
    code, said = detect(*images, "--out", str(out), "--backend", "opencv")
    assert code == 0, said
    assert "a.tif: a pixel is 0.5 um wide, as the file says" in said
    assert "b.tif: a pixel is 0.25 um wide" in said
    assert "1 of 3 images do not say how wide a pixel is" in said
    um = [float(row["diameter_um"]) for row in rows_of(out)]
    px = [float(row["diameter_px"]) for row in rows_of(out)]
    np.testing.assert_allclose(um, np.array(px) * np.repeat([np.nan, 0.5, 0.25], 2), atol=2e-6)
    report = json.loads((out / "report.json").read_text())
    assert [row["um_per_px"] for row in report["droplets"]] == [None, 0.5, 0.25]
    summary = report["summary"]
    assert summary["n_images_without_um"] == 1
    assert summary["mean_diameter_um"] == pytest.approx((35 + 17.5) / 2, abs=0.02)
    assert white_in_the_corner(out / "annotated" / "c.jpg") == 0
    # of images of one kind that vary in magnification alone, droplets do not vary more
    other = tmp_path / "other"
    assert detect(*images[1:], "--out", str(other), "--backend", "opencv", "--no-images")[0] == 0
    vary = json.loads((other / "report.json").read_text())["summary"]["coefficient_of_variation"]
    four = np.array([30, 40, 15, 20])
    assert vary == pytest.approx(four.std() / four.mean(), abs=2e-3)


def test_micrometres_are_left_out_where_they_are_not_wanted_and_refused_where_wrong(
    tmp_path: Path,
) -> None:
    tiff_of(tmp_path / "a.tif", 2)
    out = tmp_path / "out"
    code, said = detect(str(tmp_path / "a.tif"), "--out", str(out), "--pixels-only", "--no-images")
    assert code == 0, said
    assert "diameter_um" not in rows_of(out)[0]
    for options, problem in (
        (("--um-per-px", "0"), "--um-per-px 0: should be above 0"),
        (("--um-per-px", "1", "--pixels-only"), "not both"),
        (("--known-length", "5,5,5,5,100"), "the places and the length should be apart"),
    ):
        code, said = detect(str(tmp_path / "a.tif"), "--out", str(tmp_path / "no"), *options)
        assert (code, problem in said) == (1, True)
        assert not (tmp_path / "no").exists()
