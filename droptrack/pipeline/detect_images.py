"""Images in; a table of their droplets, annotated images, counts and sizes out. No tracking."""

import functools
import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import PIL.Image

from droptrack.data.files import replacing
from droptrack.data.formats.contours import ContourFile, ContourWriter, check_contours
from droptrack.data.frames import Frame
from droptrack.data.normalisation import UNCHANGED, Normalisation, normalisation_for
from droptrack.data.report import Report, Value
from droptrack.data.samples import N_SAMPLES, sample_frames, spread
from droptrack.data.sources.image_files import TIFF_SUFFIXES
from droptrack.data.sources.microscopy import MICROSCOPY_SUFFIXES
from droptrack.data.sources.opencv_names import printable
from droptrack.data.video import IMAGE_SUFFIXES, Video, image_files
from droptrack.detection.engine_choice import Engines
from droptrack.detection.looks import STILL_LOOKS
from droptrack.errors import DroptrackError
from droptrack.measurement.shapes import DEFINITION
from droptrack.network.bundled import find_network
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.classes import Classes, classes_of
from droptrack.pipeline.config import ImagesConfig
from droptrack.pipeline.image_results import Content, Image, ImageResults
from droptrack.pipeline.notes import Say, left_out, to_stderr
from droptrack.pipeline.open_detector import OpenedDetector, open_detector
from droptrack.pipeline.results_folder import has_content, whole_name
from droptrack.progress import progress_bar
from droptrack.version import __version__

CALIBRATED = (*TIFF_SUFFIXES, *MICROSCOPY_SUFFIXES)  # files that may say how wide a pixel is
N_ENGINES = 12  # held at once, for images of many sizes and scales
LIKE_SIZES = 1.1  # up to this ratio of widths, and of heights, images share a scale

Size = tuple[int, int]  # width and height, px


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
    detectors = _Detectors(config, say)
    images = _read_images(config, say)
    first = next(images)  # what cannot be opened is refused before anything is written
    cfg, _ = find_network(config.weights, config.cfg)
    classes = classes_of(cfg, config.names, config.cells)
    content = Content(shape=config.shape, um=_has_um(config), classes=classes)
    _refuse_other_results(config)
    config.out.mkdir(parents=True, exist_ok=True)
    with (
        _contour_writer(config, classes) as contours,
        replacing(config.out / "detections.csv") as partial,
        partial.open("w", newline="", encoding="utf-8") as file,
        progress_bar("images", shown=progress) as bar,
    ):
        annotated = config.out / "annotated" if config.annotated else None
        results = ImageResults(annotated, file, content, contours)
        for image in bar.track(chain([first], images), description="detecting"):
            opened = detectors.of(image)
            normalisation = UNCHANGED
            if opened.stretching is not None:
                normalisation = normalisation_for([image.frame], stretching=opened.stretching)
            (found,) = opened.detector.detect([normalisation.shown(image.frame)])
            results.add(image, found, _seen(opened, normalisation), opened.region)
    settings = _settings(config, detectors.first) | (classes.settings() if classes else {})
    report = results.report(settings, seconds=time.perf_counter() - began)
    report.write_json(config.out / "report.json")
    if content.um and results.n_without_um:
        say(
            f"{results.n_without_um} of {results.n_images} images do not say how wide a pixel is: "
            "no um of their droplets; --um-per-px says it of all"
        )
    if results.diameters:
        from droptrack.pipeline.plots import plot_sizes

        in_um = content.um and not results.n_without_um
        diameters = results.diameters_um if in_um else results.diameters
        plot_sizes(config.out / "sizes.png", diameters, "µm" if in_um else "px")
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


def _read_images(config: ImagesConfig, say: Say) -> Iterator[Image]:
    """Every image of the sources, and how wide its pixels are.

    `say` is told what files say of that. Raises DroptrackError for what cannot be read, or holds
    none.
    """
    n, told = 0, config.units.um_per_px
    for file in _files(config.sources):
        video = Video(str(file), config.reading)
        um_per_px = config.units.um_per_px
        if um_per_px is None and not config.pixels_only:
            um_per_px = video.pixel_size_um or None
        if um_per_px is not None and um_per_px != told:
            say(
                f"{printable(str(file))}: a pixel is {um_per_px:.4g} um wide, as the file says; "
                "another width: --um-per-px, none: --pixels-only"
            )
            told = um_per_px
        for note in video.notes:
            say(printable(note))
        for number, frame in video.numbered():
            yield Image(
                source=file,
                number=number,
                frame=frame,
                um_per_px=um_per_px,
                is_alone=video.info.n_frames == 1,
            )
            n += 1
        for doubt in (video.doubt, left_out(video)):
            if doubt:
                say(f"{printable(str(file))}: {doubt}")
    if not n:
        raise DroptrackError("name an image, a folder of images, or a video")


def _has_um(config: ImagesConfig) -> bool:
    """Whether it is known of any image how wide its pixels are."""
    if config.units.um_per_px is not None or config.pixels_only:
        return config.units.um_per_px is not None
    say_it = (file for file in _files(config.sources) if file.suffix.lower() in CALIBRATED)
    return any(Video(str(file), config.reading).pixel_size_um for file in say_it)


