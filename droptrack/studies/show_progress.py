"""How far a batch is: a bar for all videos and one a worker, or plain lines."""

import time
from types import TracebackType
from typing import Self

from rich.progress import TaskID

from droptrack.data.sources.opencv_names import printable
from droptrack.pipeline.notes import Say
from droptrack.progress import progress_bar
from droptrack.studies.outcome import Outcome
from droptrack.studies.workers import Advance


class BatchProgress:
    """Bars on a terminal, a line each half minute elsewhere."""

    def __init__(self, n_videos: int) -> None:
        self._bars = progress_bar("")
        self._all = self._bars.add_task("videos", total=n_videos, note="")
        self._workers: dict[str, TaskID] = {}
        self._at: dict[str, tuple[str, int, float]] = {}  # of a worker: video, frames at a time
        self._frames: dict[str, int] = {}  # of videos that are being done
        self._n_frames = 0  # of those that are done
        self._n_done = self._n_failed = 0
        self._began = time.perf_counter()

    def advance(self, item: Advance) -> None:
        """Show how far a worker is."""
        now = time.perf_counter()
        video, before, since = self._at.get(item.worker, ("", 0, now))
        if video != item.name:
            before, since = item.n_done, now
            self._at[item.worker] = item.name, before, since
        rate = (item.n_done - before) / (now - since) if now > since else 0.0
        self._frames[item.name] = item.n_done
        if not self._bars.disable:
            if item.worker not in self._workers:
                self._workers[item.worker] = self._bars.add_task(item.worker, note="")
            self._bars.update(
                self._workers[item.worker],
                total=item.n_all or None,
                completed=item.n_done,
                description=printable(item.name),
                note=f"{rate:.1f} frames/s" if rate else "",
            )
        self._show()

    def done(self, outcome: Outcome) -> None:
        """Count a video."""
        self._n_done += 1
        self._n_failed += bool(outcome.reason)
        self._frames.pop(outcome.name, None)
        self._n_frames += outcome.n_frames
        self._show()

    def say(self, text: str, say: Say) -> None:
        """Print a line above the bars."""
        if self._bars.disable:
            say(text)
        else:
            self._bars.console.print(text, markup=False, highlight=False)

    def _show(self) -> None:
        n_frames = self._n_frames + sum(self._frames.values())
        rate = n_frames / max(time.perf_counter() - self._began, 1e-9)
        failed = f", {self._n_failed} failed" if self._n_failed else ""
        self._bars.update(self._all, completed=self._n_done, note=f"{rate:.1f} frames/s{failed}")

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None
    ) -> None:
        self._bars.stop()
