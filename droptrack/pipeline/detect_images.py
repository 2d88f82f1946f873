"""Images in; a table of their droplets, annotated images, counts and sizes out. No tracking."""

import csv
import functools
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TextIO

import numpy as np
import PIL.Image

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.detections import Detections
from droptrack.data.field_stop import find_field_stop
from droptrack.data.files import replacing
from droptrack.data.formats.contours import (
    ContourFile,
    Contours,
    ContourWriter,
    check_contours,
)
from droptrack.data.frames import Frame
from droptrack.data.region import Region
from droptrack.data.report import Report, Value
from droptrack.data.samples import N_SAMPLES, sample_frames, spread
from droptrack.data.sources.image_files import write_image_file
from droptrack.data.sources.opencv_names import printable
from droptrack.data.video import IMAGE_SUFFIXES, ReadOptions, Video, image_files
from droptrack.detection.normalisation import normalisation_for
from droptrack.errors import DroptrackError
from droptrack.measurement.droplets import Measured, at_edge, measure_droplets
from droptrack.measurement.shapes import AREA, AT_EDGE, DIAMETER
from droptrack.measurement.shapes import COLUMNS as SHAPE
from droptrack.network.bundled import find_network
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.classes import CLASS_NAME, Classes, classes_of
from droptrack.pipeline.config import ImagesConfig
from droptrack.pipeline.drawing import draw_boxes
from droptrack.pipeline.notes import Say, to_stderr
from droptrack.pipeline.open_detector import OpenedDetector, open_detector
from droptrack.pipeline.results_folder import has_content, whole_name
from droptrack.progress import progress_bar
from droptrack.version import __version__

COLUMNS = (
    *("image", "frame", "x", "y", "w", "h", "score", "class_id", "at_edge"),
    *("box_x", "box_y", "centre_of_mass"),
)


Normalise = Callable[[Frame], tuple[Frame, str]]  # an image -> what is shown of it, and how


@dataclass(frozen=True)
class Image:
    """One image: the file it comes from, its number there (from 0), and its pixels (H, W, 3)."""

    source: Path
    number: int
    frame: Frame

    @property
    def stem(self) -> str:
        """A name for files about it."""
        is_video = self.source.suffix.lower() not in IMAGE_SUFFIXES
        return f"{self.source.stem}_{self.number:06d}" if is_video else self.source.stem


@dataclass(frozen=True)
class ImagesRun:
    """What a run left: its folder, which has ``detections.csv``, and its report."""

    folder: Path
    report: Report


def detect_images(
    config: ImagesConfig, say: Say = to_stderr, *, progress: bool = True
) -> ImagesRun:
    """Find the droplets of images, folders of images, and videos; images may differ in size.

    Raises DroptrackError for a source that cannot be read.
    """
    began = time.perf_counter()
    check_contours(config.contours, shape=config.shape)
    detectors: dict[tuple[int, int], OpenedDetector] = {}
    normalise = _normalised if config.normalises else _as_it_is  # each image by its own contrast
    of_detector = replace(config, normalise=False)
    images = read_images(config.sources, config.reading)
    first = next(images)  # what cannot be opened is refused before anything is written
    cfg, _ = find_network(config.weights, config.cfg)
    classes = classes_of(cfg, config.names, config.cells)
    _refuse_other_results(config)
    config.out.mkdir(parents=True, exist_ok=True)
    with (
        _contour_writer(config, classes) as contours,
        replacing(config.out / "detections.csv") as partial,
        partial.open("w", newline="", encoding="utf-8") as file,
        progress_bar("images", shown=progress) as bar,
    ):
        annotated = config.out / "annotated" if config.annotated else None
        results = _Results(annotated, file, classes, contours, shape=config.shape)
        for image in bar.track(chain([first], images), description="detecting"):
            size = (image.frame.shape[1], image.frame.shape[0])
            if size not in detectors:
                samples = functools.partial(_samples, config, image, normalise)
                detectors[size] = open_detector(of_detector, size, samples, live=False, say=say)
            seen, how = normalise(image.frame)
            (found,) = detectors[size].detector.detect([seen])
            results.add(image, found, how, detectors[size].region)
    settings = _settings(config, detectors) | (classes.settings() if classes else {})
    report = results.report(settings, seconds=time.perf_counter() - began)
    report.write_json(config.out / "report.json")
    if results.diameters:
        from droptrack.pipeline.plots import plot_sizes

        plot_sizes(config.out / "sizes.png", results.diameters)
    else:
        say("no whole droplets found; --scale, --diameter or --score may help")
    return ImagesRun(config.out, report)


