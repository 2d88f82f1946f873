"""Appearance descriptors by a network of the user's, run by OpenCV."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats
from droptrack.errors import DroptrackError

BATCH = 64  # crops that the network takes at once
MIN_LENGTH = 1e-12  # of an output that has a direction


class NetworkAppearance:
    """Describes boxes by a network: a `DescriptorExtractor`.

    `network`: an .onnx file, or a Darknet .cfg whose `weights` are given too. `size`: width and
    height of its input in px. RGB from 0 to 1 goes in; whatever comes out for a crop is its
    descriptor. Raises DroptrackError if it cannot be read or run.
    """

    def __init__(self, network: Path, weights: Path | None, size: tuple[int, int]) -> None:
        self.size = size
        for path in (network, weights):
            if path is not None and not path.is_file():
                raise DroptrackError(f"{path}: no such network")
        try:
            if network.suffix == ".onnx":
                self._net = cv2.dnn.readNetFromONNX(str(network))
            elif weights is not None:
                self._net = cv2.dnn.readNetFromDarknet(str(network), str(weights))
            else:
                raise DroptrackError(
                    f"{network}: appearance needs an .onnx, or a .cfg with --appearance-weights"
                )
        except cv2.error as error:
            raise DroptrackError(f"{network}: OpenCV cannot read it: {error.err}") from None
        self._path = network
        self._batch = BATCH
        self._describe_crops([np.zeros((*self.size[::-1], 3), np.uint8)] * 2)

    def __call__(self, frame: NDArray[np.uint8], boxes: Floats) -> Floats:
        """Unit descriptors (N, D) of boxes (N, 4) in a frame (H, W, 3)."""
        height, width = frame.shape[:2]
        low = np.clip(np.floor(boxes[:, :2] - boxes[:, 2:] / 2), 0, [width - 1, height - 1])
        high = np.clip(np.ceil(boxes[:, :2] + boxes[:, 2:] / 2), low + 1, [width, height])
        corners = np.hstack([low, high]).astype(int).tolist()
        return self._describe_crops([frame[y0:y1, x0:x1] for x0, y0, x1, y1 in corners])

    def _describe_crops(self, crops: Sequence[NDArray[np.uint8]]) -> Floats:
        """Run the network; one that takes a single image gets one after the other."""
        parts: list[Floats] = []
        for start in range(0, len(crops), self._batch):
            some = crops[start : start + self._batch]
            self._net.setInput(cv2.dnn.blobFromImages(some, 1 / 255, self.size, swapRB=True))
            try:
                out = np.asarray(self._net.forward(), np.float64)
            except cv2.error as error:
                if self._batch > 1:
                    self._batch = 1
                    return self._describe_crops(crops)
                raise DroptrackError(
                    f"{self._path}: fails on {self.size[0]} x {self.size[1]} px; "
                    f"--appearance-size may help: {error.err}"
                ) from None
            if out.shape[0] != len(some) and self._batch > 1:
                self._batch = 1
                return self._describe_crops(crops)
            parts.append(out.reshape(len(some), -1))
        table = np.concatenate(parts) if parts else np.zeros((0, 1))
        length = np.linalg.norm(table, axis=1, keepdims=True)
        return np.asarray(table / np.maximum(length, MIN_LENGTH))
