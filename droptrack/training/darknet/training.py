"""Training by a Darknet binary: watched, logged, stopped, and resumed."""

import math
import os
import queue
import signal
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from droptrack.data.darknet_dataset import DataSet
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import Cfg
from droptrack.network.darknet_weights import read_weights, write_weights
from droptrack.training.darknet.binary import (
    Darknet,
    DarknetSettings,
    furthest_weights,
    training_command,
    write_data_files,
)
from droptrack.training.darknet.console import (
    Event,
    Iteration,
    MeanAp,
    NextMap,
    Question,
    Rewritten,
    Saving,
)
from droptrack.training.darknet.process import DarknetProcess, last_words
from droptrack.training.log import Step, TrainingLog, diverged

NAN = float("nan")


class _EndedAtMapError(Exception):
    """Darknet ended while it computed a mAP."""


class DarknetTraining:
    """One training in a run folder, through as many Darknets as it takes.

    `score` measures the mAP of weights where Darknet cannot.
    """

    def __init__(
        self,
        darknet: Darknet,
        cfg: Cfg,
        data: DataSet,
        folder: Path,
        settings: DarknetSettings,
        score: Callable[[Path], float],
    ) -> None:
        self.darknet, self.cfg, self.data, self.folder = darknet, cfg, data, folder
        self.settings, self.score = settings, score
        self.iterations = cfg.net.integer("max_batches")

    def steps(self, start: Path | None, resume: bool) -> Generator[Step, None, None]:
        """Train; yields each iteration, and again once its mAP is known.

        `start`: weights to begin with. With `resume`, resumes from the snapshot with the highest
        iteration. A Darknet that ends while it computes a mAP is started again without ``-map``.
        Raises DroptrackError when the loss diverges, and when Darknet ends early or prints nothing
        for too long.
        """
        write_data_files(self.darknet, self.folder, self.data, self.settings)
        first = 0
        if resume:
            found = furthest_weights(self.folder, self.cfg)
            if found is None:
                raise DroptrackError(
                    f"{self.folder}: has no complete snapshot to resume from; start again, in "
                    "another --out"
                )
            start, first = found
            if first >= self.iterations:
                raise DroptrackError(
                    f"{start}: is at iteration {first} already; to train longer, raise --iterations"
                )
        with TrainingLog(self.folder, first) as log:
            try:
                yield from self._run(log, start, first, with_map=True)
            except _EndedAtMapError:
                start, first = furthest_weights(self.folder, self.cfg) or (start, 0)
                log.forget_after(first)
                yield from self._run(log, start, first, with_map=False)

    def _run(
        self, log: TrainingLog, start: Path | None, first: int, with_map: bool
    ) -> Generator[Step, None, None]:
        """One Darknet from its start to its end."""
        command = training_command(
            self.darknet, self.cfg, self.data, self.settings, start, first, with_map
        )
        process, scorer = DarknetProcess(command, self.folder), _Scorer(self.score, self.cfg)
        iteration, next_map, rewritten = first, 0, NAN
        snapshot: Path | None = None  # announced; written once the next iteration is done
        began = process.heard
        try:
            while True:
                now, event = self._next_event(process)
                mean_ap = None
                match event:
                    case None:
                        break
                    case Iteration() if iteration < event.iteration <= self.iterations:
                        step = _step(event, rewritten, now - began)
                        iteration, began = event.iteration, now
                        next_map = event.next_map or next_map
                        log.append(step)
                        if not math.isfinite(step.loss):
                            raise diverged(self.folder, step)
                        yield step
                        if snapshot is not None and not with_map:
                            if iteration - scorer.iteration >= self.settings.map_every:
                                scorer.begin(snapshot)
                            snapshot = None
                        mean_ap = scorer.result()
                    case MeanAp() if iteration > first:
                        next_map, mean_ap = 0, (iteration, event.value)
                    case NextMap():
                        next_map = event.iteration
                    case Rewritten():
                        rewritten = event.share
                    case Saving() if not event.path.endswith("_best.weights"):
                        snapshot = self.folder / event.path
                    case Question():
                        process.answer("yes")
                if mean_ap is not None:
                    log.set_mean_ap(*mean_ap)
                    yield replace(step, mean_ap=mean_ap[1])
                    if log.is_stale(self.settings.patience):
                        return
            last = iteration >= self.iterations
            self._check_end(process, iteration, with_map and (last or 0 < next_map <= iteration))
            if not with_map:
                for mean_ap in self._last_scores(scorer):
                    log.set_mean_ap(*mean_ap)
                    yield replace(step, mean_ap=mean_ap[1])
        finally:
            process.stop()
            scorer.close()

    def _last_scores(self, scorer: "_Scorer") -> Iterator[tuple[int, float]]:
        """Iteration and mAP of the snapshot that is being scored, and of the final weights."""
        if (mean_ap := scorer.result(wait=True)) is not None:
            yield mean_ap
        scorer.begin(self.folder / f"{self.cfg.path.stem}_final.weights")
        if (mean_ap := scorer.result(wait=True)) is not None:
            yield mean_ap

    def _next_event(self, process: DarknetProcess) -> tuple[float, Event | None]:
        """The next event and its time; None once Darknet has ended."""
        limit = self.settings.hang_seconds
        while True:
            try:
                left = limit - (time.monotonic() - process.heard)
                return process.events.get(timeout=max(0.05, left))
            except queue.Empty:
                if time.monotonic() - process.heard >= limit:
                    raise DroptrackError(
                        f"{self.folder / 'darknet.log'}: Darknet has printed nothing for "
                        f"{limit:.0f} s and was stopped; {self._cure()} (--hang-minutes allows "
                        "more)"
                    ) from None

    def _check_end(self, process: DarknetProcess, iteration: int, at_map: bool) -> None:
        """Raise an error where Darknet did not come to the end of the training."""
        found = furthest_weights(self.folder, self.cfg)
        if iteration >= self.iterations and found is not None and found[1] >= self.iterations:
            return  # some builds crash while they clean up
        if at_map:
            raise _EndedAtMapError
        log, code = self.folder / "darknet.log", process.popen.returncode
        end = (
            f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        )
        raise DroptrackError(
            f"{log}: Darknet {end} after iteration {iteration} of {self.iterations}; its last "
            f"words: {last_words(log)!r}; {self._cure()}"
        )

    def _cure(self) -> str:
        found = furthest_weights(self.folder, self.cfg)
        if found is None:
            return "there is no snapshot to resume from: start again, in another --out"
        return f"--resume resumes from iteration {found[1]}"


