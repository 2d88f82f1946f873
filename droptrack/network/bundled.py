"""Which network to use: the weights given or the bundled ones, and the ``.cfg`` they belong to."""

import re
from pathlib import Path

from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, read_cfg, resized
from droptrack.network.darknet_weights import refuse_partial

BUNDLED = Path(__file__).parents[2] / "darknet_cfg"
BUNDLED_WEIGHTS = BUNDLED / "yolov3-tiny-droplets.weights"
SIMULATIONS, FOOTAGE = "simulations", "footage"  # what the droplets of a model look like
MODELS = {SIMULATIONS: BUNDLED_WEIGHTS, FOOTAGE: BUNDLED / "yolov3-tiny-footage.weights"}

# what Darknet adds to the cfg's stem when it saves weights
SUFFIX = re.compile(r"_(final|last|best|\d+)$")


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Width and height of ``960x480``; raises DroptrackError for another text, with its option.

    >>> parse_size("960x480")
    (960, 480)
    """
    match = re.fullmatch(r"(\d+)x(\d+)", text.lower())
    if match is None:
        raise DroptrackError(f"{option} {text}: should be width x height in px, such as 960x480")
    return int(match[1]), int(match[2])


def find_cfg(weights: Path) -> Path:
    """The ``.cfg`` of weights by their stem, less what Darknet adds (``yolov3_final``).

    Sought beside the weights, in the current folder, in its ``darknet_cfg``, then among those that
    come with droptrack. Raises DroptrackError when there is none.
    """
    folders = (weights.parent, Path(), Path("darknet_cfg"), BUNDLED)
    for stem in (weights.stem, SUFFIX.sub("", weights.stem)):
        for folder in folders:
            if (cfg := folder / f"{stem}.cfg").is_file():
                return cfg
    raise DroptrackError(
        f"{weights}: found no {SUFFIX.sub('', weights.stem)}.cfg that belongs to it; name it: --cfg"
    )


def is_bundled(weights: Path | None) -> bool:
    """Whether `--weights` means a bundled model: not given, or the name of one.

    >>> is_bundled(None), is_bundled(Path("footage")), is_bundled(Path("yolov3.weights"))
    (True, True, False)
    """
    return weights is None or str(weights) in MODELS


def find_network(
    weights: Path | None = None, cfg: Path | None = None, size: str | None = None
) -> tuple[Cfg, Path]:
    """The network to use, and its weights: a file, or one of MODELS, by default SIMULATIONS.

    `cfg`: their description; without, the one of their name (`find_cfg`). `size`: the network's
    input as ``960x480``, instead of the cfg's. Raises DroptrackError for what is not there or
    cannot be understood.
    """
    weights = BUNDLED_WEIGHTS if weights is None else MODELS.get(str(weights), weights)
    refuse_partial(weights)
    network = read_cfg(cfg or find_cfg(weights))
    if network.net.integer("letter_box", 0):
        raise DroptrackError(
            f"{network.path}:{network.net.line}: letter_box=1 fills the input with grey where an "
            "image has another shape, which no engine here does: it takes the image's shape; set "
            "letter_box=0"
        )
    return (network if size is None else resized(network, *parse_size(size))), weights
