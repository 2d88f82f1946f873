"""A Darknet data set: images with label files beside them, two lists, obj.names and obj.data.

A label file has the image's stem and one line an object, ``class x_center y_center width height``,
relative to the image. Paths in the lists are relative to the folder of ``obj.data``, where Darknet
is to be started.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from droptrack.data.detections import Detections
from droptrack.data.files import read_text, reading, write_text
from droptrack.data.frames import Frame, as_frame
from droptrack.data.sources.image_sequences import read_image_file
from droptrack.errors import DroptrackError

MAX_CLASS = 10_000


@dataclass(frozen=True)
class DataSet:
    """The images of a data set and the names of its classes."""

    path: Path  # of obj.data
    names: tuple[str, ...]
    train: tuple[Path, ...]
    valid: tuple[Path, ...]


def read_data_file(path: Path) -> DataSet:
    """Read ``obj.data`` and the lists it names; raises DroptrackError for what is missing."""
    options = _read_options(path)
    for key in ("classes", "train", "names"):
        if key not in options:
            raise DroptrackError(f"{path}: has no line {key} = ...")
    names = _read_names(_resolve(path, options["names"]))
    if str(len(names)) != options["classes"]:
        raise DroptrackError(
            f"{path}: classes = {options['classes']}, but {options['names']} has {len(names)} names"
        )
    train = _read_list(path, options["train"])
    valid = _read_list(path, options["valid"]) if "valid" in options else train
    return DataSet(path, names, train, valid)


def read_names(path: Path) -> tuple[str, ...]:
    """The names of classes: of a file with a line a class, or of the one that obj.data names.

    Raises DroptrackError for a file that is missing, or names none.
    """
    if path.suffix == ".data":
        options = _read_options(path)
        if "names" not in options:
            raise DroptrackError(f"{path}: has no line names = ...")
        path = _resolve(path, options["names"])
    names = _read_names(path)
    if not names:
        raise DroptrackError(f"{path}: names no class")
    return names


def read_image(path: Path) -> NDArray[np.uint8]:
    """One image as (H, W, 3) uint8 BGR; raises DroptrackError if it cannot be read."""
    return np.ascontiguousarray(read_frame(path))


def read_frame(path: Path) -> Frame:
    """The same, where the three channels of a grey image are one in memory (`grey_plane`)."""
    if not path.exists():
        raise DroptrackError(f"{path}: no such image")
    with reading(path, "an image"):
        image = read_image_file(path)
    if image is None:
        raise DroptrackError(f"{path}: cannot be decoded as an image")
    return as_frame(image)


def read_labels(image: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Class ids (N,) and relative boxes (N, 4) of an image's objects, from the file beside it."""
    path = image.with_suffix(".txt")
    text = read_text(path)
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            row = [float(part) for part in line.split()]
        except ValueError:
            row = []
        if len(row) != 5:
            raise DroptrackError(f"{path}:{number}: each line should be: class x y width height")
        if not (0 <= row[0] <= MAX_CLASS and row[0] == int(row[0])):
            raise DroptrackError(f"{path}:{number}: has class {row[0]:g}; classes are 0, 1, 2, ...")
        if not all(0 <= value <= 1 for value in row[1:]):
            raise DroptrackError(f"{path}:{number}: coordinates should lie between 0 and 1")
        if not (row[3] > 0 and row[4] > 0):
            raise DroptrackError(
                f"{path}:{number}: a box needs a centre, a width and a height above 0; delete the "
                "line"
            )
        rows.append(row)
    table = np.array(rows).reshape(-1, 5)
    return table[:, 0].astype(np.int64), table[:, 1:]


def read_ground_truth(image: Path, width: int, height: int) -> Detections:
    """The labels of an image of the given size, in px."""
    class_ids, boxes_relative = read_labels(image)
    boxes = boxes_relative * np.array([width, height, width, height], float)
    return Detections(boxes, np.ones(len(boxes)), class_ids)


def label_text(boxes: NDArray[np.float64], width: int, height: int) -> str:
    """Boxes (N, 4) px of class 0 as the text of a label file."""
    relative = boxes / [width, height, width, height]
    return "".join(f"0 {x:.8f} {y:.8f} {w:.8f} {h:.8f}\n" for x, y, w, h in relative.tolist())


def write_data_file(folder: Path, names: tuple[str, ...], counts: dict[str, int]) -> Path:
    """Write ``obj.data``, ``obj.names`` and the lists for images <split>/000000.jpg and on.

    `counts` has the number of images of each split, train and valid. Returns the path of obj.data.
    """
    lines = [f"classes = {len(names)}"]
    for split, count in counts.items():
        listing = "".join(f"{image_name(split, index)}\n" for index in range(count))
        write_text(folder / f"{split}.txt", listing)
        lines.append(f"{split} = {split}.txt")
    lines += ["names = obj.names", "backup = backup"]
    (folder / "backup").mkdir(exist_ok=True)  # Darknet stops where it is missing
    write_text(folder / "obj.names", "".join(f"{name}\n" for name in names))
    write_text(folder / "obj.data", "".join(f"{line}\n" for line in lines))
    return folder / "obj.data"


def write_scenes(folder: Path, scenes: Mapping[str, str]) -> None:
    """Write which scene each image shows, by its path relative to the folder, to scenes.txt."""
    write_text(folder / "scenes.txt", "".join(f"{n} {scene}\n" for n, scene in scenes.items()))


def read_scenes(data: DataSet) -> dict[Path, str]:
    """The scene of each image, as scenes.txt beside obj.data has it; empty without one."""
    path = data.path.parent / "scenes.txt"
    if not path.exists():
        return {}
    lines = (line.rpartition(" ") for line in read_text(path).splitlines())
    return {path.parent / name: scene for name, _, scene in lines}


def image_name(split: str, index: int) -> str:
    """The path of an image, relative to the data set's folder."""
    return f"{split}/{index:06d}.jpg"


def _read_options(path: Path) -> dict[str, str]:
    """The lines ``key = value`` of obj.data."""
    options = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        key, equals, value = line.partition("=")
        if not equals:
            raise DroptrackError(f"{path}:{number}: expected key = value, found {line!r}")
        if key.strip() in options:
            raise DroptrackError(f"{path}:{number}: {key.strip()} is given twice")
        options[key.strip()] = value.strip()
    return options


def _read_names(path: Path) -> tuple[str, ...]:
    lines = read_text(path).split("\n")
    return tuple(line.strip() for line in lines if line.strip())


def _read_list(data_file: Path, name: str) -> tuple[Path, ...]:
    listing = _resolve(data_file, name)
    images = tuple(
        _resolve(listing, line.strip()) for line in read_text(listing).splitlines() if line.strip()
    )
    if not images:
        raise DroptrackError(f"{listing}: lists no image")
    return images


def _resolve(file: Path, name: str) -> Path:
    """A path as written in a file: relative to the file's folder, or to the current one."""
    beside = file.parent / name
    return beside if Path(name).is_absolute() or beside.exists() else Path(name)
