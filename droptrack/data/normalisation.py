"""What a network is shown of frames, where it learned grey drawings with the whole range of levels.

Colour becomes grey: the channel of the most contrast, where that has clearly more than the usual
mixture of all (a red fluorescence is one third as bright in it). Faint frames are stretched. What
suits a video is measured in some of its frames and holds for all, so that scores can be compared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.frames import Frame, grey_frame, grey_plane
from droptrack.data.levels import EIGHT_BITS, Levels, to_pixels

CHANNELS = ("blue", "green", "red")  # of a frame
MIN_GAIN = 1.5  # contrast of a channel, against that of the mixture, that makes it the better one
NOTHING = 10  # levels of contrast below which there is nothing to be seen but noise
SHOWN = (16, 240)  # levels that a faint frame is stretched to
SIDE_PX = 320  # of frames whose contrast is measured, so that noise is averaged out
N_OUTLIERS = 8  # pixels at either end, of those: reflections
NOISE_RANGE = 4  # times the noise of a frame, of SIDE_PX, that is no contrast
SECOND_DIFFERENCES = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)


@dataclass(frozen=True)
class Normalisation:
    """How frames are changed for a network.

    `grey`: colour is taken away, by the `channel` of `CHANNELS`, or the mixture of all; `levels`:
    those that become black and white; `dark`: droplets are darker than what is around them, and the
    network learned bright ones, so that it is shown the negative.
    """

    grey: bool = False
    channel: str | None = None
    levels: Levels | None = None
    dark: bool = False

    def shown(self, frame: Frame) -> Frame:
        """What the network is shown of a frame (H, W, 3)."""
        plane = grey_plane(frame)
        if plane is None and self.grey:
            plane = _plane(frame, self.channel)
        image = frame if plane is None else plane
        if self.levels is not None:
            image = np.asarray(cv2.LUT(image, self._table), np.uint8)
        if self.dark:
            image = 255 - image
        return image if plane is None else grey_frame(image)

    @cached_property
    def _table(self) -> NDArray[np.uint8]:
        """What each of the 256 levels becomes."""
        return to_pixels(np.arange(256, dtype=np.uint8), self.levels or EIGHT_BITS)

    def __str__(self) -> str:
        """What is not left as it is, for a report; empty where all is."""
        parts = []
        if self.channel is not None:
            parts.append(f"the {self.channel} channel")
        elif self.grey:
            parts.append("grey")
        if self.levels is not None:
            parts.append(f"levels {self.levels.black:.0f} to {self.levels.white:.0f} stretched")
        return ", ".join(parts + ["the negative"] * self.dark)


UNCHANGED = Normalisation()


@dataclass(frozen=True)
class Stretching:
    """Which frames are stretched: those of less contrast than `faint` levels; `gain` at most."""

    faint: float
    gain: float = math.inf


FULL = Stretching(128)  # for networks that learned drawings of full contrast
# for one that learned faint footage, too: stretched any further, noise looks like droplets to it
GENTLE = Stretching(32, gain=4)


def normalisation_for(
    frames: Sequence[Frame], *, dark: bool = False, stretching: Stretching = FULL
) -> Normalisation:
    """What suits a video, from some of its frames (H, W, 3) of one size.

    >>> faint = np.full((100, 100, 3), 60, np.uint8)
    >>> faint[40:60, 40:60] = 90, 90, 150
    >>> print(normalisation_for([faint]))
    the red channel, levels 54 to 156 stretched
    """
    coloured = [frame for frame in frames if grey_plane(frame) is None]
    channel = None
    if coloured:
        mixture = _contrast([_plane(frame, None) for frame in coloured])
        best = max(
            CHANNELS, key=lambda name: _contrast([_plane(frame, name) for frame in coloured])
        )
        own = _contrast([_plane(frame, best) for frame in coloured])
        channel = best if own > MIN_GAIN * max(mixture, NOTHING / MIN_GAIN) else None
    shown = Normalisation(bool(coloured), channel)
    planes = [np.asarray(shown.shown(frame)[..., 0]) for frame in frames]
    low, high = _range(planes)
    levels = None
    if max(NOTHING, *map(_range_of_noise, planes)) <= high - low < stretching.faint:
        levels = _stretched(low, high, stretching.gain)
    return Normalisation(bool(coloured), channel, levels, dark)


def _stretched(low: float, high: float, gain: float) -> Levels:
    """What stretches levels to those SHOWN, or by a gain, the middle left where it can be."""
    gain = min(gain, (SHOWN[1] - SHOWN[0]) / (high - low))
    middle, half = (low + high) / 2, gain * (high - low) / 2
    black = middle - min(max(middle, SHOWN[0] + half), SHOWN[1] - half) / gain
    return Levels(black, black + 255 / gain, "stretched")


def _plane(frame: Frame, channel: str | None) -> NDArray[np.uint8]:
    """A channel of a colour frame, or the usual mixture of all."""
    if channel is None:
        return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8)
    return np.asarray(cv2.extractChannel(frame, CHANNELS.index(channel)), np.uint8)


def _contrast(planes: Sequence[NDArray[np.uint8]]) -> float:
    low, high = _range(planes)
    return high - low


def _range_of_noise(plane: NDArray[np.uint8]) -> float:
    """The range that noise alone makes of an image (H, W): by Immerkaer (1996), with a median."""
    differences = cv2.filter2D(plane, cv2.CV_32F, SECOND_DIFFERENCES)
    deviation = float(np.median(np.abs(differences))) / 0.6745 / 6
    return float(NOISE_RANGE * deviation / max(1.0, max(plane.shape) / SIDE_PX))


def _range(planes: Sequence[NDArray[np.uint8]]) -> tuple[float, float]:
    """The darkest and the brightest level of images (H, W), but for noise and reflections."""
    lows, highs = [], []
    for plane in planes:
        shrink = max(1.0, max(plane.shape) / SIDE_PX)
        size = [max(1, math.ceil(side / shrink)) for side in plane.shape[::-1]]
        small = np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA))
        values = np.sort(np.asarray(cv2.GaussianBlur(small, (3, 3), 0)), axis=None)
        few = min(N_OUTLIERS, (len(values) - 1) // 2)
        lows.append(float(values[few]))
        highs.append(float(values[-1 - few]))
    return min(lows), max(highs)
