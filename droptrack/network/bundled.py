"""Which network to use: weights given or shipped, and the ``.cfg`` that belongs to them."""

import re
from pathlib import Path

from droptrack.errors import DroptrackError

SHIPPED = Path(__file__).parents[2] / "darknet_cfg"
SHIPPED_WEIGHTS = SHIPPED / "yolov3-tiny-droplets.weights"

# what Darknet adds to the cfg's stem when it saves weights
SUFFIX = re.compile(r"_(final|last|best|\d+)$")


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of ``960x480``; raises DroptrackError for another text."""
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise DroptrackError(f"--size {text}: should be width x height in px, such as 960x480")
    return int(match[1]), int(match[2])


def find_cfg(weights: Path) -> Path:
    """The ``.cfg`` of weights by their stem, less what Darknet adds (``yolov3_final``).

    Sought beside the weights, in the current folder, in its ``darknet_cfg``, then among those that
    come with droptrack. Raises DroptrackError when there is none.
    """
    folders = (weights.parent, Path(), Path("darknet_cfg"), SHIPPED)
    for stem in (weights.stem, SUFFIX.sub("", weights.stem)):
        for folder in folders:
            if (cfg := folder / f"{stem}.cfg").is_file():
                return cfg
    raise DroptrackError(
        f"{weights}: found no {SUFFIX.sub('', weights.stem)}.cfg that belongs to it; name it: --cfg"
    )
