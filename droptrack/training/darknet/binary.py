"""A Darknet binary: where it is, which fork it is, how to start it, the weights it leaves behind.

It runs in the run folder, with a data file of its own there, so that all it writes lands in it.
"""

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from droptrack.data.darknet_dataset import DataSet
from droptrack.data.files import write_text
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg
from droptrack.network.darknet_weights import read_weights
from droptrack.network.quantisation import sha256_of
from droptrack.training.darknet.console import ESCAPES


@dataclass(frozen=True)
class Darknet:
    """A binary, which of the living forks it is, and what it calls its version."""

    path: Path
    fork: str  # "AlexeyAB" or "hank-ai"
    version: str

    def about(self) -> dict[str, str]:
        """For the run file."""
        return {
            "trainer": f"Darknet of {self.fork}, {self.version}",
            "darknet": str(self.path),
            "sha256": sha256_of(self.path),
        }


@dataclass(frozen=True, kw_only=True)
class DarknetSettings:
    """How to run Darknet, beside what the ``.cfg`` says."""

    gpus: str  # as Darknet wants them, "0,1"; "" for its choice
    save_every: int  # iterations between snapshots (hank-ai: always 100)
    map_every: int  # iterations between measurements of the mAP, about
    patience: int  # measurements of the mAP without a new best that end the training; 0: never
    hang_seconds: float  # without output after which Darknet is stopped


def find_darknet(given: Path | None) -> Path | None:
    """The binary given, or that of $DARKNET, or ``darknet`` on the PATH; None without any.

    Raises DroptrackError where one is named that is not there or cannot be run.
    """
    for name, path in (("--darknet", given), ("$DARKNET", os.environ.get("DARKNET"))):
        if path:
            found = shutil.which(path)
            if found is None or not Path(found).is_file():
                raise DroptrackError(f"{name} {path}: is no program that can be run; correct it")
            return Path(found).resolve()
    on_path = shutil.which("darknet")
    return Path(on_path).resolve() if on_path else None


def identify(path: Path) -> Darknet:
    """Ask a binary what it is. Raises DroptrackError for one that is no Darknet."""
    try:
        answer = subprocess.run(
            [path, "version"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=60,
            check=False,
        ).stdout.decode("utf-8", errors="replace")
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DroptrackError(f"{path}: does not answer `version`: {error}") from None
    if found := re.search(r"Darknet\s+(.*v\d+\.\d+\S*)", ESCAPES.sub("", answer)):
        return Darknet(path, "hank-ai", found[1].strip())
    if "Not an option: version" in answer:
        return Darknet(path, "AlexeyAB", "which names no version")
    if found := re.search(r"CUDA (?:status )?Error.*", answer):
        raise DroptrackError(
            f"{path}: is built for a GPU and finds none that works: {found[0].strip()!r}; mend the "
            "driver, or build Darknet with GPU=0"
        )
    raise DroptrackError(f"{path}: is no Darknet: `version` answers {answer[:80]!r}")


def write_data_files(
    darknet: Darknet, folder: Path, data: DataSet, settings: DarknetSettings
) -> None:
    """Write obj.data and the files it names into the run folder, the lists with whole paths.

    Darknet drops the spaces of a data file's lines, so the names in it have none.
    """
    write_text(folder / "obj.names", "".join(f"{name}\n" for name in data.names))
    for split, images in (("train", data.train), ("valid", data.valid)):
        text = "".join(f"{image.resolve()}\n" for image in images)
        write_text(folder / f"{split}.txt", text)
    lines = {
        "classes": len(data.names),
        "train": "train.txt",
        "valid": "valid.txt",
        "names": "obj.names",
        "backup": ".",
    }
    if darknet.fork == "AlexeyAB":  # it writes _last only if more often than numbered snapshots
        lines["savelast"] = min(settings.save_every, 999)
    write_text(folder / "obj.data", "".join(f"{key} = {value}\n" for key, value in lines.items()))


def training_command(
    darknet: Darknet,
    cfg: Cfg,
    data: DataSet,
    settings: DarknetSettings,
    start: Path | None,
    first: int,
    with_map: bool,
) -> list[str]:
    """The arguments that start a training in the run folder.

    `start`: weights to begin with; they have done `first` iterations of this run.
    """
    command = [str(darknet.path), "detector", "train", "obj.data", cfg.path.name]
    if start is not None:
        command += [str(start.resolve())] if first else [str(start.resolve()), "-clear"]
    command += ["-dont_show"]
    if with_map:
        command += ["-map"]
    if darknet.fork == "hank-ai":
        command += ["-nocolour"]
    elif with_map:
        epochs = settings.map_every * cfg.net.integer("batch") / len(data.train)
        command += ["-mAP_epochs", str(max(1, round(epochs)))]
    if settings.gpus:
        command += ["-gpus", settings.gpus]
    return command


def furthest_weights(folder: Path, cfg: Cfg) -> tuple[Path, int] | None:
    """The complete, finite weights of a run with the highest iteration, and that iteration.

    A Darknet that was killed may leave half a file, and one that was interrupted a ``_final`` of an
    earlier iteration.
    """
    batch = cfg.net.integer("batch")
    found = None
    for path in folder.glob(f"{cfg.path.stem}_*.weights"):
        if not re.fullmatch(r"last|final|\d+", path.stem.removeprefix(f"{cfg.path.stem}_")):
            continue
        try:
            iteration = read_weights(path, cfg).images_seen // batch
        except DroptrackError:
            continue
        if found is None or iteration > found[1]:
            found = path, iteration
    return found
