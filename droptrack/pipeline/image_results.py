"""The table, the annotated images and the report of single images, filled image by image."""

import csv
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import Detections
from droptrack.data.field_stop import find_field_stop
from droptrack.data.formats.contours import Contours, ContourWriter
from droptrack.data.frames import Frame
from droptrack.data.region import Region
from droptrack.data.report import Report, Value
from droptrack.data.sources.image_files import write_image_file
from droptrack.data.sources.opencv_names import printable
from droptrack.data.units import Units
from droptrack.data.video import IMAGE_SUFFIXES
from droptrack.measurement.droplets import Measured, at_edge, measure_droplets
from droptrack.measurement.shapes import AREA, AT_EDGE, DIAMETER
from droptrack.measurement.shapes import COLUMNS as SHAPE
from droptrack.pipeline.classes import CLASS_NAME, Classes
from droptrack.pipeline.drawing import draw_boxes, draw_scale_bar

COLUMNS = (
    *("image", "frame", "x", "y", "w", "h", "score", "class_id", "at_edge"),
    *("box_x", "box_y", "centre_of_mass"),
)
PLACES = ("x", "y", "w", "h", "box_x", "box_y")


@dataclass(frozen=True, kw_only=True)
class Image:
    """One image: the file it comes from, its number there (from 0), and its pixels (H, W, 3).

    `um_per_px`: how wide a pixel is; None where nobody says it. `is_alone`: in its file.
    """

    source: Path
    number: int
    frame: Frame
    um_per_px: float | None
    is_alone: bool

    @property
    def stem(self) -> str:
        """A name for files about it."""
        is_video = self.source.suffix.lower() not in IMAGE_SUFFIXES
        return f"{self.source.stem}_{self.number:06d}" if is_video else self.source.stem