def _files(sources: tuple[str, ...]) -> Iterator[Path]:
    """The images and videos that sources name."""
    for source in sources:
        path = Path(source)
        files = image_files(path) if path.is_dir() else [path]
        if path.is_dir() and not files:
            raise DroptrackError(f"{path}: has no images")
        yield from files


class _Detectors:
    """What finds droplets in images of each size; in each image, where droplets differ in size."""

    def __init__(self, config: ImagesConfig, say: Say) -> None:
        self._config, self._say = config, say
        self._of_kinds: dict[tuple[Size, bool], OpenedDetector] = {}  # sizes, and whether alone
        self._engines = Engines(n_held=N_ENGINES)

    @property
    def first(self) -> OpenedDetector:
        """That for images of the first size."""
        return next(iter(self._of_kinds.values()))

    def of(self, image: Image) -> OpenedDetector:
        """That for an image."""
        size = (image.frame.shape[1], image.frame.shape[0])
        kind = (size, image.is_alone)
        if kind not in self._of_kinds:
            samples = functools.partial(_samples, self._config, image)
            config = self._as_for_like_images(size)
            opened = self._open(config, image, samples, self._say)
            self._of_kinds[kind] = opened
            if opened.differ and image.is_alone:
                self._say(
                    "droplets of the images differ in size: each image is seen at a scale of its "
                    "own; one for all: --scale or --diameter"
                )
        opened = self._of_kinds[kind]
        if opened.differ and image.is_alone:
            model = opened.settings.get("model", self._config.weights)
            own = replace(self._config, weights=None if model is None else Path(str(model)))
            return self._open(own, image, lambda: [image.frame], lambda _: None)
        return opened

    def _open(
        self, config: ImagesConfig, image: Image, samples: Callable[[], list[Frame]], say: Say
    ) -> OpenedDetector:
        return open_detector(
            config,
            (image.frame.shape[1], image.frame.shape[0]),
            samples,
            live=False,
            say=say,
            engines=self._engines,
            each=True,
            looks=STILL_LOOKS if image.is_alone else 1,
        )

    def _as_for_like_images(self, size: Size) -> ImagesConfig:
        """The model and the scale chosen for images of about a size (width, height) px, if any.

        Of several scales, none: they are chosen anew, from the same images and this one.
        """
        config = self._config
        for (other, _), how in self._of_kinds.items():
            if not _about_equal(size, other):
                continue
            if "model" in how.settings:
                config = replace(config, weights=Path(str(how.settings["model"])))
            is_one = how.alone is None and not how.differ
            if "scale_chosen_from" in how.settings and is_one:
                config = replace(config, scale=how.scale)
        return config


def _seen(opened: OpenedDetector, normalisation: Normalisation) -> dict[str, Value]:
    """What the network was shown of an image, and at which scale, for the report."""
    return {"network_sees": str(normalisation), "scale": opened.settings["scale"]}


def _about_equal(size: Size, other: Size) -> bool:
    pairs = zip(size, other, strict=True)
    return all(max(sides) <= LIKE_SIZES * min(sides) for sides in pairs)


def _samples(config: ImagesConfig, like: Image) -> list[Frame]:
    """Some frames of an image's video; or some of all images of about its size, that one first."""
    video = Video(str(like.source), config.reading)
    if like.source.suffix.lower() not in IMAGE_SUFFIXES or not like.is_alone:
        return sample_frames(video, N_SAMPLES)
    size = like.frame.shape[1::-1]
    files = [file for file in _files(config.sources) if file.suffix.lower() in IMAGE_SUFFIXES]
    sizes = {file: _image_size(file) for file in files if file != like.source}
    alike = [file for file, other in sizes.items() if other and _about_equal(size, other)]
    others = [alike[number] for number in spread(len(alike), N_SAMPLES - 1)]
    return [like.frame, *(Video(str(file), config.reading).samples()[0] for file in others)]


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
        about={
            "made by": f"droptrack {__version__}, droptrack.detect",
            **config.units.about(),
        },
        id_name="row",
        classes=classes.names if classes else (),
        images=True,
    ).open()


def _settings(config: ImagesConfig, opened: OpenedDetector) -> dict[str, Value]:
    """How the results were made; of images of several sizes, what holds for the first."""
    return {
        "made by": f"droptrack {__version__}, droptrack.detect",
        "sources": _sources(config),
        "network": f"{opened.cfg.path}, {opened.weights}",
        "weights sha256": sha256_of(opened.weights),
        "backend": opened.detector.engine.name,
        "network_size": [opened.cfg.width, opened.cfg.height],
        **opened.settings,
        **({"scale": "of each image"} if opened.differ else {}),
        "score": config.score,
        "max_iou": config.max_iou,
        **({"sizes": DEFINITION} if config.shape else {}),
        "dark": config.dark,
        "grey_levels": "" if config.reading.levels is None else str(config.reading.levels),
        "region": config.region or "",
        "um_per_px": config.units.um_per_px,
        "diameters": "of circles of the droplets' areas, where no edge cuts them"
        if config.shape
        else "sqrt(w h) of the boxes of droplets that no edge cuts",
    }
