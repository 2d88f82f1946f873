"""A detector that fits frames of one size, as a configuration wants it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from droptrack.compiled import explained
from droptrack.data.frames import Frame
from droptrack.data.normalisation import (
    FULL,
    GENTLE,
    Normalisation,
    Stretching,
    normalisation_for,
)
from droptrack.data.region import Region
from droptrack.data.report import Value
from droptrack.detection import decoding, scale_evidence
from droptrack.detection.detector import Detector, Finder
from droptrack.detection.engine_choice import Engines, Network, choose_detector
from droptrack.detection.looks import MIN_SCORE, SeveralLooks, look_factors
from droptrack.detection.model_choice import (
    MIN_AGREEMENT,
    MIN_SIDE_PX,
    agreement,
    typical_side,
)
from droptrack.detection.pyramid import Pyramid, Sizes, levels_for
from droptrack.detection.scale import AUTO, DIAMETER_PX, MAX_SIDE_PX, Canvas
from droptrack.detection.scale_choice import choose_scale
from droptrack.errors import DroptrackError
from droptrack.measurement import droplets
from droptrack.network.bundled import FOOTAGE, MODELS, SIMULATIONS, find_network
from droptrack.network.darknet_cfg import Cfg, resized
from droptrack.pipeline.config import DetectorConfig
from droptrack.pipeline.notes import Say


@dataclass(frozen=True, kw_only=True)
class OpenedDetector:
    """A detector, the network and weights it has, and px of its input for a px of the frames.

    Of several scales, the network and the scale are those for the smallest droplets; `alone`: the
    scale that would be best alone, where several were chosen from the frames. `settings`: the scale
    and how it was chosen, and how frames are changed, for the report. `region`: where droplets
    count; None: everywhere. `stretching`: of faint frames, as suits the network; None: of none.
    `differ`: whether the frames' droplets differ in size so that no scale suits all frames.
    """

    detector: Finder
    cfg: Cfg
    weights: Path
    scale: float
    settings: dict[str, Value] = field(default_factory=dict)
    region: Region | None = None
    stretching: Stretching | None = None
    alone: float | None = None
    differ: bool = False


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """A network, its weights, and what its inputs show of frames, each for droplets of some sizes.

    No canvases: as the frames suggest. `settings`: what was chosen from frames, for the report.
    `alone` and `differ`: as `OpenedDetector` has them.
    """

    cfg: Cfg
    weights: Path
    canvases: Sequence[tuple[Sizes | None, Canvas]]
    settings: dict[str, Value] = field(default_factory=dict)
    alone: float | None = None
    differ: bool = False


def open_detector(
    config: DetectorConfig,
    size: tuple[int, int],
    samples: Callable[[], Sequence[Frame]],
    *,
    live: bool,
    say: Say,
    engines: Engines | None = None,
    each: bool = False,
    looks: int = 1,
) -> OpenedDetector:
    """A detector for frames of a size (width, height) px; `live`: for the shortest time a frame.

    `samples`: some of the frames, which are asked for where something is to be chosen from them.
    `say` is told what was chosen, which engines were not used, and why. `engines`: of other videos.
    `each`: frames are normalised one by one, by who has them detected; otherwise all alike.
    `looks`: how many, where the configuration does not say, if the scale is not the network's own.
    Raises DroptrackError for what is not to be had as it is wanted.
    """
    width, height = size
    plan = _given(config, width, height)
    choosing = _chooses_model(config) or not plan.canvases
    frames = samples() if config.normalises or choosing else ()
    engines = Engines() if engines is None else engines
    if choosing:
        plan = _chosen(plan, config, _Samples(frames, each), say, engines)
    normalisation, _ = _Samples(frames, each).as_seen(config, plan.weights)
    if normalisation.channel or normalisation.levels:
        say(f"the network sees {normalisation}, of {len(frames)} frames; otherwise: --as-it-is")
    with explained(say):
        decoding.load_loops()
        droplets.load_loops()
    region = None if config.region is None else Region.read(config.region, width, height)
    n_looks = config.looks or (looks if _is_scaled(config, plan) else 1)
    choose = partial(
        choose_detector,
        backend=config.backend,
        precision=config.precision,
        live=live,
        say=say,
        engines=engines,
    )
    first = plan.canvases[0][1]
    scales = [canvas.scale for _, canvas in plan.canvases]
    return OpenedDetector(
        detector=_finder(plan, config, n_looks, normalisation, region, choose),
        cfg=resized(plan.cfg, *first.network),
        weights=plan.weights,
        scale=first.scale,
        settings={
            "scale": first.scale if len(scales) == 1 else [f"{scale:.3g}" for scale in scales],
            **plan.settings,
            "looks": n_looks,
            "network_sees": str(normalisation),
        },
        region=region,
        stretching=_stretching(plan.weights) if config.normalises else None,
        alone=plan.alone,
        differ=plan.differ,
    )


@dataclass(frozen=True)
class _Samples:
    """Some frames of a video, normalised alike; or of images, `each` by its own contrast."""

    frames: Sequence[Frame]
    each: bool

    def as_seen(self, config: DetectorConfig, weights: Path) -> tuple[Normalisation, list[Frame]]:
        """How a network with these weights is to see frames, and what it sees of these."""
        frames, stretching = self.frames, _stretching(weights)
        seen = Normalisation(dark=config.dark)
        if config.normalises and self.each:
            frames = [normalisation_for([one], stretching=stretching).shown(one) for one in frames]
        elif config.normalises:
            seen = normalisation_for(frames, dark=config.dark, stretching=stretching)
        return seen, [seen.shown(frame) for frame in frames]


def _stretching(weights: Path) -> Stretching:
    """What suits a network with these weights."""
    return GENTLE if weights == MODELS[FOOTAGE] else FULL


def _is_scaled(config: DetectorConfig, plan: _Plan) -> bool:
    """Whether the scale of frames is given or chosen, not that of the network's own size."""
    given = config.scale is not None or config.diameter_px is not None
    return config.size is None and (given or plan.weights == MODELS[FOOTAGE])


