"""Darknet networks through OpenCV's DNN module, on the CPU or with CUDA."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from droptrack import DroptrackError
from droptrack.darknet_files import Cfg, cfg_text, read_weights, with_options
from droptrack.detections import Detections
from droptrack.detector import select


class OpenCvDetector:
    """Finds droplets with a ``.cfg`` and ``.weights``.

    `backend`: ``opencv`` for the CPU, ``opencv-cuda`` for a GPU, ``auto`` for CUDA where OpenCV has
    it and the CPU elsewhere. `threshold`: least score of a detection; `max_iou`: overlap from which
    two detections are one droplet. Raises DroptrackError for files that do not fit and for CUDA
    that is not there.
    """

    def __init__(
        self, cfg: Cfg, weights: Path, backend: str, threshold: float, max_iou: float
    ) -> None:
        read_weights(weights, cfg)  # OpenCV would load a damaged file without a word
        self.threshold, self.max_iou = threshold, max_iou
        self._size = (cfg.width, cfg.height)
        # OpenCV zeroes scores below 0.2 unless the cfg says otherwise
        text = cfg_text(with_options(cfg, {"batch": "1"}, {"thresh": f"{min(0.001, threshold)}"}))
        config = np.frombuffer(text.encode(), np.uint8)
        model = np.frombuffer(weights.read_bytes(), np.uint8)
        self._network = cv2.dnn.readNetFromDarknet(config, model)
        self.name = _choose_backend(self._network, backend)
        self._outputs = self._network.getUnconnectedOutLayersNames()

    def detect(self, frames: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """The detections of each of some frames (H, W, 3) of one size, in one pass."""
        height, width = frames[0].shape[:2]
        # Darknet stretches a picture to the network's size, so do we
        blob = cv2.dnn.blobFromImages(frames, 1 / 255, self._size, swapRB=True)
        self._network.setInput(blob)
        heads = [
            np.asarray(output).reshape(len(frames), -1, np.asarray(output).shape[-1])
            for output in self._network.forward(self._outputs)
        ]
        rows = np.concatenate(heads, axis=1, dtype=np.float32)  # (B, N, 5 + C)
        # OpenCV has multiplied the probabilities by the objectness, as `select` will
        rows[..., 5:] /= np.maximum(rows[..., 4:5], np.finfo(np.float32).tiny)
        return [
            select(frame_rows, width, height, self.threshold, self.max_iou) for frame_rows in rows
        ]


def _choose_backend(network: cv2.dnn.Net, backend: str) -> str:
    """Set the backend that was asked for; returns its name."""
    has_cuda = bool(cv2.dnn.getAvailableTargets(cv2.dnn.DNN_BACKEND_CUDA))
    if backend == "opencv-cuda" and not has_cuda:
        raise DroptrackError(
            "--backend opencv-cuda: this OpenCV is built without CUDA (as are its packages on "
            "PyPI); use --backend opencv, or install an OpenCV built with CUDA"
        )
    if has_cuda and backend != "opencv":
        network.setPreferableBackend(cv2.dnn.DNN_BACKEND_CUDA)
        network.setPreferableTarget(cv2.dnn.DNN_TARGET_CUDA)
        return "opencv-cuda"
    network.setPreferableBackend(cv2.dnn.DNN_BACKEND_OPENCV)
    network.setPreferableTarget(cv2.dnn.DNN_TARGET_CPU)
    return "opencv"
