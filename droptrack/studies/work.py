"""What a worker does with a video: track it, or say in one line why that failed."""

import errno
import platform
import shutil
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from droptrack.data.report import Value
from droptrack.data.sources.opencv_names import printable
from droptrack.detection.engine_choice import Engines
from droptrack.errors import DroptrackError, InterruptedRunError
from droptrack.pipeline.notes import Say
from droptrack.pipeline.run import TrackingRun, run
from droptrack.studies.addresses import local_copy
from droptrack.studies.analyses import analyse_video, remove_analyses
from droptrack.studies.at_address import send_video
from droptrack.studies.jobs import LOG, Job, Kept, can_resume, is_tracked, read_kept
from droptrack.studies.outcome import Outcome
from droptrack.studies.tables import read_table
from droptrack.tracking.events.lineage import Kind, find_events
from droptrack.version import __version__

ENGINES = Engines()  # of this process: its networks are compiled once, not once a video
ONE_VIDEO = threading.Lock()  # at a time in a process, whose cores it uses
TELL_S = 0.5  # seconds between two words of how far a video is
MAX_TABLE_BYTES = 400_000_000  # in which events are looked for
ROOM = 1 << 20  # bytes: a disk with less is full

Tell = Callable[[int, int], object]  # frames done, and those there are, 0 where nobody knows


def do_video(job: Job, tell: Tell) -> Outcome:
    """Track a video into its folder, and analyse it, as far as that was not done already.

    Raises KeyboardInterrupt where the worker is ended: the video is to be resumed then.
    """
    if job.version != __version__:
        return Outcome(
            name=job.name,
            reason=f"the worker on {platform.node()} has droptrack {__version__}, the batch "
            f"{job.version}: install one version everywhere",
            other_version=True,
        )
    began = time.perf_counter()
    try:
        with ONE_VIDEO:
            kept, n_frames, full = _do(job, _seldom(tell))
            seconds = time.perf_counter() - began
            kept = replace(kept, seconds=kept.seconds + seconds)
            kept.write(job.folder)
            if job.address:
                kept = _sent(kept, job)
    except OSError as error:  # of the video's folder itself
        return Outcome(name=job.name, reason=_reason(error, job), disk_is_full=_fills_disk(error))
    return Outcome(
        name=job.name,
        reason=kept.reason,
        n_frames=n_frames,
        seconds=seconds,
        disk_is_full=full or bool(kept.reason and _is_full(job.folder)),
    )


def _do(job: Job, tell: Tell) -> tuple[Kept, int, bool]:
    """Do a job; returns what its folder is to keep, the frames, and whether a disk is full."""
    job.folder.mkdir(parents=True, exist_ok=True)
    kept, resume = _beginning(job), can_resume(job)
    if not kept.tracked:
        _remove_rest(job.folder)
    said = list(kept.said)
    n_frames, full = 0, False
    with (job.folder / LOG).open("a", encoding="utf-8", errors="replace") as log:
        kept.write(job.folder)
        say = _Sayer(log, said)
        say.note(f"{job.video}: droptrack {__version__} on {platform.node()}")
        try:
            if not kept.tracked:
                done = _track(job, say, tell, resume=resume)
                n_frames = int(str(done.report.summary["n_frames"]))
                kept = replace(kept, tracked=True, said=tuple(said), facts=_facts(done))
                kept.write(job.folder)  # what ends the analyses does not end this
            kept = replace(kept, analysed=analyse_video(job.folder, job.analyses, say.note))
            kept = replace(kept, state="done")
            say.note("done")
        except InterruptedRunError as error:
            say.note(str(error))
            raise KeyboardInterrupt from None
        except Exception as error:  # noqa: BLE001  whatever it is, it is of this video
            if not isinstance(error, (DroptrackError, OSError)):  # a defect, of ours or a package
                say.note(traceback.format_exc())
            full = _fills_disk(error)
            kept = replace(kept, state="failed", reason=_reason(error, job))
            say.note(f"failed: {kept.reason}")
    return replace(kept, said=tuple(said)), n_frames, full


def _sent(kept: Kept, job: Job) -> Kept:
    """Send what a folder has to the job's address; what it is to keep after that."""
    try:
        send_video(job.folder, job.address)
    except DroptrackError as error:
        kept = replace(kept, state="failed", reason=_reason(error, job))
        kept.write(job.folder)
    return kept


def _beginning(job: Job) -> Kept:
    """What the folder keeps while a job is done: of its trajectories, where they are there."""
    before = read_kept(job.folder)
    new = Kept(state="running", identity=job.identity, made_from=job.made_from)
    if before is None or not is_tracked(job, before):
        return new
    kept = ("version", "said", "seconds", "facts", "tracked")
    return replace(new, **{name: getattr(before, name) for name in kept})


def _track(job: Job, say: Say, tell: Tell, *, resume: bool) -> TrackingRun:
    """Track a job's video; raises DroptrackError for one that is not done to its end."""
    with local_copy(job.video, job.folder) as video:
        config = replace(job.config, video=video, overwrite=True, resume=resume)
        done = run(config, say, progress=tell, engines=ENGINES)
    if done.problem is not None:
        raise done.problem
    return done


def _reason(error: Exception, job: Job) -> str:
    """What went wrong, in one line."""
    text = str(error)
    if isinstance(error, OSError) and not isinstance(error, DroptrackError):
        text = f"{error.filename or job.folder}: {error.strerror or error}"
    elif not isinstance(error, DroptrackError):  # which names the file itself
        text = f"{type(error).__name__}: {text[:200]}; see {job.place}/{LOG}"
    return printable(" ".join(text.split()))


def _fills_disk(error: Exception) -> bool:
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def _remove_rest(folder: Path) -> None:
    """Remove what is left of results whose table is gone: nobody can tell what it is of."""
    if read_kept(folder) is not None and not (folder / "trajectories.csv").exists():
        for name in ("report.json", "tracked.mp4"):
            (folder / name).unlink(missing_ok=True)
        remove_analyses(folder)


class _Sayer:
    """Writes what a run says into the video's log, and keeps it."""

    def __init__(self, log: TextIO, said: list[str]) -> None:
        self._log, self._said = log, said

    def __call__(self, text: str) -> None:
        self._said.append(text)
        self.note(text)

    def note(self, text: str) -> None:
        """Write into the log only."""
        self._log.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {printable(text)}\n")
        self._log.flush()


def _facts(done: TrackingRun) -> dict[str, Value]:
    """What a study's summary has beside the report: how many events there were of each kind.

    Nothing of a table that would take much of the memory.
    """
    path = done.folder / "trajectories.csv"
    if path.stat().st_size > MAX_TABLE_BYTES:
        return {}
    table = read_table(path)
    events, _ = find_events(table.rows, table.size)
    return {
        f"n_{kind.replace('-', '_')}": sum(event.kind == kind for event in events) for kind in Kind
    }


def _seldom(tell: Tell) -> Tell:
    """Tell how far a video is, not more often than anyone can read."""
    last = 0.0

    def sometimes(n_done: int, n_all: int) -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last >= TELL_S:
            last = now
            tell(n_done, n_all)

    return sometimes


def _is_full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < ROOM
    except OSError:
        return False
