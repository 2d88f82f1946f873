"""One adaptation from a video to weights: look, measure, draw, train, compare."""

import json
import math
import shutil
import time
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from droptrack.adaptation.appearance import Measured, measure
from droptrack.adaptation.comparison import Quality, quality, table, verdict
from droptrack.adaptation.config import AdaptationConfig
from droptrack.adaptation.contact_sheet import write_contact_sheet
from droptrack.adaptation.footage import (
    Footage,
    LabelledShot,
    Shot,
    is_still,
    labelled_shots,
    read_footage,
    read_labelled,
)
from droptrack.adaptation.looking import Looks, open_looks, seen_once
from droptrack.adaptation.training_set import (
    N_TRAIN,
    N_VALID,
    Ingredients,
    write_training_set,
)
from droptrack.adaptation.trust import Trust, of_labels, trust
from droptrack.data.arrays import Floats
from droptrack.data.darknet_dataset import read_data_file, read_labels
from droptrack.data.files import replacing, write_text
from droptrack.data.report import Report, Value
from droptrack.data.set_up import write_set_up
from droptrack.detection.scale import AUTO, STRIDE, Canvas
from droptrack.errors import DroptrackError
from droptrack.network.bundled import FOOTAGE, find_network
from droptrack.network.darknet_cfg import Cfg, cfg_text, read_cfg, with_options, yolo_heads
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.notes import Say, to_stderr
from droptrack.pipeline.results_folder import whole_name
from droptrack.progress import progress_bar
from droptrack.training.config import Optimizer, Trainer, TrainingConfig, TrainingPrecision
from droptrack.training.run import image_source, train
from droptrack.version import __version__

NAME = "adapted"  # of the network
CLAIM = "adapt.json"  # in the folder: what is adapted, and how
MIN_DROPLETS = 10  # that adapt can learn from
WINDOW = (416, 224)  # px of the network's input that an image of a batch shows, at most
SIZES = (0.8, 1.25)  # range of the factor on the scale in training
DRAWINGS = "everything"  # the scene of what the network knew before
SHOWN = 4  # images kept back, on the contact sheet


@dataclass(frozen=True)
class Adaptation:
    """What an adaptation left: its folder, its report, and whether it helped."""

    folder: Path
    report: Report
    helped: bool

    @property
    def weights(self) -> Path:
        """The new network; its ``.cfg`` lies beside it."""
        return self.folder / f"{NAME}.weights"


def adapt(config: AdaptationConfig, say: Say = to_stderr) -> Adaptation:
    """Train a network on for the droplets of one's own video.

    The folder `config.out` gets ``adapted.weights`` and ``adapted.cfg``, ``report.json`` and
    ``contact_sheet.png``; besides, what was learned from: ``set_up.npz``, ``dataset`` and
    ``training``. `say` is told what happens. Raises DroptrackError for a video that nothing can be
    learned from, before any weights are written.
    """
    began = time.perf_counter()
    if config.weights is None and config.cfg is None:
        config = replace(config, weights=Path(FOOTAGE))
    wanted = _check(config)
    found = _look(config, say)
    config.out.mkdir(parents=True, exist_ok=True)
    write_text(config.out / CLAIM, json.dumps(wanted, indent=1) + "\n")
    drawn = _draw(config, found, say)
    _train(config, found, drawn, say)
    return _compare(config, found, began, say)


@dataclass(frozen=True, kw_only=True)
class _Found:
    """What was seen and measured, and the network that saw it."""

    footage: Footage
    kept_labels: tuple[LabelledShot, ...]
    looks: Looks
    trust: Trust
    measured: Measured
    network: Cfg  # as trained: its input has the images' shape
    weights: Path  # it starts from


def _check(config: AdaptationConfig) -> dict[str, Value]:
    """All that decides the result.

    Raises DroptrackError where nothing can be trained, or the folder has other results.
    """
    if find_spec("torch") is None:
        raise DroptrackError("adapt trains with PyTorch: pip install 'droptrack[train]'")
    network, weights = find_network(config.weights, config.cfg, config.size)
    classes = {head.classes for head in yolo_heads(network)}
    if classes != {1}:
        raise DroptrackError(
            f"{network.path}: has {max(classes)} classes; adapt knows droplets only, one class"
        )
    if isinstance(config.diameter_px, tuple):
        raise DroptrackError("adapt learns at one scale: give one --diameter, a typical one")
    wanted = _settings(config, network, weights)
    claim = config.out / CLAIM
    if config.resume:
        if not claim.exists():
            raise DroptrackError(f"{config.out}: has no adaptation; start without --resume")
        before = json.loads(claim.read_text(encoding="utf-8"))
        differing = [key for key, value in wanted.items() if before.get(key) != value]
        if differing:
            raise DroptrackError(
                f"{config.out}: was begun with other {', '.join(differing)}; the same ones resume "
                "it, another --out begins anew"
            )
    elif config.out.exists() and any(config.out.iterdir()):
        raise DroptrackError(
            f"{config.out}: is not empty; choose another --out, or resume with --resume"
        )
    return wanted