@dataclass(frozen=True, kw_only=True)
class Content:
    """What a table has beside its fixed columns.

    Outlines' sizes (`shape`), micrometres (`um`), and classes, where a network tells any.
    """

    shape: bool
    um: bool
    classes: Classes | None = None

    @property
    def um_columns(self) -> tuple[str, ...]:
        """The names of the columns in micrometres."""
        names = Units(um_per_px=1.0).names(PLACES + SHAPE[:AT_EDGE] * self.shape)
        return names * self.um

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of all columns."""
        further = SHAPE[:AT_EDGE] * self.shape + self.um_columns
        return COLUMNS + further + (CLASS_NAME,) * (self.classes is not None)


class ImageResults:
    """The table and the annotated images, filled image by image, and what is said of them."""

    def __init__(
        self,
        annotated: Path | None,
        table: TextIO,
        content: Content,
        contours: ContourWriter | None,
    ) -> None:
        self._content, self._contours = content, contours
        self._n_droplets = self._n_rings = 0
        self._class_ids: list[int] = []  # of droplets that no edge cuts
        self.diameters: list[float] = []  # of droplets that no edge cuts, px
        self.diameters_um: list[float] = []  # of those of them whose pixels have a known size
        self._annotated, self._names = annotated, Counter[str]()
        self._rows: list[dict[str, Value]] = []
        self._writer = csv.writer(table, lineterminator="\n")
        self._writer.writerow(content.columns)
        if annotated is not None:
            annotated.mkdir(exist_ok=True)

    def add(
        self, image: Image, found: Detections, seen: Mapping[str, Value], region: Region | None
    ) -> None:
        """Take the droplets of the next image.

        `seen`: what the network was shown of it, for the report; `region`: where droplets count.
        """
        content = self._content
        if region is None and (stop := find_field_stop([image.frame])):
            region = stop.region
        measured = measure_droplets(image.frame, found.boxes, shape=content.shape, region=region)
        if content.shape:
            cut, diameters = measured.shapes[:, AT_EDGE] == 1, measured.shapes[:, DIAMETER]
            diameters = diameters[np.isfinite(diameters)]
        else:
            cut = at_edge(found.boxes, (image.frame.shape[1], image.frame.shape[0]), region)
            diameters = np.sqrt(found.boxes[~cut, 2:].prod(axis=1))
        order = np.argsort(found.boxes[:, 0], kind="stable")  # from the left to the right
        self._writer.writerows(_table(image, found, measured, cut, order, content))
        if self._contours is not None:
            self._contours.write(_contours(image, found, measured, order, self._n_droplets))
        self._n_droplets += len(found)
        self._n_rings += int(measured.rings.sum())
        self.diameters += diameters.tolist()
        self._class_ids += found.class_ids[~cut].tolist()
        row: dict[str, Value] = {
            "image": printable(str(image.source)),
            "frame": image.number,
            "n_droplets": len(found),
            "n_at_edge": int(cut.sum()),
            **seen,
        }
        if content.um:
            diameters_um = diameters * (image.um_per_px or np.nan)
            self.diameters_um += diameters_um[np.isfinite(diameters_um)].tolist()
            row |= {"um_per_px": image.um_per_px, **_sizes(diameters_um, "um")}
        self._rows.append(row | _sizes(diameters, "px"))
        if self._annotated is not None:
            self._write_annotated(self._annotated, image, found)

    @property
    def n_images(self) -> int:
        """Images so far."""
        return len(self._rows)

    @property
    def n_without_um(self) -> int:
        """Images of whose pixels nobody says the size, though the table has micrometres."""
        return sum("um_per_px" in row and row["um_per_px"] is None for row in self._rows)

    def report(self, settings: dict[str, Value], seconds: float) -> Report:
        """One row an image, and the sizes of all droplets."""
        classes, sizes = self._content.classes, _sizes(np.array(self.diameters), "px")
        if self._content.um:
            sizes_um = _sizes(np.array(self.diameters_um), "um")
            # of images of several magnifications, only micrometres say how much droplets vary
            sizes = sizes_um | sizes if self.n_without_um else sizes | sizes_um
            sizes["n_images_without_um"] = self.n_without_um
        summary: dict[str, Value] = {
            "n_images": self.n_images,
            "n_droplets": self._n_droplets,
            "n_at_edge": sum(int(str(row["n_at_edge"])) for row in self._rows),
            **sizes,
            **({"n_sizes_of_rings": self._n_rings} if self._content.shape else {}),
            **(classes.counts(self._class_ids) if classes else {}),
            "seconds": seconds,
        }
        return Report("Images", settings, summary, self._rows)

    def _write_annotated(self, folder: Path, image: Image, found: Detections) -> None:
        """Images of one name, as in several folders, are numbered."""
        self._names[image.stem] += 1
        n = self._names[image.stem]
        path = folder / f"{image.stem}{f'-{n}' if n > 1 else ''}.jpg"
        names = self._content.classes.names if self._content.classes else ()
        drawn = draw_boxes(image.frame, found, names)
        if image.um_per_px is not None:
            draw_scale_bar(drawn, image.um_per_px)
        write_image_file(path, drawn)


def _contours(
    image: Image, found: Detections, measured: Measured, order: Rows, n_before: int
) -> Contours:
    """Of droplets with an outline; their identities are the rows of the table, from 0."""
    seen = np.isfinite(measured.outlines[order]).all(axis=(1, 2))
    some = order[seen]
    return Contours(
        image=printable(str(image.source)),
        frame=image.number,
        size=(image.frame.shape[1], image.frame.shape[0]),
        ids=n_before + np.flatnonzero(seen),
        points=measured.outlines[some],
        boxes=measured.boxes[some],
        areas=measured.shapes[some, AREA],
        scores=found.scores[some],
        class_ids=found.class_ids[some],
    )


def _table(
    image: Image, found: Detections, measured: Measured, cut: Bools, order: Rows, content: Content
) -> Iterator[list[object]]:
    """One row a droplet, in this order."""
    boxes, shapes = measured.boxes, measured.shapes[:, :AT_EDGE]
    places = np.hstack([measured.centres, boxes[:, 2:], boxes[:, :2]])  # as PLACES
    in_um = np.full((len(found), len(content.um_columns)), np.nan)
    if content.um and image.um_per_px is not None:
        names = PLACES + SHAPE[:AT_EDGE] * content.shape
        columns = dict(zip(names, np.hstack([places, shapes]).T, strict=True))
        in_um = np.column_stack(list(Units(um_per_px=image.um_per_px).further(columns).values()))
    for i in order.tolist():
        x, y, w, h, box_x, box_y = _text(places[i])
        score, class_id = f"{found.scores[i]:.6f}", int(found.class_ids[i])
        source = printable(str(image.source))
        row = [source, image.number, x, y, w, h, score, class_id, int(cut[i])]
        sizes = [*_text(shapes[i]), *_text(in_um[i])]
        named = [content.classes.name_of(class_id)] if content.classes is not None else []
        yield [*row, box_x, box_y, int(measured.measured[i]), *sizes, *named]


def _text(values: Floats) -> list[str]:
    return [f"{value:.6f}" for value in values.tolist()]


def _sizes(diameters: Floats, unit: str) -> dict[str, Value]:
    """What is said of diameters (N,) in px or um; NaN without any."""
    some = diameters if len(diameters) else np.array([np.nan])
    mean, deviation = float(some.mean()), float(some.std())
    return {
        f"mean_diameter_{unit}": mean,
        f"std_diameter_{unit}": deviation,
        "coefficient_of_variation": deviation / mean,
    }
