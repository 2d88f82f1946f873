"""Darknet networks through OpenCV's DNN module, on the CPU or with CUDA."""

import sys
from collections.abc import Sequence

import cv2
import numpy as np

from droptrack.data.arrays import Float32s
from droptrack.data.frames import Frame, grey_planes
from droptrack.detection.engines.in_thread import InThread
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg, cfg_text, with_options
from droptrack.network.darknet_weights import Weights, weights_bytes

TARGETS = {
    ("opencv", "fp32"): (cv2.dnn.DNN_BACKEND_OPENCV, cv2.dnn.DNN_TARGET_CPU),
    ("opencv-cuda", "fp32"): (cv2.dnn.DNN_BACKEND_CUDA, cv2.dnn.DNN_TARGET_CUDA),
    ("opencv-cuda", "fp16"): (cv2.dnn.DNN_BACKEND_CUDA, cv2.dnn.DNN_TARGET_CUDA_FP16),
}


def has_cuda() -> bool:
    """Whether this OpenCV is built with CUDA and finds a GPU."""
    return bool(cv2.dnn.getAvailableTargets(cv2.dnn.DNN_BACKEND_CUDA))


def reads_darknet() -> bool:
    """Whether this OpenCV reads Darknet's networks: 4 does, 5 does not any more."""
    return hasattr(cv2.dnn, "readNetFromDarknet")


class OpenCvEngine(InThread):
    """A network in OpenCV; `backend` is ``opencv`` or ``opencv-cuda``.

    Raises DroptrackError for CUDA that is not there, and for an OpenCV that is too new.
    """

    opencv_threads = sys.maxsize

    def __init__(
        self, cfg: Cfg, weights: Weights, backend: str, precision: str, threshold: float
    ) -> None:
        if backend == "opencv-cuda" and not has_cuda():
            raise DroptrackError(
                "--backend opencv-cuda: this OpenCV is built without CUDA (as are its packages on "
                "PyPI); use --backend opencv, or install an OpenCV built with CUDA"
            )
        if not reads_darknet():
            raise DroptrackError(
                f"--backend {backend}: OpenCV {cv2.__version__} cannot read Darknet's networks; "
                "some package has put it over version 4; to mend it: pip uninstall -y "
                "opencv-python opencv-contrib-python opencv-python-headless; then pip install "
                "'opencv-python-headless<5'"
            )
        self.name = f"{backend} {precision}"
        self._size = (cfg.width, cfg.height)
        # OpenCV zeroes scores below 0.2 unless the cfg says otherwise
        text = cfg_text(with_options(cfg, {"batch": "1"}, {"thresh": f"{min(0.001, threshold)}"}))
        config = np.frombuffer(text.encode(), np.uint8)
        model = np.frombuffer(weights_bytes(weights), np.uint8)
        self._network = cv2.dnn.readNetFromDarknet(config, model)
        implementation, target = TARGETS[backend, precision]
        self._network.setPreferableBackend(implementation)
        self._network.setPreferableTarget(target)
        self._outputs = self._network.getUnconnectedOutLayersNames()

    def prepare(self, frames: Sequence[Frame]) -> Float32s:
        """Images (B, 3, height, width), stretched to the network's size as Darknet does."""
        if (planes := grey_planes(frames)) is None:
            blob = cv2.dnn.blobFromImages(frames, 1 / 255, self._size, swapRB=True)
            return np.asarray(blob, np.float32)
        images = np.empty((len(frames), 3, *self._size[::-1]), np.float32)
        for plane, image in zip(planes, images, strict=True):
            np.multiply(cv2.resize(plane, self._size), np.float32(1 / 255), out=image[0])
            image[1:] = image[0]
        return images

    def run(self, prepared: Float32s) -> list[Float32s]:
        """Rows of each head, cell by cell, of one image after the other."""
        self._network.setInput(prepared)
        return [
            np.asarray(output, np.float32).reshape(len(prepared), -1, np.asarray(output).shape[-1])
            for output in self._network.forward(self._outputs)
        ]

    def rows(self, outputs: list[Float32s]) -> list[Float32s]:
        """OpenCV has decoded them, and multiplied the probabilities by the objectness."""
        rows = np.concatenate(outputs, axis=1)  # (B, N, 5 + C)
        rows[..., 5:] /= np.maximum(rows[..., 4:5], np.finfo(np.float32).tiny)
        return list(rows)
