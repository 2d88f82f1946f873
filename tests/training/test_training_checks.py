"""Each mistake that would end a training hours after its start, made on purpose."""

from collections.abc import Callable
from pathlib import Path

import pytest

from droptrack.data.darknet_dataset import DataSet
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, parse_cfg, with_options
from droptrack.training.checks import (
    check_for_darknet,
    check_for_torch,
    check_images,
    check_network,
)

MINI = Path(__file__).parents[1] / "reference" / "mini.cfg"


@pytest.fixture
def data(tmp_path: Path) -> DataSet:
    """Three images, whose labels are as they should be."""
    images = [tmp_path / f"{i}.jpg" for i in range(3)]
    for image in images:
        image.write_bytes(b"image")
        image.with_suffix(".txt").write_text("0 0.5 0.5 0.1 0.2\n\n0 0.25 0.5 0.1 0.2\n")
    return DataSet(tmp_path / "obj.data", ("droplet",), tuple(images[:2]), (images[2],))


def cfg(change: Callable[[str], str] = str) -> Cfg:
    return parse_cfg(change(MINI.read_text()), Path("mini.cfg"))


def test_what_is_right_passes(data: DataSet, tmp_path: Path) -> None:
    check_network(cfg(), data)
    check_images(cfg(), data)
    check_for_darknet(cfg(), data, tmp_path)
    data.train[0].with_suffix(".txt").write_text("")  # an image without droplets
    check_images(cfg(), data)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("batch=8", "batch=1", r"mini\.cfg:1: batch=1 trains nothing"),
        ("subdivisions=2", "subdivisions=3", r"mini\.cfg:1: subdivisions=3 should divide batch=8"),
        ("batch=8", "batch=8\nletter_box=1", r"mini\.cfg:1: letter_box=1 .* set letter_box=0"),
        ("scales=.1,.1", "scales=.1", r"mini\.cfg:1: steps= and scales="),
        ("max_batches=310", "", r"mini\.cfg:1: max_batches="),
    ],
)
def test_a_cfg_that_cannot_be_trained(data: DataSet, old: str, new: str, message: str) -> None:
    with pytest.raises(DroptrackError, match=message):
        check_network(cfg(lambda text: text.replace(old, new)), data)


@pytest.mark.parametrize(
    ("where", "line", "message"),
    [
        ("[net]", "mosaic=1", r"mini\.cfg:1: mosaic=1 is only for Darknet; set mosaic=0"),
        ("[net]", "policy=cosine", "policy=cosine is only for Darknet"),
        ("[yolo]", "iou_loss=ciou", r"mini\.cfg:\d\d: iou_loss=ciou is only for Darknet"),
        ("[yolo]", "scale_x_y=1.05", r"scale_x_y=1\.05 is only for Darknet"),
    ],
)
def test_what_only_darknet_can_do_is_not_passed_over(where: str, line: str, message: str) -> None:
    text = MINI.read_text().replace("policy=steps\n", "")
    with pytest.raises(DroptrackError, match=message):
        check_for_torch(parse_cfg(text.replace(where, f"{where}\n{line}"), Path("mini.cfg")))
    check_for_torch(parse_cfg(text.replace(where, f"{where}\nmosaic=0.0"), Path("mini.cfg")))


def test_a_cfg_of_other_classes_names_the_filters_it_needs(data: DataSet) -> None:
    two = DataSet(data.path, ("droplet", "bubble"), data.train, data.valid)
    with pytest.raises(
        DroptrackError, match=r"mini\.cfg:\d+: classes=1, but .*obj\.data has 2; .* filters=21 in"
    ):
        check_network(cfg(), two)


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ("0 0.5 0.5 0.1 0.1\n\n1 0.5 0.5 0.1 0.1", r"1\.txt:3: has class 1, but .* 0 to 0"),
        ("0 0.5 0.5 0.1 0.1\n0 0.5 0.5 0 0.1", r"1\.txt:2: a box needs a centre, a width"),
        ("0 0.5 0.5 0.1 0.1\n\n0 0.5 1.5 0.1 0.1", r"1\.txt:3: coordinates should lie between"),
        ("0 0.5 0.5 0.1 0.1\n0 0.5 0.5 0.1", r"1\.txt:2: each line should be"),
        ("0 0.5 0.5 0.1 wide", r"1\.txt:1: each line should be"),
        ("0 0.5 0.5 0.1 0.1\n" * 201, r"mini\.cfg:70: max=200, but .*1\.txt has 201 boxes"),
    ],
)
def test_labels_that_cannot_be_learnt(data: DataSet, labels: str, message: str) -> None:
    data.train[1].with_suffix(".txt").write_text(labels)
    with pytest.raises(DroptrackError, match=message):
        check_images(cfg(), data)


def test_images_and_labels_that_are_missing(data: DataSet) -> None:
    data.valid[0].with_suffix(".txt").unlink()
    with pytest.raises(DroptrackError, match=r"2\.txt: missing; .* an empty file"):
        check_images(cfg(), data)
    data.train[0].unlink()
    with pytest.raises(DroptrackError, match=r"0\.jpg: no such image"):
        check_images(cfg(), data)


def test_names_that_darknet_misreads(data: DataSet, tmp_path: Path) -> None:
    def check(name: str, *images: Path) -> None:
        renamed = Cfg(Path(name), cfg().net, cfg().layers)
        check_for_darknet(renamed, DataSet(data.path, data.names, images, images), tmp_path)

    with pytest.raises(DroptrackError, match="cuts names at the first dot"):
        check("mini.v2.cfg", *data.train)
    with pytest.raises(DroptrackError, match="labels/; rename the folder"):
        check("mini.cfg", tmp_path / "JPEGImages" / "0.jpg")
    with pytest.raises(DroptrackError, match="does not find the labels"):
        check("mini.cfg", tmp_path / "0.webp")
    with pytest.raises(DroptrackError, match="twice for validation"):
        check("mini.cfg", data.train[0], data.train[0])


def test_a_disk_too_small(data: DataSet, tmp_path: Path) -> None:
    """A million million iterations would write a petabyte of log."""
    long = with_options(cfg(), {"max_batches": str(10**12)}, {})
    with pytest.raises(DroptrackError, match=r"GB free, the training writes up to \d+"):
        check_for_darknet(long, data, tmp_path)
