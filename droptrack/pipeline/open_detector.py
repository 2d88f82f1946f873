"""A detector that fits frames of one size, as a configuration wants it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from droptrack.compiled import explained
from droptrack.data.frames import Frame
from droptrack.data.region import Region
from droptrack.data.report import Value
from droptrack.detection import decoding, scale_choice
from droptrack.detection.detector import Detector
from droptrack.detection.engine_choice import Engines, Network, choose_detector
from droptrack.detection.scale import AUTO, DIAMETER_PX, MAX_SIDE_PX, Canvas
from droptrack.errors import DroptrackError
from droptrack.measurement import droplets
from droptrack.network.bundled import find_network
from droptrack.network.darknet_cfg import Cfg, resized
from droptrack.pipeline.config import DetectorConfig
from droptrack.pipeline.notes import Say


@dataclass(frozen=True, kw_only=True)
class OpenedDetector:
    """A detector, the network and weights it has, and px of its input for a px of the frames.

    `scale_settings`: the scale and how it was chosen, for the report.
    """

    detector: Detector
    cfg: Cfg
    weights: Path
    scale: float
    scale_settings: dict[str, Value] = field(default_factory=dict)


def open_detector(
    config: DetectorConfig,
    size: tuple[int, int],
    samples: Callable[[], Sequence[Frame]],
    *,
    live: bool,
    say: Say,
    engines: Engines | None = None,
) -> OpenedDetector:
    """A detector for frames of a size (width, height) px; `live`: for the shortest time a frame.

    `samples`: some of the frames, which are asked for where the scale is to be chosen from them.
    `say` is told how it was chosen, which engines were not used, and why. `engines`: of other
    videos. Raises DroptrackError for what is not to be had as it is wanted.
    """
    width, height = size
    network, weights = find_network(config.weights, config.cfg, config.size)
    canvas = _given_canvas(config, network, width, height)
    chosen: dict[str, Value] = {}
    if canvas is None:
        canvas, chosen = _chosen_canvas(config, network, weights, samples(), say, engines)
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
            region=None if config.region is None else Region.read(config.region, width, height),
        ),
        config.backend,
        config.precision,
        live=live,
        say=say,
        engines=engines,
    )
    return OpenedDetector(
        detector=detector,
        cfg=network,
        weights=weights,
        scale=canvas.scale,
        scale_settings={"scale": canvas.scale, **chosen},
    )


def _given_canvas(config: DetectorConfig, network: Cfg, width: int, height: int) -> Canvas | None:
    """How large the network's input is, and what it shows; None: as the frames suggest.

    Raises DroptrackError.
    """
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
    if scale == AUTO:
        return None
    if scale is None:
        return Canvas.like(width, height, own)
    canvas = Canvas.of(width, height, float(scale))
    if max(canvas.network) > MAX_SIDE_PX:
        raise DroptrackError(
            f"a scale of {scale:.3g} makes an input of {canvas.network[0]} x {canvas.network[1]} "
            f"px; sides of up to {MAX_SIDE_PX} px are computed"
        )
    return canvas


def _chosen_canvas(
    config: DetectorConfig,
    cfg: Cfg,
    weights: Path,
    samples: Sequence[Frame],
    say: Say,
    engines: Engines | None,
) -> tuple[Canvas, dict[str, Value]]:
    """The canvas whose scale suits some frames best, and how it was chosen."""
    height, width = samples[0].shape[:2]
    own = Canvas.like(width, height, (cfg.width, cfg.height))
    tile = resized(cfg, scale_choice.TILE, scale_choice.TILE)
    threshold = scale_choice.MIN_SCORE
    network = Network(tile, weights, threshold=threshold, max_iou=config.max_iou, dark=config.dark)
    detector = choose_detector(network, config.backend, engines=engines)
    choice = scale_choice.choose_scale(samples, detector, own.scale)
    settings: dict[str, Value] = {
        "scale_chosen_from": len(samples),
        "scale_quality": [f"{s:.3g}: {quality:.2f}" for s, quality in choice.quality.items()],
    }
    if math.isclose(choice.scale, own.scale):
        return own, settings
    canvas = Canvas.of(width, height, choice.scale)
    say(
        f"the network sees the frames at a scale of {choice.scale:.2f}, where it finds most of the "
        f"droplets of {len(samples)} of them; another one: --scale or --diameter"
    )
    return canvas, settings