def _settings(config: AdaptationConfig, network: Cfg, weights: Path) -> dict[str, Value]:
    scale = config.scale
    return {
        "made by": f"droptrack {__version__}, droptrack.adapt",
        "video": whole_name(config.video),
        "labels": "" if config.labels is None else str(config.labels),
        "network": str(network.path),
        "weights": str(weights),
        "weights sha256": sha256_of(weights),
        "size": config.size or "",
        "scale": "" if scale is None else str(scale),
        "diameter_px": str(config.diameter_px or ""),
        "levels": str(config.reading.levels or ""),
        "channel": str(config.reading.channel),
        "iterations": config.iterations,
        "batch": config.batch,
        "learning_rate": config.learning_rate,
        "seed": config.seed,
    }


def _look(config: AdaptationConfig, say: Say) -> _Found:
    """Find droplets that can be learned from, and measure how they look."""
    labels = None if config.labels is None else read_labelled(config.labels)
    at_least = (0, 0)
    if labels is not None:
        at_least = (
            max(frame.shape[1] for _, frame in labels[0]),
            max(frame.shape[0] for _, frame in labels[0]),
        )
    footage = read_footage(config.video, config.reading, at_least)
    if footage.moving and is_still([*footage.used, *footage.kept]):
        raise DroptrackError(
            f"{config.video}: nothing moves in it, so droplets cannot be told from what is around "
            "them; adapt needs a video of moving droplets, or a folder of different images"
        )
    taught: list[LabelledShot] = []
    kept: list[LabelledShot] = []
    if labels is not None:
        taught, kept = labelled_shots(*labels, footage.size)
    given = (config.size, config.scale, config.diameter_px)
    looking = config if given != (None, None, None) else replace(config, scale=AUTO)
    looks = open_looks(looking, footage.used, say)
    with progress_bar("images") as bar:
        shots = bar.track(footage.used, description="looking")
        known = trust(footage, looks, shots)
    n = known.n_droplets + sum(len(one.truth) for one in taught)
    if n < MIN_DROPLETS:
        raise DroptrackError(
            f"{config.video}: {n} droplets found that can be learned from; try --scale or "
            "--diameter, other --weights, or give some --labels"
        )
    _say_how(config, footage, known, taught, say)
    measured = measure(known, of_labels(taught))
    opened = looks.opened
    return _Found(
        footage=footage,
        kept_labels=tuple(kept),
        looks=looks,
        trust=known,
        measured=measured,
        network=opened.cfg,
        weights=opened.weights,
    )


def _say_how(
    config: AdaptationConfig,
    footage: Footage,
    known: Trust,
    labelled: list[LabelledShot],
    say: Say,
) -> None:
    """Tell what is learned from."""
    name = config.video
    if known.by_tracks:
        say(
            f"{name}: {known.n_droplets} droplets of {known.n_tracks} long and steady tracks in "
            f"{len(footage.used)} frames; {len(footage.kept)} frames are kept back"
        )
    else:
        say(
            f"{name}: its images cannot be tracked, as if they had nothing to do with one another: "
            f"{known.n_droplets} droplets are those that are seen at several scales alike, in "
            f"{len(footage.used)} images; {len(footage.kept)} are kept back"
        )
    if labelled:
        n = sum(len(one.truth) for one in labelled)
        say(f"{config.labels}: {n} labelled droplets in {len(labelled)} images count most")


def _draw(config: AdaptationConfig, found: _Found, say: Say) -> Path:
    """The data set that is trained on; one that is there already stays. Returns its obj.data."""
    folder = config.out / "dataset"
    if (folder / "obj.data").exists():
        return folder / "obj.data"
    set_up = config.out / "set_up.npz"
    write_set_up(set_up, found.measured.set_up)
    diameters = found.measured.diameters
    if len(diameters):
        low, middle, high = np.percentile(diameters, [10, 50, 90])
        say(
            f"{config.video}: droplets of {middle:.0f} px ({low:.0f} to {high:.0f}), "
            f"{'pressed together, ' if found.measured.set_up.dense else ''}noise "
            f"{found.measured.set_up.noise:.1f} grey levels, {len(found.measured.set_up.views)} "
            "view(s) of the camera"
        )
    given = Ingredients(
        measured=found.measured,
        draw_own=image_source(str(set_up)),
        draw_known=image_source(DRAWINGS),
        canvas=_canvas(found),
    )
    with progress_bar("images") as bar:
        task = bar.add_task("drawing", total=N_TRAIN + N_VALID, note="")
        for n in write_training_set(folder, given, config.seed):
            bar.update(task, completed=n)
    return folder / "obj.data"