def _looks_around(canvas: Canvas, n: int) -> list[Canvas]:
    """Canvases of `n` looks at a frame, but for those whose inputs would be too large."""
    scales = [canvas.scale * factor for factor in look_factors(n)[1:]]
    others = [Canvas.of(*canvas.frame, scale) for scale in scales]
    return [canvas, *(one for one in others if max(one.network) <= MAX_SIDE_PX)]


def _finder(
    plan: _Plan,
    config: DetectorConfig,
    n_looks: int,
    normalisation: Normalisation,
    region: Region | None,
    choose: Callable[[Network], Detector],
) -> Finder:
    """What finds the droplets of all sizes, with `n_looks` at each frame."""

    def look(canvas: Canvas) -> Detector:
        network = Network(
            resized(plan.cfg, *canvas.network),
            plan.weights,
            threshold=config.score if n_looks == 1 else min(config.score, MIN_SCORE),
            max_iou=config.max_iou,
            normalisation=normalisation,
            canvas=canvas,
            region=region if n_looks == 1 else None,
        )
        return choose(network)

    levels: list[tuple[Sizes | None, Detector | SeveralLooks]] = []
    for sizes, canvas in plan.canvases:
        looks = [look(one) for one in _looks_around(canvas, n_looks)]
        several = SeveralLooks(looks, config.score, region)
        levels.append((sizes, looks[0] if n_looks == 1 else several))
    sized = [(sizes, detector) for sizes, detector in levels if sizes is not None]
    return Pyramid(sized) if sized else levels[0][1]


def _given_canvases(
    config: DetectorConfig, network: Cfg, width: int, height: int
) -> list[tuple[Sizes | None, Canvas]]:
    """How large the network's inputs are, and what each shows; none: as the frames suggest.

    With the sizes of the droplets that it is for, where these are given. Raises DroptrackError.
    """
    given = [name for name in ("size", "scale", "diameter_px") if getattr(config, name) is not None]
    if len(given) > 1:
        options = " and ".join(f"--{name.removesuffix('_px')}" for name in given)
        raise DroptrackError(f"{options}: each says how large the input is; give one of them")
    own = (network.width, network.height)
    if config.size is not None and (config.looks or 1) > 1:
        raise DroptrackError("--size and --looks: looks are at several scales; give --scale")
    if config.size is not None:
        return [(None, Canvas(own, (width, height), (width, height)))]
    if isinstance(config.diameter_px, tuple):
        levels = levels_for(*config.diameter_px)
        return [(sizes, _canvas_at(sizes.scale, width, height)) for sizes in levels]
    scale = config.scale
    if config.diameter_px is not None:
        scale = DIAMETER_PX / config.diameter_px
    fits_frames = _chooses_model(config) or config.weights == Path(FOOTAGE)
    if scale == AUTO or (scale is None and fits_frames):
        return []
    if scale is None:
        return [(None, Canvas.like(width, height, own))]
    return [(None, _canvas_at(float(scale), width, height))]


def _chooses_model(config: DetectorConfig) -> bool:
    """Whether one of the bundled models is to be taken, as the frames suggest."""
    return config.weights is None and config.cfg is None


def _given(config: DetectorConfig, width: int, height: int) -> _Plan:
    """What is said of the network and of its inputs for frames of a size, px."""
    cfg, weights = find_network(config.weights, config.cfg, config.size)
    canvases = _given_canvases(config, cfg, width, height)
    return _Plan(cfg=cfg, weights=weights, canvases=canvases)


