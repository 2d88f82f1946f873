"""Frames decoded ahead and videos written behind, each in a thread of its own, memory bounded."""

import gc
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import NamedTuple, Self

import cv2
import numpy as np

from droptrack.data.frames import Frame
from droptrack.data.stage_times import StageTimes
from droptrack.data.video import VideoWriter
from droptrack.pipeline.drawing import Annotator
from droptrack.tracking.recorder import Row

READ_AHEAD = 4  # frames
TURN = 1e-4  # seconds for which a thread keeps Python to itself while others wait


@contextmanager
def side_by_side(opencv_threads: int) -> Iterator[None]:
    """Settings of the whole process under which stages overlap well.

    A stage that needs Python for a moment gets it soon, and OpenCV, whose threads would wait for
    one another beside other stages, has at most as many as are said. What there was before is not
    looked through for garbage: with Numba that takes 70 ms.
    """
    turn, threads = sys.getswitchinterval(), cv2.getNumThreads()
    sys.setswitchinterval(TURN)
    cv2.setNumThreads(min(threads, opencv_threads))
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(turn)
        cv2.setNumThreads(threads)


class NumberedFrame(NamedTuple):
    """A frame, its number in the source, and when it was decoded (``time.perf_counter``)."""

    number: int
    frame: Frame
    decoded: float


class FrameReader:
    """Decodes the frames of a source ahead of their use.

    With `newest`, for live sources, it holds only the latest frame, and counts in `n_dropped` those
    that nobody took before the next one came. Otherwise every frame is handed out, and decoding
    waits while READ_AHEAD of them are held. A problem of the source is raised after its last frame.
    """

    def __init__(
        self, source: Iterable[tuple[int, Frame]], times: StageTimes, *, newest: bool = False
    ) -> None:
        self.n_dropped = 0
        self._source, self._times = source, times
        self._held: deque[NumberedFrame] = deque()
        self._newest = newest
        self._changed = threading.Condition()
        self._ended = self._closed = False
        self._problem: BaseException | None = None
        self._thread = threading.Thread(target=self._read, name="decode", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None
    ) -> None:
        """Stop decoding; a camera that hangs is not waited for."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(timeout=2)

    def __iter__(self) -> Iterator[NumberedFrame]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._held or self._ended)
                if not self._held:
                    break
                frame = self._held.popleft()
                self._changed.notify_all()
            yield frame
        if self._problem is not None:
            raise self._problem

    def _read(self) -> None:
        try:
            frames = iter(self._source)
            while not self._closed:
                with self._times.measure("decode"):
                    item = next(frames, None)
                if item is None:
                    break
                self._hold(NumberedFrame(*item, time.perf_counter()))
        except Exception as problem:  # noqa: BLE001  the thread that takes the frames raises it
            self._problem = problem
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _hold(self, frame: NumberedFrame) -> None:
        with self._changed:
            if self._newest:
                self.n_dropped += len(self._held)
                self._held.clear()
            else:
                self._changed.wait_for(lambda: len(self._held) < READ_AHEAD or self._closed)
            self._held.append(frame)
            self._changed.notify_all()


class AnnotatedVideo:
    """Draws and writes frames in a thread, so that the analysis goes on meanwhile.

    Where the video is to be smaller than the frames (`shrink`), they are drawn first.

    It waits only when the writing falls READ_AHEAD frames behind.
    """

    def __init__(
        self,
        writer: VideoWriter,
        times: StageTimes,
        annotator: Annotator | None = None,
        *,
        shrink: bool = False,
    ) -> None:
        self._writer, self._times, self._shrink = writer, times, shrink
        self._annotator = annotator or Annotator()
        self._queue: queue.Queue[tuple[int, Frame, list[Row]] | None] = queue.Queue(READ_AHEAD)
        self._problem: BaseException | None = None
        self._thread = threading.Thread(target=self._write, name="write", daemon=True)
        self._thread.start()

    def write(self, index: int, frame: Frame, rows: list[Row]) -> None:
        """Append a frame with its rows; what goes wrong is raised by `close`."""
        self._queue.put((index, frame, rows))

    def close(self) -> None:
        """Finish the file; raises what went wrong, or DroptrackError if it lacks frames."""
        self._queue.put(None)
        self._thread.join()
        self._writer.close()
        if self._problem is not None:
            raise self._problem

    def _write(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._problem is not None:
                continue  # so that nobody waits for room in the queue
            try:
                with self._times.measure("write"):
                    image = self._annotator.draw(*item)
                    if self._shrink:
                        shrunk = cv2.resize(image, self._writer.size, interpolation=cv2.INTER_AREA)
                        image = np.asarray(shrunk, np.uint8)
                    self._writer.write(image)
            except Exception as problem:  # noqa: BLE001  raised by `close`
                self._problem = problem
