"""The size of a network's input that suits a video: never stretched, droplets as it learned them.

At a scale, a frame of (w, h) px becomes an input of (scale w, scale h) px. Inputs are multiples of
a network's stride; what a frame lacks of that is filled with its edge (`Canvas`).
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from droptrack.data.detections import Detections
from droptrack.data.frames import Frame, grey_frame, grey_plane
from droptrack.errors import DroptrackError

STRIDE = 32  # px, of an input's sides
MAX_STRETCH = 0.1  # of a frame's shape, which networks see in training, too
MAX_SIDE_PX = 6400  # of an input
AUTO = "auto"  # the scale that the frames suggest
DIAMETER_PX = 40.0  # of a droplet in the input, which the bundled model finds best


def parse_scale(text: str) -> float | str:
    """A scale, or AUTO; raises DroptrackError for another text.

    >>> parse_scale("0.5"), parse_scale("auto")
    (0.5, 'auto')
    """
    if text == AUTO:
        return AUTO
    try:
        scale = float(text)
    except ValueError:
        scale = math.nan
    if not 0.01 <= scale <= 100:
        raise DroptrackError(f"--scale {text}: should be auto, or a number such as 0.5")
    return scale


def parse_diameter(text: str) -> float | tuple[float, float]:
    """A diameter in px, or the smallest and the largest one; raises DroptrackError for others.

    >>> parse_diameter("40"), parse_diameter("8-200")
    (40.0, (8.0, 200.0))
    """
    try:
        numbers = [float(part) for part in text.split("-")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 2 or not all(1 <= n < math.inf for n in numbers):
        raise DroptrackError(
            f"--diameter {text}: should be px, such as 40, or the smallest and the largest ones, "
            "such as 8-200"
        )
    if len(numbers) == 1:
        return numbers[0]
    if numbers[0] >= numbers[1]:
        raise DroptrackError(f"--diameter {text}: the first should be the smaller one")
    return numbers[0], numbers[1]


@dataclass(frozen=True)
class Canvas:
    """What a network looks at: frames of width x height px, extended to the right and below.

    `network`: width and height of the network's input, px; `size`: those of the canvas in the
    frame's px, which has the input's shape; `frame`: those of the frame.
    """

    network: tuple[int, int]
    size: tuple[int, int]
    frame: tuple[int, int]

    @staticmethod
    def of(width: int, height: int, scale: float) -> "Canvas":
        """The smallest canvas for frames of a size at a scale.

        >>> Canvas.of(1200, 600, 0.8)
        Canvas(network=(960, 480), size=(1200, 600), frame=(1200, 600))
        >>> Canvas.of(560, 512, 0.5)
        Canvas(network=(288, 256), size=(576, 512), frame=(560, 512))
        """
        frame = (width, height)
        columns, rows = (STRIDE * max(1, math.ceil(side * scale / STRIDE - 1e-6)) for side in frame)
        size = (max(width, round(columns / scale)), max(height, round(rows / scale)))
        return Canvas((columns, rows), size, frame)

    @staticmethod
    def like(width: int, height: int, network: tuple[int, int]) -> "Canvas":
        """A canvas for frames of a size, whose input is about as large as a network's.

        It is the network's own where frames have about its shape.

        >>> Canvas.like(1240, 600, (960, 480)).network, Canvas.like(600, 600, (960, 480)).network
        ((960, 480), (704, 704))
        """
        stretch = (width / height) / (network[0] / network[1])
        if abs(math.log(stretch)) <= math.log(1 + MAX_STRETCH):
            return Canvas(network, (width, height), (width, height))
        scale = math.sqrt(network[0] * network[1] / (width * height))
        return Canvas.of(width, height, scale)

    @property
    def scale(self) -> float:
        """Px of the input for a px of the frame, the mean of both directions."""
        return math.sqrt(self.network[0] * self.network[1] / (self.size[0] * self.size[1]))

    def extended(self, frame: Frame) -> Frame:
        """A frame on the canvas; the frame itself where it fills it."""
        if self.size == self.frame:
            return frame
        right, below = self.size[0] - self.frame[0], self.size[1] - self.frame[1]
        plane = grey_plane(frame)
        shown = frame if plane is None else plane
        image = np.asarray(
            cv2.copyMakeBorder(shown, 0, below, 0, right, cv2.BORDER_REPLICATE), np.uint8
        )
        return image if plane is None else grey_frame(image)

    def within(self, detections: Detections) -> Detections:
        """Those detections whose centres lie in the frame, not in what extends it."""
        if self.size == self.frame:
            return detections
        inside = np.asarray((detections.boxes[:, :2] <= self.frame).all(axis=1), bool)
        return detections[inside]
