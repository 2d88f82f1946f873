"""Outlines of droplets as files: polygons in a Parquet table, or in COCO's JSON.

Corners are in px, where pixel c covers [c, c + 1), as in our tables.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np

from droptrack.data.arrays import Floats, Rows
from droptrack.data.files import replacing
from droptrack.data.formats.tables import ABOUT, parquet_library
from droptrack.errors import DroptrackError

ROWS_AT_ONCE = 5_000  # of a Parquet file


class ContoursFormat(StrEnum):
    """What ``--contours`` takes."""

    parquet = "parquet"
    coco = "coco"

    @property
    def file_name(self) -> str:
        """The file's name in the folder of results."""
        return f"contours.{'json' if self is ContoursFormat.coco else self.value}"


@dataclass(frozen=True, kw_only=True)
class Contours:
    """The outlines of M droplets of one image.

    image: its name, and frame its number there; size: width and height, px; ids (M,): of the
    droplets; points (M, K, 2): corners, px; boxes (M, 4), areas (M,) px², scores (M,), class_ids
    (M,): as in the table of results.
    """

    image: str
    frame: int
    size: tuple[int, int]
    ids: Rows
    points: Floats
    boxes: Floats
    areas: Floats
    scores: Floats
    class_ids: Rows


def check_contours(kind: ContoursFormat | None, *, shape: bool) -> None:
    """Raise DroptrackError where outlines could not be written: of a wish, and what is measured."""
    if kind is not None and not shape:
        raise DroptrackError(f"--contours {kind}: needs outlines, which --no-shape leaves out")
    if kind is ContoursFormat.parquet:
        parquet_library()


class ContourWriter(Protocol):
    """Takes the outlines of one image after the other."""

    def write(self, found: Contours) -> None:
        """Append the outlines of an image."""


@dataclass(frozen=True, kw_only=True)
class ContourFile:
    """Where outlines go, and what is said there: `id_name` of `Contours.ids`, and classes' names.

    `images`: whether they are of images with names, not of the frames of one video.
    """

    folder: Path
    kind: ContoursFormat
    about: dict[str, object]
    id_name: str
    classes: tuple[str, ...] = ()
    images: bool = False

    @contextmanager
    def open(self) -> Iterator[ContourWriter]:
        """A writer; the file is there once all is written."""
        with replacing(self.folder / self.kind.file_name) as partial:
            if self.kind is ContoursFormat.parquet:
                with _parquet(partial, self) as writer:
                    yield writer
            else:
                with partial.open("w", encoding="utf-8") as file, _coco(file, self) as coco:
                    yield coco


class _ParquetWriter:
    """A row an outline: image, frame, identity, x and y, lists of as many numbers."""

    def __init__(self, path: Path, about: ContourFile) -> None:
        self._arrow = arrow = parquet_library()
        numbers = arrow.list_(arrow.float32())
        columns = [("frame", arrow.int64()), (about.id_name, arrow.int64())]
        columns += [("class_id", arrow.int64())] * bool(about.classes)
        named = [("image", arrow.string())] * about.images
        schema = arrow.schema([*named, *columns, ("x", numbers), ("y", numbers)])
        said = {ABOUT: json.dumps(about.about).encode()}
        self._names = schema.names
        self._held: dict[str, list[Any]] = {name: [] for name in self._names}
        self._id_name = about.id_name
        self._file = arrow.parquet.ParquetWriter(path, schema.with_metadata(said))

    def write(self, found: Contours) -> None:
        m = len(found.ids)
        values = {
            "image": [found.image] * m,
            "frame": [found.frame] * m,
            self._id_name: found.ids.tolist(),
            "class_id": found.class_ids.tolist(),
            "x": list(found.points[..., 0].astype(np.float32)),
            "y": list(found.points[..., 1].astype(np.float32)),
        }
        for name in self._names:
            self._held[name] += values[name]
        if len(self._held["frame"]) >= ROWS_AT_ONCE:
            self._flush()

    def _flush(self) -> None:
        self._file.write_table(self._arrow.table(self._held, schema=self._file.schema))
        self._held = {name: [] for name in self._names}

    def close(self) -> None:
        self._flush()
        self._file.close()


@contextmanager
def _parquet(path: Path, about: ContourFile) -> Iterator[_ParquetWriter]:
    writer = _ParquetWriter(path, about)
    try:
        yield writer
    finally:
        writer.close()


class _CocoWriter:
    """An annotation an outline, written at once; the images after all of them."""

    def __init__(self, file: TextIO, about: ContourFile) -> None:
        self._file, self._about = file, about
        self._images: list[dict[str, object]] = []
        self._n = 0
        classes = about.classes or ("droplet",)
        head = {
            "info": {"description": {name: str(value) for name, value in about.about.items()}},
            "categories": [{"id": k + 1, "name": name} for k, name in enumerate(classes)],
        }
        file.write(json.dumps(head)[:-1] + ', "annotations": [')

    def write(self, found: Contours) -> None:
        width, height = found.size
        image = len(self._images) + 1
        named = {"id": image, "file_name": found.image, "width": width, "height": height}
        self._images.append({**named, "frame": found.frame})
        low = found.boxes[:, :2] - found.boxes[:, 2:] / 2
        for k, points in enumerate(found.points):
            self._n += 1
            annotation = {
                **{"id": self._n, "image_id": image, "iscrowd": 0},
                "category_id": int(found.class_ids[k]) + 1,
                "segmentation": [points.round(3).ravel().tolist()],
                "bbox": [*low[k].round(6).tolist(), *found.boxes[k, 2:].round(6).tolist()],
                "area": round(float(found.areas[k]), 6),
                self._about.id_name: int(found.ids[k]),
                "score": round(float(found.scores[k]), 6),
            }
            self._file.write(("" if self._n == 1 else ",") + "\n" + json.dumps(annotation))

    def close(self) -> None:
        self._file.write('\n], "images": ' + json.dumps(self._images) + "}\n")


@contextmanager
def _coco(file: TextIO, about: ContourFile) -> Iterator[_CocoWriter]:
    writer = _CocoWriter(file, about)
    yield writer
    writer.close()
