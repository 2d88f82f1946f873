"""A study: what there is to do is listed, done by workers, and gathered."""

import json
import os
import platform
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

from droptrack.data.files import write_text
from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError, InterruptedRunError
from droptrack.pipeline.notes import Say
from droptrack.studies.at_address import Place
from droptrack.studies.choice import WorkersConfig, choose_workers
from droptrack.studies.jobs import Job, job_of, left_to_do, names_before
from droptrack.studies.lists import Entry
from droptrack.studies.names import name_videos
from droptrack.studies.options import Given, VideoOptions, merged
from droptrack.studies.outcome import Outcome
from droptrack.studies.results import write_results
from droptrack.studies.show_progress import BatchProgress
from droptrack.studies.sources import find_videos
from droptrack.studies.workers import Advance, Note, Workers
from droptrack.version import __version__

ABOUT = "batch.json"
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "openvino", "torch", "numba", "pyarrow")


@dataclass(frozen=True, kw_only=True)
class Study:
    """What a batch is told: the videos, the place for all results, and options for each video."""

    sources: tuple[str, ...]
    place: Place
    options: Mapping[str, Given]

    @property
    def out(self) -> Path:
        """The folder for the results on this machine."""
        return self.place.folder


@dataclass(frozen=True, kw_only=True)
class Planned:
    """The videos of a study, and why each is to be done; empty where its results are there."""

    jobs: tuple[Job, ...]
    reasons: tuple[str, ...]

    @property
    def to_do(self) -> list[Job]:
        """Those that are to be done, in their order."""
        return [job for job, reason in zip(self.jobs, self.reasons, strict=True) if reason]

    def part(self, number: int, n_parts: int) -> "Planned":
        """Every `n_parts`-th video, from the `number`-th on, for one of as many commands."""
        keep = slice(number - 1, None, n_parts)
        return Planned(jobs=self.jobs[keep], reasons=self.reasons[keep])


def parse_part(text: str) -> tuple[int, int]:
    """``2/8`` as 2 and 8; raises DroptrackError.

    >>> parse_part("2/8")
    (2, 8)
    """
    match = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", text)
    if match is None or int(match[1]) > int(match[2]):
        raise DroptrackError(f"--part {text}: should be I/N, such as 1/8, with I from 1 to N")
    return int(match[1]), int(match[2])


def plan(study: Study, options: VideoOptions, say: Say, *, redo: bool = False) -> Planned:
    """List the videos of a study and check their options; no results are written.

    Raises DroptrackError for what cannot be as it is asked for, naming the video.
    """
    entries = find_videos(study.sources, options, say)
    study.place.fetch()
    names = name_videos(entries, names_before(study.out))
    _say_of_clashes(entries, names, say)
    jobs = tuple(
        _job(study, options, entry, name) for entry, name in zip(entries, names, strict=True)
    )
    reasons = tuple(left_to_do(job) or ("again, as asked for" if redo else "") for job in jobs)
    if redo:
        jobs = tuple(replace(job, again=True) for job in jobs)
    return Planned(jobs=jobs, reasons=reasons)


def do_study(
    study: Study,
    planned: Planned,
    options: VideoOptions,
    workers: WorkersConfig,
    say: Say,
    *,
    whole: bool = True,
) -> int:
    """Do what a study has left to do, and write its tables; returns how many videos have failed.

    A video that fails is told to `say` and stops no other. `whole`: nobody else does another part,
    so that the tables can be written. Raises DroptrackError where no video can be done any more: a
    full disk, an interruption, workers that are gone.
    """
    outcomes: list[Outcome] = []
    try:
        if planned.to_do:
            with choose_workers(workers, say) as hands:
                n_left = len(planned.jobs) - len(planned.to_do)
                there = f", {n_left} are there already" if n_left else ""
                n = len(planned.to_do)
                say(f"{n} video{'s' if n > 1 else ''} to do{there}; {hands.described}")
                if whole:
                    _write_about(study, planned, options, hands.described)
                _do(study, planned.to_do, hands, outcomes, say)
        elif whole:
            say(f"{len(planned.jobs)} videos: all are there")
            _write_about(study, planned, options, "none")
    except DroptrackError:
        if whole and study.out.is_dir():
            with suppress(OSError, DroptrackError):  # what ended all is what is to be said
                _write_results(study, planned, say)
        raise
    if whole:
        return _write_results(study, planned, say)
    return sum(bool(outcome.reason) for outcome in outcomes)