def _chosen(
    plan: _Plan, config: DetectorConfig, samples: _Samples, say: Say, engines: Engines
) -> _Plan:
    """A plan with what was left open as some frames of one size suggest it."""
    height, width = samples.frames[0].shape[:2]
    if _chooses_model(config):
        default = Canvas.like(width, height, (plan.cfg.width, plan.cfg.height))
        own = plan.canvases[0][1] if plan.canvases else default
        model, agreed = _chosen_model(config, own, samples, engines, given=bool(plan.canvases))
        cfg, weights = find_network(Path(model), size=config.size)
        settings: dict[str, Value] = {
            "model": model,
            "model_agreement": agreed,
            "model_chosen_from": len(samples.frames),
        }
        canvases = plan.canvases
        if model == SIMULATIONS:
            canvases = canvases or [(None, own)]
        else:
            say(
                "the model for droplets as laboratories film them; the other: --weights simulations"
            )
        plan = _Plan(cfg=cfg, weights=weights, canvases=canvases, settings=settings)
    if plan.canvases:
        return plan
    _, shown = samples.as_seen(config, plan.weights)
    return _with_chosen_canvases(plan, config, shown, say, engines)


def _chosen_model(
    config: DetectorConfig, canvas: Canvas, samples: _Samples, engines: Engines, *, given: bool
) -> tuple[str, float]:
    """The bundled model that suits some frames, and how well both agree on these.

    `given`: whether the canvas is; otherwise the model for footage chooses its scale.
    """
    found = []
    for model in (SIMULATIONS, FOOTAGE):
        cfg, weights = find_network(Path(model))
        network = Network(
            resized(cfg, *canvas.network),
            weights,
            threshold=scale_evidence.SURE,
            max_iou=config.max_iou,
            canvas=canvas,
        )
        detector = choose_detector(network, config.backend, config.precision, engines=engines)
        _, shown = samples.as_seen(config, weights)
        found.append([detector.detect([frame])[0] for frame in shown])
    agreed = agreement(*found)
    large = given or typical_side(found[0]) * canvas.scale >= MIN_SIDE_PX
    return SIMULATIONS if large and agreed >= MIN_AGREEMENT else FOOTAGE, agreed


def _canvas_at(scale: float, width: int, height: int) -> Canvas:
    canvas = Canvas.of(width, height, scale)
    if max(canvas.network) > MAX_SIDE_PX:
        raise DroptrackError(
            f"a scale of {scale:.3g} makes an input of {canvas.network[0]} x {canvas.network[1]} "
            f"px; sides of up to {MAX_SIDE_PX} px are computed"
        )
    return canvas


def _with_chosen_canvases(
    plan: _Plan, config: DetectorConfig, samples: Sequence[Frame], say: Say, engines: Engines
) -> _Plan:
    """A plan with the canvases whose scales suit some frames best, and how they were chosen."""
    height, width = samples[0].shape[:2]
    own = Canvas.like(width, height, (plan.cfg.width, plan.cfg.height))
    tile = resized(plan.cfg, scale_evidence.TILE, scale_evidence.TILE)
    threshold = scale_evidence.MIN_SCORE
    network = Network(tile, plan.weights, threshold=threshold, max_iou=config.max_iou)
    detector = choose_detector(network, config.backend, engines=engines)
    choice = choose_scale(samples, detector, own.scale)
    settings: dict[str, Value] = {
        "scale_chosen_from": len(samples),
        "scale_quality": [f"{s:.3g}: {quality:.2f}" for s, quality in choice.quality.items()],
    }
    plan = replace(plan, settings=plan.settings | settings, differ=choice.differ)
    if not choice.quality:
        say(
            f"no droplet is clear in {len(samples)} of the frames: the network sees them at a "
            f"scale of {own.scale:.2f}; another one: --scale or --diameter"
        )
    if choice.levels:
        scales = " and ".join(f"{scale:.2f}" for _, scale in choice.levels)
        say(
            f"droplets of {len(samples)} of the frames are of many sizes: the network sees these "
            f"at scales of {scales}; one alone: --scale {choice.scale:.2f}"
        )
        levels = [(sizes, Canvas.of(width, height, scale)) for sizes, scale in choice.levels]
        return replace(plan, canvases=levels, alone=choice.scale)
    canvas = own
    if not math.isclose(choice.scale, own.scale):
        canvas = Canvas.of(width, height, choice.scale)
        say(
            f"the network sees the frames at a scale of {choice.scale:.2f}, where it finds most of "
            f"the droplets of {len(samples)} of them; another one: --scale or --diameter"
        )
    return replace(plan, canvases=[(None, canvas)])