def _canvas(found: _Found) -> Canvas:
    """What the network was shown of the images: more than them, or they were a little stretched."""
    size, network = found.footage.size, (found.network.width, found.network.height)
    canvas = Canvas.of(*size, found.looks.scale)
    return canvas if canvas.network == network else Canvas(network, size, size)


def _train(config: AdaptationConfig, found: _Found, data: Path, say: Say) -> None:
    """Train the network on, or resume that; writes adapted.cfg and adapted.weights."""
    weights, cfg = config.out / f"{NAME}.weights", config.out / f"{NAME}.cfg"
    if weights.exists():
        return
    most = max(len(read_labels(image)[1]) for image in read_data_file(data).train)
    heads = [layer for layer in found.network.layers if layer.kind == "yolo"]
    max_boxes = max(most, *(layer.integer("max", 200) for layer in heads))  # of an image
    write_text(cfg, cfg_text(with_options(found.network, {}, {"max": str(max_boxes)})))
    network, run = read_cfg(cfg), config.out / "training"
    final = run / f"{NAME}_final.weights"
    if not final.exists():
        resume = (run / f"{NAME}_checkpoint.pt").exists()
        if run.exists() and not resume:
            shutil.rmtree(run)  # was interrupted before its first snapshot
        from droptrack.training.pytorch.devices import computes_faster_in_bf16

        bf16 = computes_faster_in_bf16()
        training = TrainingConfig(
            cfg=cfg,
            data=data,
            out=run,
            trainer=Trainer.torch,
            weights=found.weights,
            resume=resume,
            iterations=config.iterations,
            batch=config.batch,
            subdivisions=1,
            learning_rate=config.learning_rate,
            save_every=25,
            map_every=config.iterations,
            map_images=1,
            optimizer=Optimizer.adamw,
            window=_window(network),
            sizes=SIZES,
            seed=config.seed,
            precision=TrainingPrecision.bf16 if bf16 else TrainingPrecision.fp32,
            frozen_statistics=True,
        )

        def tell(text: str) -> None:
            say(text)

        train(training, tell)
    with replacing(weights) as partial:
        shutil.copyfile(final, partial)


def _window(network: Cfg) -> tuple[int, int]:
    """What an image of a batch shows, px of the network's input: all of it, if it is small."""
    whole = (
        STRIDE * math.ceil(SIZES[1] * side / STRIDE) for side in (network.width, network.height)
    )
    width, height = (min(most, side) for most, side in zip(WINDOW, whole, strict=True))
    return width, height


def _compare(config: AdaptationConfig, found: _Found, began: float, say: Say) -> Adaptation:
    """Look at what was kept back with both networks; writes the report and the contact sheet."""
    network = config.out / f"{NAME}.weights"
    adapted = replace(
        config,
        weights=network,
        cfg=config.out / f"{NAME}.cfg",
        size=None,
        diameter_px=None,
        scale=found.looks.scale,
    )
    looks = open_looks(adapted, found.footage.used, _silent)
    shots, labels = found.footage.kept, found.kept_labels
    tracked = found.trust.by_tracks
    before = quality(found.looks, shots, labels, config.score, tracked=tracked)
    after = quality(looks, shots, labels, config.score, tracked=tracked)
    helped, why = verdict(before, after)
    old = read_cfg(found.network.path)
    settings = _settings(config, old, found.weights)
    report = Report(
        "Adaptation",
        {**settings, "scale": looks.scale},
        _summary(found, after, time.perf_counter() - began, helped=helped, why=why),
        table(before, after),
    )
    report.write_json(config.out / "report.json")
    pairs = [
        (shot.frame, _boxes(found.looks, shot, config.score), _boxes(looks, shot, config.score))
        for shot in shots[:: max(1, len(shots) // SHOWN)]
    ]
    data = read_data_file(config.out / "dataset" / "obj.data")
    write_contact_sheet(config.out / "contact_sheet.png", found.measured, data, pairs)
    return Adaptation(config.out, report, helped)


def _silent(_: str) -> None:
    """Say nothing."""


def _boxes(looks: Looks, shot: Shot, score: float) -> Floats:
    found = seen_once(looks, shot)
    return found.boxes[found.scores >= score]


def _summary(
    found: _Found, after: Quality, seconds: float, *, helped: bool, why: str
) -> dict[str, Value]:
    """What was learned from, and what came of it."""
    diameters = found.measured.diameters
    some = diameters if len(diameters) else np.array([np.nan])
    return {
        "helped": helped,
        "why": why,
        "n_images_used": len(found.footage.used),
        "n_images_kept_back": after.n_images,
        "n_droplets_learned_from": found.trust.n_droplets,
        "learned_by": "tracks" if found.trust.by_tracks else "agreement between scales",
        "n_tracks": found.trust.n_tracks,
        "n_views": len(found.measured.set_up.views),
        "median_diameter_px": float(np.median(some)),
        "noise_grey_levels": found.measured.set_up.noise,
        "dense": found.measured.set_up.dense,
        "seconds": seconds,
    }
