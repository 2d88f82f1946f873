"""How long each stage of tracking takes, measured while stages overlap."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

STAGES = ("decode", "preprocess", "network", "decode_boxes", "track", "write")


class StageTimes:
    """Seconds spent in each of the STAGES, added up over threads.

    Stages run side by side, so that together they may take longer than the clock shows; on a busy
    machine a stage also waits for its turn.
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._lock = threading.Lock()

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Count the time within towards a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(stage, time.perf_counter() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Count seconds towards a stage."""
        with self._lock:
            self.seconds[stage] += seconds

    def milliseconds_a_frame(self, n_frames: int) -> dict[str, float]:
        """``decode_ms`` and so on; NaN without frames."""
        return {
            f"{stage}_ms": 1e3 * seconds / n_frames if n_frames else float("nan")
            for stage, seconds in self.seconds.items()
        }
