"""What one run is told: the source, the network, the tracker, and where results go."""

from dataclasses import dataclass, field
from pathlib import Path

from droptrack.data.formats.contours import ContoursFormat
from droptrack.data.units import Units
from droptrack.data.video import ReadOptions
from droptrack.detection.engine_choice import Backend, Precision
from droptrack.network.bundled import is_bundled
from droptrack.pipeline.report_events import EventsConfig
from droptrack.pipeline.results_folder import results_name
from droptrack.tracking.choice import TrackerConfig

MIN_SCORE = 0.4
MAX_IOU = 0.3


@dataclass(frozen=True, kw_only=True)
class DetectorConfig:
    """How to find droplets.

    `weights`, `cfg` and `size`: the network, see `network.bundled.find_network`; without weights
    and cfg, the bundled model that suits some of the frames (`detection.model_choice`). `scale`:
    px of the network's input for a px of the frames, or "auto", what some of the frames suggest; or
    `diameter_px`, the diameter of a typical droplet in the frames, from which the scale follows, or
    the smallest and the largest (`detection.pyramid`); without, "auto" for the bundled model of
    footage, and for others as large as the cfg says, in the frames' shape. `looks`: at how many
    scales around it the network sees each frame (`detection.looks`); None: one, or
    `looks.STILL_LOOKS` at single images where the scale is not the network's own. `score`: the
    minimum score of a droplet. `max_iou`: the IoU above which two boxes are one droplet. `dark`:
    droplets are darker than their surroundings.
    `normalise`: show the network grey frames of full contrast (`data.normalisation`); None:
    the bundled models only, which learned them so. `region`: where droplets count, a polygon or an
    image, see `data.region.Region.read`; None: everywhere. `shape`: measure the droplets' outlines,
    for their sizes and shapes. `names`: of the classes of a network with several, and `cells`, how
    many cells droplets of each have, see `pipeline.classes.classes_of`. `contours`: write the
    outlines to a file of this format.
    """

    weights: Path | None = None
    cfg: Path | None = None
    size: str | None = None
    scale: float | str | None = None
    diameter_px: float | tuple[float, float] | None = None
    looks: int | None = None
    backend: Backend = Backend.auto
    precision: Precision = Precision.auto
    score: float = MIN_SCORE
    max_iou: float = MAX_IOU
    dark: bool = False
    normalise: bool | None = None
    region: str | None = None
    shape: bool = True
    names: Path | None = None
    cells: str | None = None
    contours: ContoursFormat | None = None

    @property
    def normalises(self) -> bool:
        """Whether the network is shown grey frames of full contrast."""
        return is_bundled(self.weights) if self.normalise is None else self.normalise


@dataclass(frozen=True, kw_only=True)
class TrackingConfig(DetectorConfig):
    """How to track the droplets of a video.

    `video`: a file, a folder of images, the index of a camera, or the address of a stream. `out`:
    the folder for the results, default ``tracks/<the video's name>``. `live`: always take the
    newest frame and drop others; default for cameras and streams. `batch`: frames that the network
    takes at once. `max_frames`: stop after so many; 0: never. `reading`: how to read what can be
    read in several ways. `overwrite`: the results of an earlier run of the same video. `resume`:
    one that was ended too early, whatever ended it. `units`: what a
    pixel and a frame are, for columns in micrometres and seconds; by default what the file says,
    but for pixels where `pixels_only` is set. `events`: what to look for in the tracks afterwards.
    """

    video: str
    out: Path | None = None
    live: bool | None = None
    batch: int = 1
    max_frames: int = 0
    annotated_video: bool = True
    reading: ReadOptions = field(default_factory=ReadOptions)
    overwrite: bool = False
    resume: bool = False
    units: Units = field(default_factory=Units)
    pixels_only: bool = False
    events: EventsConfig | None = None
    tracker: TrackerConfig = field(default_factory=TrackerConfig)

    @property
    def folder(self) -> Path:
        """The folder for the results."""
        return self.out or Path("tracks") / results_name(self.video)


@dataclass(frozen=True, kw_only=True)
class ImagesConfig(DetectorConfig):
    """How to find the droplets of single images.

    `sources`: images, folders of images, and videos, and how they are read. `out`: the folder for
    the results.
    `annotated`: write the images with the boxes, too. `overwrite`: the results of an earlier run
    on the same sources. `units`: how wide a pixel is, for columns in micrometres; by default what
    each file says, but for pixels where `pixels_only` is set.
    """

    sources: tuple[str, ...]
    out: Path
    reading: ReadOptions = field(default_factory=ReadOptions)
    annotated: bool = True
    overwrite: bool = False
    units: Units = field(default_factory=Units)
    pixels_only: bool = False


@dataclass(frozen=True, kw_only=True)
class DetectionsConfig:
    """How to track detections that some other program found.

    `detections`: a file in the format of the MOT Challenge. `frames`: a file with the frames that
    exist, see `mot_files.read_frame_list`; without, a frame without a detection does not exist,
    and no droplet is missed in it. `descriptors`: an .npy file with the appearance descriptor (D,)
    of each of its rows. `score`: of rows that are used. `out`, `max_frames`, `overwrite` and
    `units`: as `TrackingConfig` has them.
    """

    detections: Path
    frames: Path | None = None
    descriptors: Path | None = None
    score: float | None = None
    max_frames: int = 0
    out: Path | None = None
    overwrite: bool = False
    units: Units = field(default_factory=Units)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)

    @property
    def folder(self) -> Path:
        """The folder for the results."""
        return self.out or Path("tracks") / results_name(str(self.detections))
