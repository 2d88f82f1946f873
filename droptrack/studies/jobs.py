"""What there is to do: a video with its options, and whether that was done already."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from droptrack.data.files import read_text, write_text
from droptrack.data.report import Value
from droptrack.errors import DroptrackError
from droptrack.network.bundled import find_network, is_bundled
from droptrack.network.quantisation import sha256_of
from droptrack.pipeline.config import TrackingConfig
from droptrack.pipeline.detection_log import NAME as DETECTION_LOG
from droptrack.studies.addresses import is_address, version_of
from droptrack.studies.analyses import FOLDER, told_of
from droptrack.version import __version__

if TYPE_CHECKING:  # it takes longer to import than all else here
    from droptrack.analysis.choice import Asked

RESULTS = ("trajectories.csv", "report.json")
STATE = "state.json"  # in a video's folder: what was asked for, and what came of it
LOG = "log.txt"
FILES = ("weights", "cfg", "appearance", "appearance_weights")  # whose content counts
NOT_OF_RESULTS = (
    "video",
    "out",
    "overwrite",
    "resume",
    "region_option",
    *FILES,
)  # of a configuration

OF_ANALYSIS = "analyse "  # what begins keys of `made_from` that the trajectories do not depend on

State = Literal["running", "done", "failed"]


@dataclass(frozen=True, kw_only=True)
class Job:
    """One video of a study.

    `name`: of its folder, `folder`; `free`: the user's columns; `made_from`: all that its results
    depend on, by names that a user reads; `analyses`: what is done with the trajectories; `again`:
    whether to track though results are there; `address`: where the folder is sent, if it is;
    `version`: of the droptrack that asks for it.
    """

    name: str
    folder: Path
    config: TrackingConfig
    free: Mapping[str, str]
    made_from: Mapping[str, Value]
    analyses: "tuple[Asked, ...]" = ()
    again: bool = False
    address: str = ""
    version: str = __version__

    @property
    def video(self) -> str:
        """The file, folder or address."""
        return self.config.video

    @property
    def place(self) -> str:
        """Where its results are, for a user to look."""
        return self.address or str(self.folder)

    @property
    def identity(self) -> str:
        """What all names of the video have in common."""
        return identity(self.video)


@dataclass(frozen=True, kw_only=True)
class Kept:
    """What a video's folder says of the last run.

    `identity`: of the video; `said`: the lines that were told meanwhile; `facts`: what the report
    has no place for; `tracked`: whether the trajectories are all there; `analysed`: the analyses
    that are.
    """

    state: State
    identity: str
    made_from: Mapping[str, Value]
    reason: str = ""
    version: str = __version__
    said: tuple[str, ...] = ()
    seconds: float = 0.0
    facts: Mapping[str, Value] = field(default_factory=dict)
    tracked: bool = False
    analysed: tuple[str, ...] = ()

    def write(self, folder: Path) -> None:
        """Keep it."""
        write_text(folder / STATE, json.dumps(asdict(self), indent=1) + "\n")


def read_kept(folder: Path) -> Kept | None:
    """What a folder says of its last run; None where it says nothing that can be read."""
    try:
        values = json.loads(read_text(folder / STATE))
        for name in ("said", "analysed"):
            values[name] = tuple(values.get(name, ()))
        values.setdefault("tracked", values["state"] == "done")  # as earlier versions kept it
        return Kept(**values)
    except (DroptrackError, ValueError, TypeError, KeyError):
        return None


def identity(video: str) -> str:
    """What all names of one video have in common: the path that links lead to."""
    return video if is_address(video) else os.path.realpath(video)


def names_before(out: Path) -> dict[str, str]:
    """The names of folders that earlier runs made, by their videos' `identity`.

    Those of videos that are gone are free.
    """
    kept = {path.parent.name: read_kept(path.parent) for path in sorted(out.glob(f"*/{STATE}"))}
    return {
        one.identity: name
        for name, one in kept.items()
        if one is not None and (is_address(one.identity) or os.path.exists(one.identity))  # noqa: PTH110
    }


def job_of(
    name: str,
    folder: Path,
    config: TrackingConfig,
    free: Mapping[str, str],
    analyses: "tuple[Asked, ...]" = (),
) -> Job:
    """A job, whose paths mean the same on all machines that share the disks.

    Raises DroptrackError for a network that there is not.
    """
    video = config.video if is_address(config.video) else os.path.abspath(config.video)  # noqa: PTH100
    folder = folder.absolute()
    config = _absolute(replace(config, video=video, out=folder))
    made_from = _made_from(config) | {
        f"{OF_ANALYSIS}{asked.name}": told_of(asked) for asked in analyses
    }
    return Job(
        name=name, folder=folder, config=config, free=free, made_from=made_from, analyses=analyses
    )


def left_to_do(job: Job) -> str:
    """Why a job is to be done; empty where its results are those that it would give."""
    kept = read_kept(job.folder)
    if kept is None:
        return "new"
    change = _change(kept.made_from, job.made_from)
    if kept.state != "done":
        was = f"failed: {kept.reason}" if kept.state == "failed" else "interrupted"
        return f"{was}; {change}" if change else was
    if change:
        return change
    wanted = (*RESULTS, *(f"{FOLDER}/{name}.json" for name in kept.analysed))
    missing = [name for name in wanted if not (job.folder / name).is_file()]
    return f"{missing[0]} is missing" if missing else ""


def is_tracked(job: Job, kept: Kept | None) -> bool:
    """Whether the trajectories are there that a job would give: only analyses are left to do."""
    return (
        kept is not None
        and kept.tracked
        and not job.again
        and not _change(_of_tracking(kept.made_from), _of_tracking(job.made_from))
        and all((job.folder / name).is_file() for name in RESULTS)
    )


def _of_tracking(made_from: Mapping[str, Value]) -> dict[str, Value]:
    return {key: value for key, value in made_from.items() if not key.startswith(OF_ANALYSIS)}


def can_resume(job: Job) -> bool:
    """Whether an earlier run of the same was ended too early, and left its detections."""
    kept = read_kept(job.folder)
    return (
        kept is not None
        and kept.state != "done"
        and kept.version == job.version
        and not _change(_of_tracking(kept.made_from), _of_tracking(job.made_from))
        and (job.folder / DETECTION_LOG).is_file()
    )


def _change(before: Mapping[str, Value], now: Mapping[str, Value]) -> str:
    """What is another now than it was before, the first of it in words."""
    for key in [*before, *(key for key in now if key not in before)]:
        if before.get(key) != now.get(key):
            if key.startswith(OF_ANALYSIS) and (key not in before or key not in now):
                return f"changed: {key} is {'no longer ' if key in before else ''}asked for"
            was, new = (_short(values.get(key)) for values in (before, now))
            return f"changed: {key} was {was}, and is {new}"
    return ""


def _short(value: Value) -> str:
    text = "the default" if value is None else str(value)
    return f"{text[:12]}..." if len(text) > 40 and text.isalnum() else text


def _made_from(config: TrackingConfig) -> dict[str, Value]:
    """What the results depend on: the files, and the options that are not the defaults."""
    cfg, weights = find_network(config.weights, config.cfg)
    made: dict[str, Value] = {**_version_of(config.video)}
    made["weights sha256"] = sha256_of(weights)
    made["cfg sha256"] = sha256_of(cfg.path)
    tracker, mask = config.tracker, _mask(config)
    for name, path in (
        ("region", mask),
        ("appearance", tracker.appearance),
        ("appearance_weights", tracker.appearance_weights),
    ):
        if path is not None:
            made[f"{name} sha256"] = sha256_of(path)
    changed = _differences(asdict(config), asdict(TrackingConfig(video="")))
    ignored = {*NOT_OF_RESULTS, *(("region",) if mask else ())}
    return made | {key: value for key, value in changed.items() if key not in ignored}


def _mask(config: TrackingConfig) -> Path | None:
    """The image that says where droplets count, if one does."""
    region = config.region
    is_file = region is not None and os.path.isfile(region)  # noqa: PTH113  any text may come
    return Path(region) if region is not None and is_file else None


def _differences(given: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for key, value in given.items():
        if isinstance(value, dict):
            found |= _differences(value, default.get(key) or {})
        elif value != default.get(key) and (key in default or value):
            found["tracker" if key == "name" else key] = _plain(value)
    return found


def _plain(value: Any) -> Value:
    """A value as JSON has it."""
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return [_plain(part) for part in value]  # type: ignore[return-value]
    plain: Value = value
    return plain


def _version_of(video: str) -> dict[str, str | int]:
    """Bytes and time of a file, or of all in a folder; zeros where there is none."""
    if is_address(video):
        try:
            return version_of(video)
        except DroptrackError:  # that it is not there is for its own run to say
            return {"bytes": 0, "modified": ""}
    path = Path(video)
    if path.is_dir():
        stats = [file.stat() for file in os.scandir(path) if file.is_file()]
        return {
            "files": len(stats),
            "bytes": sum(one.st_size for one in stats),
            "modified": max((one.st_mtime_ns for one in stats), default=0),
        }
    if not path.exists():
        return {"bytes": 0, "modified": 0}
    stat = path.stat()
    return {"bytes": stat.st_size, "modified": stat.st_mtime_ns}


def _absolute(config: TrackingConfig) -> TrackingConfig:
    """The configuration with absolute paths."""
    tracker = replace(
        config.tracker,
        appearance=_path(config.tracker.appearance),
        appearance_weights=_path(config.tracker.appearance_weights),
    )
    mask = _mask(config)
    return replace(
        config,
        weights=config.weights if is_bundled(config.weights) else _path(config.weights),
        cfg=_path(config.cfg),
        region=str(mask.absolute()) if mask else config.region,
        tracker=tracker,
    )


def _path(path: Path | None) -> Path | None:
    """A file for any folder to work in."""
    return None if path is None else path.absolute()