def _refuse_other_results(config: ImagesConfig) -> None:
    """Raise DroptrackError where the folder has results that would be lost."""
    if not has_content(config.out / "detections.csv"):
        return
    try:
        before = json.loads((config.out / "report.json").read_text(encoding="utf-8"))
        sources = before["settings"]["sources"]
    except (OSError, ValueError, KeyError, TypeError):
        sources = None
    if sources != _sources(config):
        raise DroptrackError(
            f"{config.out}: would be overwritten; it has results of other images; choose another "
            "--out"
        )
    if not config.overwrite:
        raise DroptrackError(
            f"{config.out}: has results of these images already; --overwrite replaces them, --out "
            "puts the new ones elsewhere"
        )


def _sources(config: ImagesConfig) -> list[str]:
    return [whole_name(source) for source in config.sources]


class _Results:
    """The table and the annotated images, filled image by image, and what is said of them."""

    def __init__(
        self,
        annotated: Path | None,
        table: TextIO,
        classes: Classes | None,
        contours: ContourWriter | None,
        *,
        shape: bool,
    ) -> None:
        self._shape, self._classes, self._contours = shape, classes, contours
        self._n_droplets = 0
        self._class_ids: list[int] = []  # of droplets that no edge cuts
        self.diameters: list[float] = []  # of droplets that no edge cuts, px
        self._annotated, self._names = annotated, Counter[str]()
        self._rows: list[dict[str, Value]] = []
        self._writer = csv.writer(table, lineterminator="\n")
        further = SHAPE[:AT_EDGE] * shape + (CLASS_NAME,) * (classes is not None)
        self._writer.writerow(COLUMNS + further)
        if annotated is not None:
            annotated.mkdir(exist_ok=True)

    def add(self, image: Image, found: Detections, seen: str, region: Region | None) -> None:
        """Take the droplets of the next image.

        `seen`: what the network was shown of it; `region`: where droplets count.
        """
        if region is None and (stop := find_field_stop([image.frame])):
            region = stop.region
        measured = measure_droplets(image.frame, found.boxes, shape=self._shape, region=region)
        if self._shape:
            cut, diameters = measured.shapes[:, AT_EDGE] == 1, measured.shapes[:, DIAMETER]
            diameters = diameters[np.isfinite(diameters)]
        else:
            cut = at_edge(found.boxes, (image.frame.shape[1], image.frame.shape[0]), region)
            diameters = np.sqrt(found.boxes[~cut, 2:].prod(axis=1))
        order = np.argsort(found.boxes[:, 0], kind="stable")  # from the left to the right
        self._writer.writerows(_table(image, found, measured, cut, order, self._classes))
        if self._contours is not None:
            self._contours.write(_contours(image, found, measured, order, self._n_droplets))
        self._n_droplets += len(found)
        self.diameters += diameters.tolist()
        self._class_ids += found.class_ids[~cut].tolist()
        self._rows.append(
            {
                "image": printable(str(image.source)),
                "frame": image.number,
                "n_droplets": len(found),
                "n_at_edge": int(cut.sum()),
                "network_sees": seen,
                **_sizes(diameters),
            }
        )
        if self._annotated is not None:
            self._write_annotated(self._annotated, image, found)

    def report(self, settings: dict[str, Value], seconds: float) -> Report:
        """One row an image, and the sizes of all droplets."""
        summary: dict[str, Value] = {
            "n_images": len(self._rows),
            "n_droplets": self._n_droplets,
            "n_at_edge": sum(int(str(row["n_at_edge"])) for row in self._rows),
            **_sizes(np.array(self.diameters)),
            **(self._classes.counts(self._class_ids) if self._classes else {}),
            "seconds": seconds,
        }
        return Report("Images", settings, summary, self._rows)

    def _write_annotated(self, folder: Path, image: Image, found: Detections) -> None:
        """Images of one name, as in several folders, are numbered."""
        self._names[image.stem] += 1
        n = self._names[image.stem]
        path = folder / f"{image.stem}{f'-{n}' if n > 1 else ''}.jpg"
        names = self._classes.names if self._classes else ()
        write_image_file(path, draw_boxes(image.frame, found, names))


def read_images(sources: tuple[str, ...], reading: ReadOptions) -> Iterator[Image]:
    """Every image of the sources. Raises DroptrackError for what cannot be read, or holds none."""
    n = 0
    for file in _files(sources):
        for number, frame in Video(str(file), reading).numbered():
            yield Image(file, number, frame)
            n += 1
    if not n:
        raise DroptrackError("name an image, a folder of images, or a video")


