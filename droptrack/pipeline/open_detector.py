"""A detector that fits frames of one size, as a configuration wants it."""

from dataclasses import dataclass
from pathlib import Path

from droptrack.compiled import explained
from droptrack.detection import decoding
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Network, choose_detector
from droptrack.detection.scale import DIAMETER_PX, MAX_SIDE_PX, Canvas
from droptrack.errors import DroptrackError
from droptrack.measurement import droplets
from droptrack.network.bundled import find_network
from droptrack.network.darknet_cfg import Cfg, resized
from droptrack.pipeline.config import DetectorConfig
from droptrack.pipeline.notes import Say


@dataclass(frozen=True, kw_only=True)
class OpenedDetector:
    """A detector, the network and weights it has, and px of its input for a px of the frames."""

    detector: Detector
    cfg: Cfg
    weights: Path
    scale: float


def open_detector(
    config: DetectorConfig, width: int, height: int, *, live: bool, say: Say
) -> OpenedDetector:
    """A detector for frames of width x height px; `live`: for the shortest time a frame.

    `say` is told which engines were not used, and why. Raises DroptrackError for what is not to be
    had as it is wanted.
    """
    network, weights = find_network(config.weights, config.cfg, config.size)
    canvas = _choose_canvas(config, network, width, height)
    network = resized(network, *canvas.network)
    with explained(say):
        decoding.load_loops()
        droplets.load_loops()
    detector = choose_detector(
        Network(
            network,
            weights,
            threshold=config.score,
            max_iou=config.max_iou,
            dark=config.dark,
            canvas=canvas,
        ),
        config.backend,
        config.precision,
        live=live,
        say=say,
    )
    return OpenedDetector(detector=detector, cfg=network, weights=weights, scale=canvas.scale)


def _choose_canvas(config: DetectorConfig, network: Cfg, width: int, height: int) -> Canvas:
    """How large the network's input is, and what it shows. Raises DroptrackError."""
    given = [name for name in ("size", "scale", "diameter_px") if getattr(config, name) is not None]
    if len(given) > 1:
        options = " and ".join(f"--{name.removesuffix('_px')}" for name in given)
        raise DroptrackError(f"{options}: each says how large the input is; give one of them")
    own = (network.width, network.height)
    if config.size is not None:
        return Canvas(own, (width, height), (width, height))
    scale = config.scale
    if config.diameter_px is not None:
        scale = DIAMETER_PX / config.diameter_px
    if scale is None:
        return Canvas.like(width, height, own)
    canvas = Canvas.of(width, height, scale)
    if max(canvas.network) > MAX_SIDE_PX:
        raise DroptrackError(
            f"a scale of {scale:.3g} makes an input of {canvas.network[0]} x {canvas.network[1]} "
            f"px; sides of up to {MAX_SIDE_PX} px are computed"
        )
    return canvas
