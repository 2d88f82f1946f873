"""The stage ``networks``: those that exist are used, others are trained, or not to be had.

The bundled model is always there. The paper's own two, YOLOv3-tiny on scenes a and b and YOLOv3 on
scene c, are taken from where ``make train-tiny`` and ``make train`` leave them, or from what
``--tiny-weights`` and ``--full-weights`` name.
"""

import csv
import shutil
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.reproduction.data_sets import data_file
from bench.reproduction.folder import Given, Reproduction
from bench.reproduction.settings import Recipe
from droptrack.data.darknet_dataset import read_data_file
from droptrack.errors import DroptrackError
from droptrack.evaluation.network_scores import evaluate_network
from droptrack.network.bundled import BUNDLED, find_network
from droptrack.network.quantisation import sha256_of
from droptrack.training.config import Optimizer, Trainer, TrainingConfig, TrainingPrecision
from droptrack.training.log import read_log
from droptrack.training.run import train

RUNS = {"tiny": Path("runs/yolov3-tiny"), "full": Path("runs/yolov3")}  # of the Makefile
PAPER_NAMES = {"tiny": "YOLOv3-tiny", "full": "YOLOv3"}


def given_weights(given: Given, name: str) -> Path | None:
    """Weights of the paper's network ``tiny`` or ``full`` that exist already, or None.

    Raises DroptrackError where those that were named are not there.
    """
    named = given.tiny_weights if name == "tiny" else given.full_weights
    if named is not None:
        if not named.is_file():
            raise DroptrackError(f"--{name}-weights {named}: no such file")
        return named
    for kind in ("final", "best"):
        for path in sorted(RUNS[name].glob(f"*_{kind}.weights")):
            return path
    return None


def existing(given: Given) -> Sequence[object]:
    """What the stage depends on: the weights that exist."""
    return [given_weights(given, name) for name in RUNS]


def make_networks(of: Reproduction, say: Callable[[str], None]) -> dict[str, Any]:
    """Find or train the networks, and measure the mAP of each on images it has not seen."""
    found: dict[str, Any] = {"bundled": _scored(of, "the bundled model", None, ["tiny", "full"])}
    for name in RUNS:
        recipe: Recipe = getattr(of.settings, name)
        weights, trained_here = given_weights(of.given, name), False
        if weights is None and recipe.iterations:
            weights, trained_here = _trained(of, name, recipe, say), True
        if weights is None:
            say(f"{PAPER_NAMES[name]}: no trained weights here; {needs(name)}")
            found[name] = {"missing": needs(name)}
            continue
        found[name] = {
            **_scored(of, PAPER_NAMES[name], weights, [name]),
            "trained_here": trained_here,
            "command": recipe.command() if trained_here else f"make {MAKE[name]}",
            "log": _log_of(weights),
        }
    return found


MAKE = {"tiny": "train-tiny", "full": "train"}


def needs(name: str) -> str:
    """What a network that is missing needs."""
    hours = {"tiny": "two hours", "full": "1 h 45 min at 608 x 320 px"}[name]
    return (
        f"make reproduce SCALE=paper trains it (about {hours} of one CPU core), or make "
        f"{MAKE[name]} does at the paper's settings (a GPU), or --{name}-weights names it"
    )


def _scored(of: Reproduction, title: str, weights: Path | None, sets: list[str]) -> dict[str, Any]:
    cfg, path = find_network(weights)
    rows: list[dict[str, Any]] = []
    for name in sets:
        data = read_data_file(data_file(of, name))
        report = evaluate_network(data, cfg, path)
        rows += [{key: row[key] for key in SHOWN} for row in report.droplets]
    return {
        "title": title,
        "network": f"{cfg.path.stem}, {cfg.width} x {cfg.height} px",
        "weights": path.name if weights is None else str(path),
        "sha256": sha256_of(path),
        "scenes": rows,
    }


SHOWN = ("scene", "n_images", "n_droplets", "map_50", "precision", "recall", "average_iou",
         "coco_ap_50_95")  # fmt: skip


def _trained(of: Reproduction, name: str, recipe: Recipe, say: Callable[[str], None]) -> Path:
    """The weights that a recipe gives, trained on from the last snapshot where there is one."""
    if find_spec("torch") is None:
        raise DroptrackError("training needs PyTorch: pip install 'droptrack[train]', or make dev")
    from droptrack.training.pytorch.devices import computes_faster_in_bf16

    bf16 = computes_faster_in_bf16()
    out = of.folder("networks") / name
    final = out / f"{recipe.cfg}_final.weights"
    if final.exists():
        return final
    resume = (out / f"{recipe.cfg}_checkpoint.pt").exists()
    if out.exists() and not resume:
        shutil.rmtree(out)
    train(
        TrainingConfig(
            cfg=BUNDLED / f"{recipe.cfg}.cfg",
            data=data_file(of, name),
            out=out,
            trainer=Trainer.torch,
            resume=resume,
            iterations=recipe.iterations,
            batch=recipe.batch,
            subdivisions=1,
            learning_rate=0.001,
            optimizer=Optimizer.adamw,
            window=recipe.window,
            sizes=recipe.sizes,
            draw=recipe.draw,
            seed=of.settings.seed,
            precision=TrainingPrecision.bf16 if bf16 else TrainingPrecision.fp32,
            map_every=recipe.map_every,
            map_images=recipe.map_images,
            save_every=50,
        ),
        say,
    )
    return final


def _log_of(weights: Path) -> dict[str, Any] | None:
    """The training's loss and mAP, where its log lies beside the weights."""
    path = weights.parent / "training.csv"
    try:
        steps = read_log(path)
    except (DroptrackError, csv.Error):
        return None
    if not steps:
        return None
    measured = [step for step in steps if step.mean_ap == step.mean_ap]
    return {
        "iterations": [step.iteration for step in steps],
        "loss": [step.average_loss for step in steps],
        "map_at": [step.iteration for step in measured],
        "map": [step.mean_ap for step in measured],
        "n_images": sum(step.images for step in steps[-1:]),
        "seconds": sum(step.seconds for step in steps),
    }