def _files(sources: tuple[str, ...]) -> Iterator[Path]:
    """The images and videos that sources name."""
    for source in sources:
        path = Path(source)
        files = image_files(path) if path.is_dir() else [path]
        if path.is_dir() and not files:
            raise DroptrackError(f"{path}: has no images")
        yield from files


def _normalised(frame: Frame) -> tuple[Frame, str]:
    """An image as the network is to see it, and how it differs."""
    normalisation = normalisation_for([frame])
    return normalisation.shown(frame), str(normalisation)


def _as_it_is(frame: Frame) -> tuple[Frame, str]:
    return frame, ""


def _samples(config: ImagesConfig, like: Image, normalise: Normalise) -> list[Frame]:
    """Some frames of an image's video; or some of all images of its size, that one first."""
    video = Video(str(like.source), config.reading)
    if like.source.suffix.lower() not in IMAGE_SUFFIXES or video.info.n_frames > 1:
        return [normalise(frame)[0] for frame in sample_frames(video, N_SAMPLES)]
    size = like.frame.shape[1::-1]
    files = [file for file in _files(config.sources) if file.suffix.lower() in IMAGE_SUFFIXES]
    alike = [file for file in files if file != like.source and _image_size(file) == size]
    others = [alike[number] for number in spread(len(alike), N_SAMPLES - 1)]
    frames = [like.frame, *(Video(str(file), config.reading).samples()[0] for file in others)]
    return [normalise(frame)[0] for frame in frames if frame.shape == like.frame.shape]


def _image_size(path: Path) -> tuple[int, int] | None:
    """Width and height of an image, from its first bytes; None where they do not say."""
    try:
        with PIL.Image.open(path) as image:
            return image.size
    except (OSError, ValueError, SyntaxError, PIL.Image.DecompressionBombError):
        return None


def _contour_writer(
    config: ImagesConfig, classes: Classes | None
) -> AbstractContextManager[ContourWriter | None]:
    """What takes the outlines of images, where they are wanted."""
    if config.contours is None:
        return nullcontext()
    return ContourFile(
        folder=config.out,
        kind=config.contours,
        about={"made by": f"droptrack {__version__}, droptrack.detect"},
        id_name="row",
        classes=classes.names if classes else (),
        images=True,
    ).open()


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
    image: Image,
    found: Detections,
    measured: Measured,
    cut: Bools,
    order: Rows,
    classes: Classes | None,
) -> Iterator[list[object]]:
    """One row a droplet, in this order."""
    for i in order.tolist():
        box_x, box_y, w, h = (f"{value:.6f}" for value in measured.boxes[i].tolist())
        x, y = (f"{value:.6f}" for value in measured.centres[i].tolist())
        shape = [f"{value:.6f}" for value in measured.shapes[i, :AT_EDGE].tolist()]
        score, class_id = f"{found.scores[i]:.6f}", int(found.class_ids[i])
        source = printable(str(image.source))
        row = [source, image.number, x, y, w, h, score, class_id, int(cut[i])]
        named = [classes.name_of(class_id)] if classes is not None else []
        yield [*row, box_x, box_y, int(measured.measured[i]), *shape, *named]


def _sizes(diameters: Floats) -> dict[str, Value]:
    """What is said of diameters (N,) px; NaN without any."""
    some = diameters if len(diameters) else np.array([np.nan])
    mean, deviation = float(some.mean()), float(some.std())
    return {
        "mean_diameter_px": mean,
        "std_diameter_px": deviation,
        "coefficient_of_variation": deviation / mean,
    }


def _settings(
    config: ImagesConfig, detectors: dict[tuple[int, int], OpenedDetector]
) -> dict[str, Value]:
    """How the results were made; of images of several sizes, what holds for the first."""
    opened = next(iter(detectors.values()))
    return {
        "made by": f"droptrack {__version__}, droptrack.detect",
        "sources": _sources(config),
        "network": f"{opened.cfg.path}, {opened.weights}",
        "weights sha256": sha256_of(opened.weights),
        "backend": opened.detector.engine.name,
        "network_size": [opened.cfg.width, opened.cfg.height],
        **opened.settings,
        "score": config.score,
        "max_iou": config.max_iou,
        "dark": config.dark,
        "grey_levels": "" if config.reading.levels is None else str(config.reading.levels),
        "region": config.region or "",
        "diameters": "of circles of the droplets' areas, where no edge cuts them"
        if config.shape
        else "sqrt(w h) of the boxes of droplets that no edge cuts",
    }
