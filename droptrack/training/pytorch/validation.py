"""How good a network is while it is trained with PyTorch."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from droptrack.data.detections import Detections
from droptrack.data.frames import Frame
from droptrack.detection.decoding import decode_heads, select
from droptrack.evaluation.average_precision import MAX_IOU, MIN_SCORE
from droptrack.evaluation.network_scores import Detect, read_labelled, score_detections
from droptrack.network.torch_network import DarknetNetwork


def mean_average_precision(network: DarknetNetwork, images: Sequence[Path], *, bf16: bool) -> float:
    """mAP@0.50 on images of a data set, by Darknet's definition, computed in bf16 or fp32."""
    detect = validation_detect(network, bf16=bf16)
    return score_detections(detect, read_labelled(images)).average_precision


def validation_detect(network: DarknetNetwork, *, bf16: bool) -> Detect:
    """A network as a function of an image, in the precision and on the device it is trained in."""
    network.eval()
    device = next(network.parameters()).device
    size = (network.cfg.width, network.cfg.height)

    @torch.no_grad()
    def detect(image: Frame) -> Detections:
        height, width = image.shape[:2]
        rgb = np.ascontiguousarray(cv2.resize(image, size)[..., ::-1])
        inputs = torch.from_numpy(rgb).to(device).permute(2, 0, 1)[None].float() / 255
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
            maps = network(inputs.contiguous(memory_format=torch.channels_last))
        flat = [raw.flatten(1, 2).float().cpu().numpy() for raw in maps]
        (rows,) = decode_heads(flat, network.heads, MIN_SCORE)
        return select(rows, width, height, MIN_SCORE, MAX_IOU, greedy=True)

    return detect