def _write_results(study: Study, planned: Planned, say: Say) -> int:
    """Write the tables, the data set and the page; returns how many videos have no results."""
    study.place.fetch()  # what workers elsewhere have done
    n_failed = write_results(study.out, planned.jobs, say)
    study.place.send_tables()
    return n_failed


def _do(
    study: Study, jobs: Sequence[Job], workers: Workers, outcomes: list[Outcome], say: Say
) -> None:
    """Do jobs, and add what came of each."""
    told = workers.work(jobs)
    with BatchProgress(len(jobs)) as progress:
        try:
            for item in told:
                if isinstance(item, Advance):
                    progress.advance(item)
                elif isinstance(item, Note):
                    progress.say(item.text, say)
                elif item.other_version:
                    raise DroptrackError(f"{item.reason}{_so_far(outcomes, jobs)}")
                else:
                    outcomes.append(item)
                    progress.done(item)
                    if item.reason:
                        progress.say(f"{printable(item.name)}: failed: {item.reason}", say)
                    if item.disk_is_full:
                        raise DroptrackError(
                            f"{study.place}: the disk is full{_so_far(outcomes, jobs)}"
                        )
        except KeyboardInterrupt:
            raise InterruptedRunError(f"interrupted{_so_far(outcomes, jobs)}") from None
        finally:
            told.close()


def _so_far(outcomes: Sequence[Outcome], jobs: Sequence[Job]) -> str:
    return (
        f" after {len(outcomes)} of {len(jobs)} videos; what was done stays, and the same command "
        "goes on"
    )


def _write_about(study: Study, planned: Planned, options: VideoOptions, described: str) -> None:
    """Write what makes a study's results into ``batch.json``: versions, options, hashes."""
    about = {
        "made by": f"droptrack {__version__}, droptrack.batch",
        "versions": versions(),
        "workers": described,
        "sources": list(study.sources),
        "options": options.words(study.options),
        "videos": [
            {
                "name": job.name,
                "video": job.video,
                "free": dict(job.free),
                "made_from": dict(job.made_from),
            }
            for job in planned.jobs
        ],
    }
    study.out.mkdir(parents=True, exist_ok=True)
    write_text(study.out / ABOUT, json.dumps(about, indent=1) + "\n")


def versions() -> dict[str, str]:
    """Versions of what results depend on."""
    found = {"droptrack": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def _job(study: Study, options: VideoOptions, entry: Entry, name: str) -> Job:
    try:
        given = merged(study.options, entry.options)
        config = options.config(entry.video, given)
        job = job_of(name, study.out / name, config, entry.free, options.analyses(given))
        return replace(job, address=study.place.of(name))
    except DroptrackError as error:
        if entry.options:
            raise DroptrackError(f"{entry.where}: {error}") from None
        raise


def _say_of_clashes(entries: Sequence[Entry], names: Sequence[str], say: Say) -> None:
    """Tell of files with one name what their folders are called."""
    files: dict[str, list[str]] = {}
    for entry, name in zip(entries, names, strict=True):
        if not entry.name:
            files.setdefault(os.path.basename(entry.video), []).append(name)  # noqa: PTH119
    for file, several in files.items():
        if len(several) > 1:
            shown = ", ".join(several[:3]) + (", ..." if len(several) > 3 else "")
            say(f"{len(several)} videos are called {printable(file)}; their folders: {shown}")