class _Scorer:
    """Measures the mAP of one snapshot at a time beside a training, and keeps the best."""

    def __init__(self, score: Callable[[Path], float], cfg: Cfg) -> None:
        self._score, self._cfg = score, cfg
        self._pool = ThreadPoolExecutor(1)
        self._pending: Future[float] | None = None
        self._copy: Path | None = None
        self._best = -1.0
        self.iteration = 0  # of the snapshot taken last

    def begin(self, snapshot: Path) -> None:
        """Score a copy of a snapshot, if it is complete and none is being scored."""
        if self._pending is not None:
            return
        try:
            complete = read_weights(snapshot, self._cfg)
        except DroptrackError:
            return
        self.iteration = complete.images_seen // self._cfg.net.integer("batch")
        self._copy = snapshot.with_name(f"{self._cfg.path.stem}_scored.weights")
        write_weights(self._copy, complete)
        self._pending = self._pool.submit(self._score, self._copy)

    def result(self, wait: bool = False) -> tuple[int, float] | None:
        """The iteration and mAP of the snapshot, once they are known."""
        if self._pending is None or not (wait or self._pending.done()):
            return None
        mean_ap = self._pending.result()
        self._pending = None
        if mean_ap > self._best and self._copy is not None:
            self._best = mean_ap
            os.replace(self._copy, self._copy.with_name(f"{self._cfg.path.stem}_best.weights"))
        return self.iteration, mean_ap

    def close(self) -> None:
        """Wait for what is being scored, and forget it."""
        self._pool.shutdown()
        if self._copy is not None:
            self._copy.unlink(missing_ok=True)


def _step(event: Iteration, rewritten: float, seconds: float) -> Step:
    return Step(
        iteration=event.iteration,
        loss=event.loss,
        average_loss=event.average_loss,
        regression=NAN,
        objectness=NAN,
        classes=NAN,
        rewritten=rewritten,
        learning_rate=event.learning_rate,
        seconds=seconds,
        images=event.images,
        mean_ap=NAN,
    )
